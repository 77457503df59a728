"""A conversion as `calib convert` prints it: what was read, displacement of the tip, limits of the file's format."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from calib.basics.arrays import Array
from calib.robot.ranges import spread_poses
from calib.show.lines import deg, fill, mm
from calib.show.readings import coupling_sentence

if TYPE_CHECKING:
    from calib.verbs.convert.convert import Conversion
    from calib.verbs.convert.notes import Code, Note

_DISPLACED = (
    "by ({0:.6f}, {1:.6f}, {2:.6f}) mm and ({3:.6f}, {4:.6f}, {5:.6f}) mrad (rotation vector), in the axes of the "
    "controller's"
)

#: The sentence of each note; lengths are in mm, angles in mrad.
_NOTES: dict[Code, str] = {
    "arm not certain": "The deltas in {0} fit {1} alike. Taken for another one than the {2}, the flange is up to "
    "{3:.0f} mm off; the controller's urcontrol.conf (--urcontrol) has the right nominal rows.",
    "nominal hash": "{0} has the hash of a nominal arm: it is of no particular robot.",
    "not linearised": "{0} has calibration_status = {1}, not 2 (linearised): the controller may not use these deltas.",
    "base displaced": f"Not in the file: the first axis lies off {_DISPLACED} base (link 'base'). T_base_frame of the "
    "frame of the poses becomes T_base^-1 T_base_frame, where T_base is this displacement.",
    "flange displaced": f"Not in the file: the flange lies off {_DISPLACED} flange (link 'tool0'). T_flange_tcp of the "
    "tool becomes T_tool T_flange_tcp, where T_tool is this displacement.",
    "other lines kept": "{0} are kept as they were: calib does not know how the controller makes them.",
    "other lines left out": "The file has the deltas alone, without {0}; --update keeps the other lines of a file.",
    "joints without origin": "The file has no origin of {0}: they stay as they are in the URDF.",
    "geometry alone": "The result's non-geometric model '{0}' is not converted: no format written here holds it. "
    "'calib compensate' uses it.",
    "nearly parallel axes": "Nearly parallel axes: {0}. d and theta of their rows may be large (here up to {1:.3g} mm) "
    "and cancel over the rows: enter every digit, and all rows together. 'hayati' has no such rows.",
    "joints without value": "Joints without a value of their own: {0}.",
    "coupled readings": "The joints of the URDF are at their angles, not at the controller's readings. For calib the "
    "cell file says {0}{1}.",
    "rows read": "{0} DH rows, {1} convention, {2}.",
    "rows written": "The convention of the rows is {0}, {1}.",
    "zeros not determined": "The measurements do not determine the zero of {0}, or it was frozen: leave it as it is. "
    "An unknown frame turns with the first joint, and a target whose place is not given with the last.",
    "zeros not validated": "These errors are of the fitted rows, and prove nothing: calibrate without --no-validate, "
    "or with validation rows.",
    "zeros no better": "Joint zeros alone are no better than the nominal robot on these {0} rows. They were accepted.",
    "changes alone": "The file has the changes alone, to be added to the numbers of the robot's own file; with "
    "--update FILE it is a copy of that file with the sums.",
    "comments not kept": "The comments of {0} are not in the new file.",
    "times gear ratio": "The numbers above are of the joints; in the file they are times the {0} of each entry.",
    "end positions move": "range_min and range_max stay as they are, so that each joint's end positions move with its "
    "zero: check them. The readings must grow with the servo's ticks; where they fall, turn the sign.",
}


def text(conversion: Conversion, name: str) -> str:
    """Write a conversion.

    Args:
        conversion: The conversion.
        name: The file that was read.

    Returns:
        What was read, its verdict, the displacement of the tip, notes, and the file written, in lines of 100 columns.
    """
    from calib.verbs.convert.camera.text import concerns_robot, handover_text
    from calib.verbs.convert.convert import FORMATS
    from calib.verbs.convert.zeros.text import has_zeros, zeros_text

    notes = [note_text(note) for note in (*conversion.source.notes, *conversion.notes)]
    written = FORMATS[conversion.format].what
    sentences = [
        _read(conversion, name),
        *_verdict(conversion, name),
    ]
    last = [
        *dict.fromkeys(notes),  # reader and writer may say the same
        f"Written: {conversion.path}, {written}.",
    ]
    paragraphs = [fill(sentence) for sentence in sentences]
    if has_zeros(conversion):
        paragraphs += zeros_text(conversion)
    elif concerns_robot(conversion) and _displacement(conversion):
        paragraphs.append(fill(_displacement(conversion)))
    paragraphs += handover_text(conversion)
    paragraphs += [fill(sentence) for sentence in last]
    if conversion.format == "ur-yaml":
        paragraphs.append(_launch(conversion))
    return "\n\n".join(paragraphs)


def _read(conversion: Conversion, name: str) -> str:
    """Word what was read."""
    source = conversion.source
    parts = [f"Read: {name}", source.kind]
    if source.model:
        parts.append(source.model.name)
    if source.hash:
        parts.append(source.hash)
    robot = source.robot
    parts += [f"'{robot.base}' to '{robot.tip}'", f"{len(robot.joints)} joints"]
    coupling = coupling_sentence(robot)
    sentence = ", ".join(parts) + "."
    return f"{sentence} {coupling}" if coupling else sentence


def _launch(conversion: Conversion) -> str:
    """Command that starts the ROS driver with the file, in lines of its own, to be copied."""
    model = conversion.source.model
    ur_type = "TYPE"
    if model is not None and model.known:
        ur_type = model.plain
    path = shlex.quote(str(conversion.path))
    if not conversion.path.is_absolute():
        path = f'"$PWD"/{path}'
    return (
        f"  ros2 launch ur_robot_driver ur_control.launch.py ur_type:={ur_type} robot_ip:=ADDRESS \\"
        f"\n    kinematics_params_file:={path}"
    )


def note_text(note: Note) -> str:
    """Word a note of a conversion: its lengths [m] and angles [rad] in mm and mrad."""
    values = [_shown(value) for value in note.values]
    return _NOTES[note.code].format(*values)


def _shown(value: str | float) -> str | float:
    """Return a length [m] in mm or an angle [rad] in mrad, never -0; a word as it is."""
    if isinstance(value, str):
        return value
    return 1e3 * value + 0.0


def _verdict(conversion: Conversion, name: str) -> Iterator[str]:
    """Word the verdict on what was read, if it is a result, or a URDF that states one."""
    verdict = conversion.source.verdict
    if conversion.against:
        yield f"Verdict on {name}: {conversion.against}"
    elif verdict is not None:
        yield f"Verdict on {name}: {verdict.use}"
    elif conversion.source.kind == "result":
        yield f"Verdict on {name}: none, the result was not validated."


def _displacement(conversion: Conversion) -> str:
    """Word the displacement of the tip from that of the nominal robot, over the joint limits; nothing of rows alone."""
    source = conversion.source
    if source.nominal is None and source.kind == "rows":
        return ""
    if source.nominal is None:
        return "The distance from its nominal robot is not known; --robot names that robot."
    if source.robot is source.nominal:
        return "Read as a nominal robot: there is no calibration to compare it with."
    q = spread_poses(source.nominal)
    lengths, angles = _distances(source.robot.poses(q), source.nominal.poses(q))
    far = f"{mm(lengths.mean())} mm (mean) and at most {mm(lengths.max())} mm"
    turned = f"{deg(angles.mean())} deg (mean) and at most {deg(angles.max())} deg"
    return (
        f"In '{source.robot.base}', over the joint limits, '{source.robot.tip}' lies {far} from where the nominal "
        f"robot has it, turned by {turned}."
    )


def _distances(T_actual: Array, T_nominal: Array) -> tuple[Array, Array]:
    """Return the distances [m] and the angles [rad] between N pairs of poses, shapes (N,).

    Args:
        T_actual: Shape (N, 4, 4), [m].
        T_nominal: Shape (N, 4, 4), in the same frame [m].
    """
    difference = T_actual[:, :3] - T_nominal[:, :3]
    lengths = np.linalg.norm(difference[:, :, 3], axis=1)
    # The Frobenius norm of a difference of rotations is sqrt(8) sin(angle / 2).
    sines = np.linalg.norm(difference[:, :, :3], axis=(1, 2)) / np.sqrt(8.0)
    angles = 2.0 * np.arcsin(np.clip(sines, 0.0, 1.0))
    return lengths, angles
