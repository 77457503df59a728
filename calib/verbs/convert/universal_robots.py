"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``.

    calibration.conf  ->  nominal rows + deltas  ->  placements  ->  frames near their nominal places  ->  Robot
    kinematics.yaml   ->  placements  ->  Robot

and back, whichever frames the robot's URDF uses, because the arm is recognised in it. What a file has no place for is
returned as a note; what is written is read back before it appears.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.files import write_atomically
from calib.errors import FileError, ModelError, choices
from calib.model.dh_table import dh_table
from calib.robot.dh.rows import STANDARD
from calib.robot.generated.universal_robots import MODELS, UrModel, chain_of_rows, ur_model
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.nominal_actual import check_same_joints
from calib.verbs.convert.anchored_placements import anchored_placements
from calib.verbs.convert.notes import Code, Note
from calib.verbs.convert.source import Source
from calib.verbs.convert.ur_arms import at_flange, chain_poses, kinematics_hash, ur_robot
from calib.verbs.convert.ur_conf import LINEARISED, Conf, conf_bytes, read_nominal
from calib.verbs.convert.ur_mount import Mount, distance_from, the_mount
from calib.verbs.convert.ur_yaml import kinematics_bytes, read_kinematics, read_numbers

PathLike = str | os.PathLike[str]

#: The chain that a file makes of an arm, shape (7, 4, 4) [m].
ChainOf = Callable[[UrModel], Array]

#: A kinematics.yaml may differ from the robot by this [m and rad].
_EXACT = 1e-9

#: Deltas may differ from the robot by this [m and rad]: rows of almost parallel axes lose digits.
_EXACT_ROWS = 1e-6

#: A displacement below this is rounding [m and rad].
_ROUNDING = 1e-12

#: A delta this near to the one that it replaces is that one: of theta [rad], a, d [m], alpha [rad].
_SAME = np.array([1e-14, 1e-13, 1e-12, 1e-14])

#: A calibration that moves the flange further may be of another arm [m].
_SUSPECT = 0.01

#: No calibration moves the flange further [m].
_FARTHEST = 0.2

#: Another arm fits a file as well if the flange moves at most this many times as far.
_FITS_AS_WELL = 3.0

#: Arms whose flanges differ by less are one [m].
_ALIKE = 1e-6

#: Decimals of the displacements in notes [m and rad].
_NOTE_DECIMALS = 9

#: The sine of alpha beyond which its sign tells the sense of a common normal.
_TELLING_SINE = 0.5


# Reading


def read_ur(
    path: PathLike,
    *,
    urcontrol: PathLike | None = None,
    model: UrModel | str | None = None,
    robot: Robot | None = None,
) -> Source:
    """Read the arm that a ``calibration.conf`` or a ``kinematics.yaml`` describes.

    A ``calibration.conf`` has deltas only: it needs ``urcontrol``, ``robot`` or ``model``. A
    ``kinematics.yaml`` is of the arm that it is nearest to, unless one is given.

    Args:
        path: The file; one that ends in ``.conf`` is a ``calibration.conf``.
        urcontrol: The controller's file with the arm's nominal rows; None: they are those of the
            robot or the model.
        model: The arm or its name, ``"UR5e"``; None: the robot's.
        robot: The nominal robot whose URDF is corrected; None: a bare one of the arm.

    Returns:
        The robot and its nominal robot.

    Raises:
        FileError: A file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot, or is not given.
    """
    if Path(path).suffix.lower() == ".conf":
        return _read_conf(path, urcontrol, model, robot)
    return _read_yaml(path, urcontrol, model, robot)


def _read_yaml(
    path: PathLike,
    urcontrol: PathLike | None,
    model: UrModel | str | None,
    robot: Robot | None,
) -> Source:
    """Read a ``kinematics.yaml``, see `read_ur`."""
    chain, hash = read_kinematics(path)
    numbers, _ = read_numbers(path)
    arm = _given_arm(urcontrol, model, robot)
    if arm is None:
        arm = min(MODELS, key=lambda known: distance_from(chain, known))
    nominal = ur_robot(arm) if robot is None else robot
    _checked_distance(path, arm, lambda _: chain)
    placements = the_mount(nominal, arm).placements_of(chain, nominal)
    corrected = nominal.with_placements(placements)
    notes = _hash_notes(path, hash)
    return Source("ur-yaml", corrected, nominal, hash, arm, None, numbers, notes)


def _read_conf(
    path: PathLike,
    urcontrol: PathLike | None,
    model: UrModel | str | None,
    robot: Robot | None,
) -> Source:
    """Read a ``calibration.conf``, see `read_ur`."""
    conf = Conf.read(path)

    def chain_of(arm: UrModel) -> Array:
        return chain_of_rows(arm.rows + conf.deltas)

    arm = _given_arm(urcontrol, model, robot)
    if arm is None:
        raise ModelError(
            f"{path}: a calibration.conf has only what is added to an arm's nominal rows. Say of "
            "which arm it is, as in --ur-model UR5e, or give its --urcontrol, or its nominal URDF "
            "as --robot."
        )
    nominal = ur_robot(arm) if robot is None else robot
    moved = _checked_distance(path, arm, chain_of)
    placements = the_mount(nominal, arm).placements_of(chain_of(arm), nominal)
    hash = kinematics_hash(arm.rows + conf.deltas)
    axes = [np.asarray(joint.axis) for joint in nominal.joints]
    placements = anchored_placements(placements, nominal.placements, axes)
    notes: tuple[Note, ...] = ()
    if urcontrol is None:
        notes += _arm_notes(path, arm, chain_of, moved)
    if conf.status != LINEARISED:
        notes += (Note("not linearised", (str(path), conf.status[:40])),)
    notes += _hash_notes(path, hash)
    corrected = nominal.with_placements(placements)
    return Source("ur-conf", corrected, nominal, hash, arm, conf, None, notes)


def _given_arm(
    urcontrol: PathLike | None, model: UrModel | str | None, robot: Robot | None
) -> UrModel | None:
    """Return the arm that was given, by its rows, its robot or its name; None if none was."""
    named = None if model is None else ur_model(model)
    if urcontrol is not None:
        return _arm_of_rows(read_nominal(urcontrol), urcontrol, named)
    if robot is not None:
        return the_mount(robot, named).model
    return named


def _arm_of_rows(rows: Array, path: PathLike, model: UrModel | None) -> UrModel:
    """Return the arm with the rows (6, 4) of a urcontrol.conf; it must be ``model`` if given."""
    if model is not None and not model.same(rows):
        raise ModelError(
            f"The rows in [DH] of {path} are not those of the {model.name}. Leave the name of the "
            "arm out, or give the urcontrol.conf of this robot's own controller."
        )
    if model is not None:
        return UrModel(model.name, rows)
    names = [known.name for known in MODELS if known.same(rows)]
    return UrModel(names[0] if names else f"arm of {Path(path).name}", rows)


def _arm_notes(path: PathLike, arm: UrModel, chain_of: ChainOf, moved: float) -> tuple[Note, ...]:
    """Return a note if deltas fit other arms as well: nothing in them tells these apart.

    ``moved`` is how far the deltas move the flange of ``arm`` [m].
    """
    most = max(_SUSPECT, _FITS_AS_WELL * moved)
    fitting = [known for known in MODELS if distance_from(chain_of(known), known) <= most]
    apart = max((distance_from(known.chain, arm) for known in fitting), default=0.0)
    if apart <= _ALIKE:
        return ()
    names = choices(known.name for known in fitting)
    return (Note("arm not certain", (str(path), names, arm.name, apart)),)


def _hash_notes(path: PathLike, hash: str | None) -> tuple[Note, ...]:
    """Return a note if a hash is that of a nominal arm."""
    if any(kinematics_hash(known.rows) == hash for known in MODELS):
        return (Note("nominal hash", (str(path),)),)
    return ()


def _checked_distance(path: PathLike, arm: UrModel, chain_of: ChainOf) -> float:
    """Return how far a calibration moves the flange of an arm [m].

    Raises:
        FileError: It moves it far more than that of another arm, or than any calibration does.
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
            "Give the right --ur-model, --urcontrol or URDF, and numbers in metres and radians."
        )
    return moved


# Writing


@dataclass(frozen=True, slots=True, eq=False)
class UrWritten:
    """A file that was written, and displacements of base and flange that it cannot hold.

    With the file's own kinematics K(q) from the controller's base to its flange, the arm is T_base K(q) T_tool.
    """

    #: The file.
    path: Path
    #: Shape (4, 4), [m], in the controller's base; the identity if nothing is lost.
    T_base: Array
    #: Shape (4, 4), [m], in the controller's flange; the identity if nothing is lost.
    T_tool: Array
    #: What the file cannot hold, and what of another file was kept.
    notes: tuple[Note, ...]


def write_ur_yaml(
    source: Source,
    path: PathLike,
    hash: str,
    *,
    like: Array | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the ``kinematics.yaml`` that the ROS driver and Universal Robots' description take.

    The file is read back and compared before it appears.

    Args:
        source: The robot and its nominal robot.
        path: The file.
        hash: The hash of the robot's own file.
        like: Numbers of that file, see `kinematics_bytes`; None: those of the source, if it is such
            a file.
        overwrite: Whether a file that exists is replaced.

    Returns:
        The file, and what it cannot hold.

    Raises:
        ModelError: No Universal Robots arm, no correction of it, or a file that does not read back.
        FileError: The file cannot be written, or the hash is none.
    """
    mount, chain = _chain_of(source, path)
    chain = at_flange(chain)
    T_tool = _rounded(chain[6])
    data = kinematics_bytes(chain, hash, source.numbers if like is None else like)
    read_back, _ = read_kinematics(path, data)
    _check(source.robot, mount, path, (np.eye(4), read_back, T_tool), _EXACT)
    written = write_atomically(path, data, overwrite=overwrite)
    return UrWritten(written, np.eye(4), T_tool, _displaced("flange displaced", T_tool))


def write_ur_conf(
    source: Source,
    path: PathLike,
    update: PathLike | None = None,
    *,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the DH deltas of a ``calibration.conf``.

    The file is read back and compared before it appears. The deltas have the signs and whole turns of those of
    ``update``, or else of the source, so that what did not change is the same number.

    Args:
        source: The robot and its nominal robot.
        path: The file.
        update: A ``calibration.conf`` of this arm whose other lines are kept; None: the deltas are
            written alone.
        overwrite: Whether a file that exists is replaced.

    Returns:
        The file, and what it cannot hold.

    Raises:
        ModelError: No Universal Robots arm, no correction of it, or a file that does not read back.
        FileError: A file cannot be read or written, or ``update`` is of another arm.
    """
    mount, chain = _chain_of(source, path)
    arm = mount.model
    updated = None if update is None else _read_updated(update, arm)
    deltas, T_base, T_tool = _deltas(arm, chain, updated or source.conf)
    data = conf_bytes(deltas) if updated is None else updated.with_deltas(deltas)
    read_back = chain_of_rows(arm.rows + Conf.read(path, data).deltas)
    _check(source.robot, mount, path, (T_base, read_back, T_tool), _EXACT_ROWS)
    written = write_atomically(path, data, overwrite=overwrite)
    notes = (
        *_other_lines(updated, source.conf),
        *_displaced("base displaced", T_base),
        *_displaced("flange displaced", T_tool),
    )
    return UrWritten(written, T_base, T_tool, notes)


def _read_updated(path: PathLike, arm: UrModel) -> Conf:
    """Read the ``calibration.conf`` that is updated, which must be of this arm."""
    conf = Conf.read(path)
    _checked_distance("--update", arm, lambda known: chain_of_rows(known.rows + conf.deltas))
    return conf


def _other_lines(updated: Conf | None, of_source: Conf | None) -> tuple[Note, ...]:
    """Return a note on the lines of a ``calibration.conf`` that are no deltas: kept or left out."""
    if updated is not None and updated.others:
        return (Note("other lines kept", (", ".join(updated.others),)),)
    if updated is None and of_source is not None and of_source.others:
        return (Note("other lines left out", (choices(of_source.others),)),)
    return ()


def _deltas(arm: UrModel, chain: Array, reference: Conf | None) -> tuple[Array, Array, Array]:
    """Return the DH deltas of a chain, and the displacements that rows have no place for.

    Args:
        arm: The nominal arm.
        chain: Placements of the calibrated arm, shape (7, 4, 4) [m].
        reference: The file whose deltas have the wanted signs and turns; None: those near zero.

    Returns:
        Deltas, shape (6, 4) [rad], [m]; T_base and T_tool of `UrWritten`, shape (4, 4) [m].
    """
    nominal = ur_robot(arm)
    placements = the_mount(nominal, arm).placements_of(chain, nominal)
    table = dh_table(nominal.with_placements(placements), STANDARD, like=nominal)
    rows = np.array([[row.theta, row.a, row.d, row.alpha] for row in table.rows])
    reference_deltas = np.zeros((6, 4)) if reference is None else reference.deltas
    deltas = _in_the_sense_of(rows, arm.rows + reference_deltas) - arm.rows
    is_same = np.abs(deltas - reference_deltas) < _SAME
    deltas = np.where(is_same, reference_deltas, deltas)
    return deltas, _rounded(table.T_base_0), _rounded(table.T_n_tip)


def _in_the_sense_of(rows: Array, reference_rows: Array) -> Array:
    """Return the same DH rows with senses of the normals, and turns of the angles, as a reference.

    Of the two senses of a common normal that with the sign of alpha; between parallel axes that with the nearer theta.

    Args:
        rows: theta, a, d, alpha, shape (6, 4), [rad] and [m].
        reference_rows: Rows of the wanted senses and turns, shape (6, 4).

    Returns:
        Rows of the same poses, shape (6, 4).
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
    """Return a pose (4, 4), the identity where it is that but for rounding."""
    is_identity = np.abs(T - np.eye(4)).max() < _ROUNDING
    return read_only(np.eye(4) if is_identity else T)


def _displaced(code: Code, T: Array) -> tuple[Note, ...]:
    """Return a note on a displacement T (4, 4): three lengths [m] and a rotation vector [rad]."""
    vector = np.round([*T[:3, 3], *pin.log3(T[:3, :3])], _NOTE_DECIMALS) + 0.0
    return (Note(code, tuple(vector.tolist())),) if np.any(vector) else ()


def _chain_of(source: Source, path: PathLike) -> tuple[Mount, Array]:
    """Return how the arm of a source is mounted, and its chain, shape (7, 4, 4) [m]."""
    if source.nominal is None or source.model is None:
        raise ModelError(
            f"{path}: this format is for arms of Universal Robots, and the nominal robot is none "
            "that is known. Name the arm with --ur-model, or give its nominal URDF as --robot."
        )
    mount = the_mount(source.nominal, source.model)
    check_same_joints(source.robot, source.nominal)
    chain = mount.chain_of(source.robot)
    _checked_distance(source.robot.urdf.source, mount.model, lambda _: chain)
    return mount, chain


def _check(
    robot: Robot,
    mount: Mount,
    path: PathLike,
    parts: tuple[Array, Array, Array],
    exact: float,
) -> None:
    """Compare a file that was read back with the robot.

    Args:
        robot: The robot.
        mount: How the arm is mounted.
        path: The file, for the message.
        parts: T_base (4, 4), the file's chain (7, 4, 4) and T_tool (4, 4), see `UrWritten` [m].
        exact: Largest difference of poses [m and rad].

    Raises:
        ModelError: The poses differ by more.
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
