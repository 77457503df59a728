"""What ``calib convert`` prints: what was read, how far the tip is moved, what the file cannot hold."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from calib.robot.ranges import spread_poses
from calib.text.lines import fill

if TYPE_CHECKING:
    from calib.formats.convert import Conversion
    from calib.formats.dh_files import Code, Note

_DISPLACED = (
    "by ({0:.6f}, {1:.6f}, {2:.6f}) mm and ({3:.6f}, {4:.6f}, {5:.6f}) mrad (rotation vector), in the axes of the "
    "controller's"
)

#: What each code says; lengths are in mm, angles in mrad.
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
}


def text(done: Conversion, name: str) -> str:
    """All of it; ``name`` is what was read."""
    from calib.formats.convert import FORMATS

    found, robot = done.source, done.source.robot
    arm = f", {found.model.name}" if found.model else ""
    hash = f", {found.hash}" if found.hash else ""
    parts = [
        f"Read: {name}, {found.kind}{arm}{hash}, '{robot.base}' to '{robot.tip}', {len(robot.joints)} joints.",
        *_verdict(done, name),
        _moved(done),
        # Reader and writer may say the same.
        *dict.fromkeys(map(note_text, (*found.notes, *done.notes))),
        f"Written: {done.path}, {FORMATS[done.format].what}.",
    ]
    printed = "\n\n".join(map(fill, parts))
    if done.format == "ur-yaml":
        kind = "TYPE"
        if found.model is not None and found.model.known:
            kind = found.model.plain
        here = "" if done.path.is_absolute() else '"$PWD"/'
        # On lines of its own, to be copied.
        printed += (
            f"\n\n  ros2 launch ur_robot_driver ur_control.launch.py ur_type:={kind} robot_ip:=ADDRESS \\"
            f"\n    kinematics_params_file:={here}{shlex.quote(str(done.path))}"
        )
    return printed


def note_text(note: Note) -> str:
    """A note in words, in mm and mrad."""
    values = (v if isinstance(v, str) else 1e3 * v + 0.0 for v in note.values)
    return _NOTES[note.code].format(*values)


def _verdict(done: Conversion, name: str) -> Iterator[str]:
    """The verdict on what was read, if it is a result, or a URDF that states one."""
    verdict = done.source.verdict
    if done.against:
        yield f"Verdict on {name}: {done.against}"
    elif verdict is not None:
        yield f"Verdict on {name}: {verdict.use}"
    elif done.source.kind == "result":
        yield f"Verdict on {name}: none, the result was not validated."


def _moved(done: Conversion) -> str:
    """How far the tip lies from where the nominal robot has it, over the joint limits."""
    found = done.source
    if found.nominal is None:
        return "How far it is from its nominal robot is not known; --robot names that."
    if found.robot is found.nominal:
        return "Read as a nominal robot: there is no calibration to compare it with."
    q = spread_poses(found.nominal)
    apart = found.robot.poses(q)[:, :3] - found.nominal.poses(q)[:, :3]
    chord = np.linalg.norm(apart[:, :, :3], axis=(1, 2)) / np.sqrt(8.0)
    mm = 1e3 * np.linalg.norm(apart[:, :, 3], axis=1)
    deg = np.degrees(2.0 * np.arcsin(np.clip(chord, 0.0, 1.0)))
    return (
        f"Over the joint limits '{found.robot.tip}' lies {mm.mean():.3f} mm (mean) and at most {mm.max():.3f} mm from "
        f"where the nominal robot has it, turned by {deg.mean():.3f} deg (mean) and at most {deg.max():.3f} deg."
    )
