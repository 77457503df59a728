"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``.

    calibration.conf  ->  nominal rows + deltas  ->  placements  ->  frames near their nominal places  ->  Robot
    kinematics.yaml   ->  placements  ->  Robot

and back, whichever frames the robot's URDF uses, because the arm is recognised in it. With the file's own kinematics
K(q) from the controller's base to its flange, the arm is T_base K(q) T_tool; displacements T_base and T_tool, for which
the file has no place, are noted. What is written is read back before it appears.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.files import write_atomically
from calib.errors import CalibError, FileError, ModelError, choices
from calib.model.dh_table import dh_table
from calib.result.calibration import check_same_joints
from calib.robot.dh_rows import STANDARD
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.ur_models import MODELS, UrModel, chain_of_rows, ur_model
from calib.verbs.convert.anchored_placements import anchored_placements
from calib.verbs.convert.format import (
    YAML,
    Conversion,
    Format,
    Note,
    Notes,
    Options,
    Source,
    SourceKind,
)
from calib.verbs.convert.ur_arms import (
    Mount,
    at_flange,
    chain_poses,
    distance_from,
    kinematics_hash,
    the_mount,
    ur_robot,
)
from calib.verbs.convert.ur_files import (
    LINEARISED,
    Conf,
    KinematicsYaml,
    conf_bytes,
    kinematics_bytes,
    read_nominal,
)

PathLike = str | os.PathLike[str]

#: The chain that a file makes of an arm, shape (7, 4, 4) [m].
ChainOf = Callable[[UrModel], Array]

#: A kinematics.yaml may differ from the robot by this [m and rad].
_EXACT = 1e-9

#: Deltas may differ from the robot by this [m and rad]: rows of almost parallel axes lose digits.
_EXACT_ROWS = 1e-6

#: A displacement below this is rounding [m and rad].
_ROUNDING = 1e-12

#: A delta that differs by less from the one that it replaces is the same: of theta [rad], a, d [m], alpha [rad].
_SAME = np.array([1e-14, 1e-13, 1e-12, 1e-14])

#: A calibration that moves the flange further may be of another arm [m].
_SUSPECT = 0.01

#: No calibration moves the flange further [m].
_FARTHEST = 0.2

#: Another arm fits a file as well if the flange moves at most this many times as far.
_FITS_AS_WELL = 3.0

#: Arms whose flanges differ by less are the same [m].
_ALIKE = 1e-6

#: Decimals of the displacements in notes [m and rad].
_NOTE_DECIMALS = 9

#: If the sine of alpha is larger than this, its sign shows the sense of a common normal.
_TELLING_SINE = 0.5


# Reading


def read_ur(
    path: PathLike,
    *,
    urcontrol: PathLike | None = None,
    model: UrModel | str | None = None,
    robot: Robot | None = None,
    section: str | None = None,
) -> Source:
    """Read the arm that a ``calibration.conf`` or a ``kinematics.yaml`` describes.

    A ``calibration.conf`` has deltas only: it needs ``urcontrol``, ``robot`` or ``model``. A ``kinematics.yaml`` is
    taken for the arm with the nearest kinematics, unless one is given.

    Args:
        path: The file; one that ends in ``.conf`` is a ``calibration.conf``.
        urcontrol: The controller's file with the arm's nominal rows; None: they are those of the robot or the model.
        model: The arm or its name, ``"UR5e"``; None: the robot's.
        robot: The nominal robot whose URDF is corrected; None: a bare one of the arm.
        section: Which of several arms a ``kinematics.yaml`` or a dump of parameters has, see `find_table`.

    Returns:
        The robot and its nominal robot.

    Raises:
        FileError: A file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot, or is not given.
    """
    arm = None if model is None else ur_model(model)
    if urcontrol is not None:
        rows = read_nominal(urcontrol)
        if arm is not None and not arm.has_rows(rows):
            raise ModelError(
                f"The rows in [DH] of {urcontrol} are not those of the {arm.name}. Leave the name of the "
                "arm out, or give the urcontrol.conf of this robot's own controller."
            )
        names = [known.name for known in MODELS if known.has_rows(rows)]
        name = names[0] if names else f"arm of {Path(urcontrol).name}"
        arm = UrModel(name if arm is None else arm.name, rows)
    elif robot is not None:
        arm = the_mount(robot, arm).model
    if Path(path).suffix.lower() == ".conf":
        return _read_conf(path, arm, robot, is_certain=urcontrol is not None)
    file = KinematicsYaml.read(path, section=section)
    if arm is None:
        arm = min(MODELS, key=lambda known: distance_from(file.chain, known))
    nominal = ur_robot(arm) if robot is None else robot
    _checked_distance(path, arm, lambda _: file.chain)
    placements = the_mount(nominal, arm).placements_of(file.chain, nominal)
    corrected = nominal.with_placements(placements)
    notes = _hash_notes(path, file.hash)
    return Source("ur-yaml", corrected, nominal, arm, file.hash, file, notes)


def _read_conf(
    path: PathLike, arm: UrModel | None, robot: Robot | None, *, is_certain: bool
) -> Source:
    """Read a ``calibration.conf`` of an arm, whose nominal rows its deltas are added to, onto a robot or a bare arm.

    If the arm is not certain, a note says which other arms the deltas fit. Without an arm it raises `ModelError`.
    """
    conf = Conf.read(path)

    def chain_of(known: UrModel) -> Array:
        return chain_of_rows(known.rows + conf.deltas)

    if arm is None:
        raise ModelError(
            f"{path}: a calibration.conf has only what is added to an arm's nominal rows. Say which arm it is for, "
            "as in --arm UR5e, or give its --urcontrol, or its nominal URDF as --robot."
        )
    nominal = ur_robot(arm) if robot is None else robot
    moved = _checked_distance(path, arm, chain_of)
    placements = the_mount(nominal, arm).placements_of(chain_of(arm), nominal)
    hash = kinematics_hash(arm.rows + conf.deltas)
    axes = [np.asarray(joint.axis) for joint in nominal.joints]
    placements = anchored_placements(placements, nominal.placements, axes)
    notes: Notes = ()
    if not is_certain:
        most = max(_SUSPECT, _FITS_AS_WELL * moved)
        fitting = [known for known in MODELS if distance_from(chain_of(known), known) <= most]
        apart = max((distance_from(known.chain, arm) for known in fitting), default=0.0)
        if apart > _ALIKE:
            names = choices(known.name for known in fitting)
            sentence = (
                "The deltas in {0} fit {1} alike. Taken for another one than the {2}, the flange is up to {3:.0f} mm "
                "off; the controller's urcontrol.conf (--urcontrol) has the right nominal rows."
            )
            notes += (Note("arm not certain", sentence, (str(path), names, arm.name, apart)),)
    if conf.status != LINEARISED:
        sentence = "{0} has calibration_status = {1}, not 2 (linearised): the controller may not use these deltas."
        notes += (Note("not linearised", sentence, (str(path), conf.status[:40])),)
    notes += _hash_notes(path, hash)
    return Source("ur-conf", nominal.with_placements(placements), nominal, arm, hash, conf, notes)


def _hash_notes(path: PathLike, hash: str | None) -> Notes:
    """Return a note if a hash is that of a nominal arm, which no particular robot has; else nothing."""
    if not any(kinematics_hash(known.rows) == hash for known in MODELS):
        return ()
    sentence = "{0} has the hash of a nominal arm, which does not identify a particular robot."
    return (Note("nominal hash", sentence, (str(path),)),)


def _checked_distance(path: PathLike, arm: UrModel, chain_of: ChainOf) -> float:
    """Return how far a calibration moves the flange of an arm [m]; `FileError` if that is too far for this arm.

    ``chain_of`` returns the calibrated chain, (7, 4, 4) [m], that the file means if it is of a given arm.
    """
    moved = distance_from(chain_of(arm), arm)
    if moved <= _SUSPECT:
        return moved
    by_arm = {known.name: distance_from(chain_of(known), known) for known in MODELS}
    least = min(by_arm.values())
    if moved > _FITS_AS_WELL * least or moved > _FARTHEST:
        fitting = [name for name, d in by_arm.items() if d <= _FITS_AS_WELL * least]
        raise FileError(
            f"{path} moves the flange of a {arm.name} by up to {1e3 * moved:.0f} mm, and that of "
            f"{choices(fitting)} by {1e3 * least:.0f} mm; a calibration moves it by millimetres. "
            "Give the right --arm, --urcontrol or URDF, and numbers in metres and radians."
        )
    return moved


# Writing


def kinematics_file(
    source: Source, path: PathLike, hash: str, like: KinematicsYaml | None = None
) -> tuple[bytes, Array]:
    """Return a robot as the ``kinematics.yaml`` that the ROS driver and Universal Robots' description take.

    Args:
        source: The robot and its nominal robot.
        path: The file, for messages.
        hash: The hash of the robot's own file.
        like: The robot's own file, see `kinematics_bytes`; None: the source, if it is such a file.

    Returns:
        The file, and the displacement T_tool that it cannot hold, in the controller's flange, shape (4, 4), [m]; the
        identity if there is none.

    Raises:
        ModelError: This is not a Universal Robots arm or not a correction of it, or the file does not read back.
        FileError: The hash is malformed.
    """
    mount, chain = _chain_of(source, path)
    chain = at_flange(chain)
    T_tool = _rounded(chain[6])
    if like is None and isinstance(source.content, KinematicsYaml):
        like = source.content
    data = kinematics_bytes(chain, hash, like)
    read_back = KinematicsYaml.read(path, data).chain
    _check(source.robot, mount, path, (np.eye(4), read_back, T_tool), _EXACT)
    return data, T_tool


def conf_file(
    source: Source, path: PathLike, updated: Conf | None = None
) -> tuple[bytes, Array, Array]:
    """Return a robot as the DH deltas of a ``calibration.conf``.

    The deltas have the signs and whole turns of those of ``updated``, or else of the source, so that unchanged numbers
    stay the same.

    Args:
        source: The robot and its nominal robot.
        path: The file, for messages.
        updated: The file of which a copy with new deltas is made; None: the deltas are written alone.

    Returns:
        The file, and the displacements that it cannot hold, shapes (4, 4), [m]: T_base in the controller's base and
        T_tool in its flange, the identity if there is none.

    Raises:
        ModelError: This is not a Universal Robots arm or not a correction of it, or the file does not read back.
        FileError: ``updated`` is of another arm.
    """
    mount, chain = _chain_of(source, path)
    arm = mount.model
    reference = source.content if isinstance(source.content, Conf) else None
    if updated is not None:
        deltas = updated.deltas
        _checked_distance("--update", arm, lambda known: chain_of_rows(known.rows + deltas))
        reference = updated
    nominal = ur_robot(arm)
    placements = the_mount(nominal, arm).placements_of(chain, nominal)
    table = dh_table(nominal.with_placements(placements), STANDARD, like=nominal)
    rows = np.array([[row.theta, row.a, row.d, row.alpha] for row in table.rows])
    reference_deltas = np.zeros((6, 4)) if reference is None else reference.deltas
    deltas = _in_the_sense_of(rows, arm.rows + reference_deltas) - arm.rows
    is_same = np.abs(deltas - reference_deltas) < _SAME
    deltas = np.where(is_same, reference_deltas, deltas)
    T_base, T_tool = _rounded(table.T_base_0), _rounded(table.T_n_tip)

    data = conf_bytes(deltas) if updated is None else updated.with_deltas(deltas)
    read_back = chain_of_rows(arm.rows + Conf.read(path, data).deltas)
    _check(source.robot, mount, path, (T_base, read_back, T_tool), _EXACT_ROWS)
    return data, T_base, T_tool


def _chain_of(source: Source, path: PathLike) -> tuple[Mount, Array]:
    """Return how the arm of a source is mounted, and its calibrated chain, shape (7, 4, 4) [m].

    It raises `ModelError` if the nominal robot is not a known arm, and `FileError` for too large a correction.
    """
    if source.nominal is None or not isinstance(source.model, UrModel):
        raise ModelError(
            f"{path}: this format is for arms of Universal Robots, and the nominal robot is not a known one. "
            "Name the arm with --arm, or give its nominal URDF as --robot."
        )
    mount = the_mount(source.nominal, source.model)
    check_same_joints(source.robot, source.nominal)
    chain = mount.chain_of(source.robot)
    _checked_distance(source.robot.urdf.source, mount.model, lambda _: chain)
    return mount, chain


def _in_the_sense_of(rows: Array, reference_rows: Array) -> Array:
    """Return the same DH rows, (6, 4), with senses of the common normals and turns of the angles as in a reference.

    Rows and reference are theta, a, d, alpha, [rad] and [m]. Of the two senses of a normal that with the sign of alpha
    is taken; between parallel axes that with nearer theta.
    """
    result = np.array(rows)
    for i in range(5):
        sine = np.sin(result[i, 3])
        reference_sine = np.sin(reference_rows[i, 3])
        if abs(reference_sine) > _TELLING_SINE:
            is_opposite = sine * reference_sine < 0.0
        else:
            is_opposite = np.cos(result[i, 0] - reference_rows[i, 0]) < 0.0
        if is_opposite:
            theta, a, d, alpha = result[i]
            result[i] = (theta + np.pi, -a, d, -alpha)
            result[i + 1, 0] += np.pi
    angles = [0, 3]
    turns = np.round((reference_rows - result)[:, angles] / (2.0 * np.pi))
    result[:, angles] += 2.0 * np.pi * turns
    return result


def _rounded(T: Array) -> Array:
    """Return a pose (4, 4), exactly the identity if it is the identity except for rounding."""
    is_identity = np.abs(T - np.eye(4)).max() < _ROUNDING
    return read_only(np.eye(4) if is_identity else T)


def _check(
    robot: Robot, mount: Mount, path: PathLike, parts: tuple[Array, Array, Array], exact: float
) -> None:
    """Compare T_base, (4, 4), the chain that was read back, (7, 4, 4), and T_tool, (4, 4) [m], with the robot.

    `ModelError` if poses differ by more than ``exact`` [m and rad].
    """
    T_base, chain, T_tool = parts
    q = random_joint_values(robot)
    flange = T_base @ chain_poses(chain, q) @ T_tool
    poses = mount.T_base_arm @ flange @ mount.T_flange_tip
    difference = float(np.abs(poses - robot.poses(q)).max())
    if not difference <= exact:
        raise ModelError(
            f"{Path(path).name}: read back, it puts the tip of '{robot.name}' {difference:.1e} m or "
            f"rad off; {exact:g} is allowed, so it is not written. Please report this with what was "
            "converted."
        )


# As formats and sources of a conversion


_DISPLACED = (
    "by ({0:.6f}, {1:.6f}, {2:.6f}) mm and ({3:.6f}, {4:.6f}, {5:.6f}) mrad (rotation vector), in the axes of the "
    "controller's"
)

_BASE_DISPLACED = (
    f"Not in the file: the first axis lies off {_DISPLACED} base (link 'base'). T_base_frame of the frame of the poses "
    "becomes T_base^-1 T_base_frame, where T_base is this displacement."
)

_FLANGE_DISPLACED = (
    f"Not in the file: the flange lies off {_DISPLACED} flange (link 'tool0'). T_flange_tcp of the tool becomes T_tool "
    "T_flange_tcp, where T_tool is this displacement."
)


def displaced(code: str, sentence: str, T: Array) -> Notes:
    """Return a note on a displacement T, (4, 4) [m]: three lengths [m] and a rotation vector [rad]; none if it is 0."""
    vector = np.round([*T[:3, 3], *pin.log3(T[:3, :3])], _NOTE_DECIMALS) + 0.0
    return (Note(code, sentence, tuple(vector.tolist())),) if np.any(vector) else ()


def _write_yaml(source: Source, path: Path, options: Options) -> Notes:
    """Write a kinematics.yaml with the robot's own hash; raises `CalibError` if neither source nor options have one."""
    hash = source.hash
    like = None
    notes: Notes = ()
    if options.hash_from is not None:
        model = source.model if isinstance(source.model, UrModel) else None
        own_file = read_ur(
            options.hash_from, urcontrol=options.urcontrol, model=model, section=options.section
        )
        hash = own_file.hash
        like = own_file.content if isinstance(own_file.content, KinematicsYaml) else None
        notes = own_file.notes
    if hash is None:
        raise CalibError(
            f"{path}: a kinematics.yaml has the hash of the robot's own calibration, which the ROS "
            "driver compares with what the controller reports. Give the robot's own "
            "kinematics.yaml (from ros2 launch ur_calibration calibration_correction.launch.py) or "
            "its calibration.conf as --hash-from."
        )
    data, T_tool = kinematics_file(source, path, hash, like)
    write_atomically(path, data, overwrite=options.overwrite)
    return notes + displaced("flange displaced", _FLANGE_DISPLACED, T_tool)


def _launch(conversion: Conversion) -> str:
    """Return the command that starts the ROS driver with the file, in lines of its own, to be copied."""
    model = conversion.source.model
    ur_type = "TYPE"
    if isinstance(model, UrModel) and model.known:
        ur_type = model.plain
    path = shlex.quote(str(conversion.path))
    if not conversion.path.is_absolute():
        path = f'"$PWD"/{path}'
    return (
        f"  ros2 launch ur_robot_driver ur_control.launch.py ur_type:={ur_type} robot_ip:=ADDRESS \\"
        f"\n    kinematics_params_file:={path}"
    )


def _write_conf(source: Source, path: Path, options: Options) -> Notes:
    """Write the deltas of a calibration.conf, alone or in a copy of the controller's own file.

    Notes are on lines that were kept or left out, and on displacements of base and flange that the file cannot hold.
    """
    updated = None if options.update is None else Conf.read(options.update)
    data, T_base, T_tool = conf_file(source, path, updated)
    write_atomically(path, data, overwrite=options.overwrite)
    notes: Notes = ()
    if updated is not None and updated.others:
        sentence = "{0} are kept as they were: calib does not know how the controller makes them."
        notes = (Note("other lines kept", sentence, (", ".join(updated.others),)),)
    if updated is None and isinstance(source.content, Conf) and source.content.others:
        sentence = (
            "The file has the deltas alone, without {0}; --update keeps the other lines of a file."
        )
        notes = (Note("other lines left out", sentence, (choices(source.content.others),)),)
    notes += displaced("base displaced", _BASE_DISPLACED, T_base)
    return notes + displaced("flange displaced", _FLANGE_DISPLACED, T_tool)


def _read(source: str, options: Options) -> Source:
    """Read a calibration.conf or a kinematics.yaml, onto the given nominal robot, or onto a bare one of the arm.

    A bare one has base, tip and held joints of the options.
    """
    given = None if options.robot is None else options.load(options.robot)
    result = read_ur(
        source,
        urcontrol=options.urcontrol,
        model=options.arm,
        robot=given,
        section=options.section,
    )
    return result if given is not None else options.on_chain(result)


FORMATS = {
    "ur-yaml": Format(
        "kinematics.yaml of Universal Robots' ROS driver", YAML, _write_yaml, command=_launch
    ),
    "ur-conf": Format(
        "DH deltas of a Universal Robots controller", (".conf",), _write_conf, updates=True
    ),
}

KINDS = {
    "ur-conf": SourceKind((".conf",), "", _read),
    "ur-yaml": SourceKind(YAML, "kinematics", _read),
}
