"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``.

    calibration.conf  ->  nominal rows + deltas  ->  placements  ->  frames near their nominal places  ->  Robot
    kinematics.yaml   ->  placements  ->  Robot

and back, whichever frames the robot's URDF uses, because its nominal kinematics are recognised. What a file has no
place for is returned and said, never dropped in silence. Of which arm a file is, is in `calib.formats.ur_check`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import FileError, ModelError
from calib.formats.ur_check import Given, checked_distance, fits_others, hash_remarks, nearest, odd
from calib.formats.ur_dh import (
    ROUNDING,
    FullDH,
    at_flange,
    chain_poses,
    fitted_rows,
    kinematics_hash,
)
from calib.formats.ur_files import (
    not_linearised,
    other_keys,
    read_deltas,
    read_yaml,
    update_deltas,
    write_deltas,
    write_yaml,
)
from calib.formats.ur_models import MODELS, UrModel, ur_model, ur_robot
from calib.formats.ur_mount import FARTHEST, SPREAD, Mount, distance_from, the_mount
from calib.model.anchoring import anchored_placements, check_same_joints
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]
PathLike = str | os.PathLike[str]

#: Written rows may differ from the robot by this [m and rad].
_EXACT = 1e-9

#: Decimals of mm and mrad in which 1e-9 m and rad can be seen.
_DECIMALS = 6

#: A d is longer than an arm where a common normal stands far away [m].
_LONG = 10.0

_OWN = "Give the file of this robot's own controller."


@dataclass(frozen=True, slots=True, eq=False)
class UrSource:
    """What a file of Universal Robots says about an arm.

    Attributes:
        nominal: The robot given, or a bare arm as the data sheet has it, ``base`` to ``tool0``.
        robot: The same chain, calibrated.
        hash: The ROS driver's name for the calibration, ``"calib_..."``; None where the yaml has none.
        model: Which arm it is.
        remarks: Sentences about what was read that its reader should know; most often none.
    """

    nominal: Robot
    robot: Robot
    hash: str | None
    model: UrModel
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class UrHash:
    """The name of a calibration, as the ROS driver makes it, such as ``"calib_12788084448423163542"``.

    Attributes:
        hash: The name.
        remarks: What to mind about it, sentence by sentence; most often nothing.
    """

    hash: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class UrWritten:
    """What was written, and what the file cannot hold.

    With the file's own kinematics K(q) from the controller's base to its flange, the arm is T_base K(q) T_tool.

    Attributes:
        path: The file.
        T_base: shape (4, 4), [m]: a displacement of the base that the file cannot hold; the identity if there is none.
        T_tool: shape (4, 4), [m]: the same of the flange, behind the last joint.
        remarks: What to tell the user about these and about the file, sentence by sentence; none if it holds all.
        exact: What the file may differ from the robot by [m and rad].
    """

    path: Path
    T_base: Array
    T_tool: Array
    remarks: tuple[str, ...]
    exact: float = _EXACT


def read_ur_conf(
    path: PathLike,
    *,
    urcontrol: PathLike | None = None,
    model: UrModel | str | None = None,
    robot: Robot | None = None,
) -> UrSource:
    """The arm that a ``calibration.conf`` describes.

    Args:
        path: The file, with the deltas in ``[mounting]``.
        urcontrol: A ``urcontrol.conf`` with the nominal rows in ``[DH]``; default: those of the model.
        model: The arm, or its name, such as ``"UR5e"``; default: what urcontrol or the robot is recognised as.
        robot: The nominal robot whose URDF is corrected; default: a bare one, see `ur_robot`.

    Raises:
        FileError: A file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot, or is not given.
    """
    given = Given(urcontrol, model, robot)
    arm = given.arm(path)
    nominal = ur_robot(arm) if robot is None else robot
    _, mounted = the_mount(nominal, arm)
    deltas = read_deltas(path)

    def chain_of(one: UrModel) -> Array:
        return (one.nominal + deltas).chain()

    moved = checked_distance(path, arm, chain_of, given.advice)
    raw = mounted.placements_of(chain_of(arm), nominal)
    placements = anchored_placements(raw, nominal.placements, nominal.joints)
    hash = kinematics_hash(arm.nominal + deltas)
    remarks = _name_remark(nominal, arm, mounted) + odd(path, moved, arm)
    if urcontrol is None:
        remarks += fits_others(path, arm, chain_of, moved, given.named)
    status = not_linearised(path)
    if status:
        remarks += (
            f"{path} has calibration_status = {status}, which is not 2, linearised: the controller may not use these "
            "deltas. They were taken as they are; check that the robot is calibrated.",
        )
    remarks += hash_remarks(path, hash)
    return UrSource(nominal, nominal.with_placements(placements), hash, arm, remarks)


def read_ur_yaml(
    path: PathLike,
    *,
    model: UrModel | str | None = None,
    robot: Robot | None = None,
) -> UrSource:
    """The arm that a ``kinematics.yaml`` of the ROS driver describes.

    Args:
        path: The file.
        model: The arm, or its name, such as ``"UR5e"``; default: what the robot is recognised as, or else the arm that
            the file's kinematics are nearest to.
        robot: The nominal robot whose URDF is corrected; default: a bare one, see `ur_robot`.

    Raises:
        FileError: The file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot.
    """
    given = Given(None, None if model is None else ur_model(model), robot)
    content = read_yaml(path)
    remarks: tuple[str, ...] = ()
    if robot is None and model is None:
        arm = nearest(content.chain)
        names = [one.name for one in MODELS if one.same(arm.nominal)]
        remarks = (
            f"{path} does not say of which arm it is; its kinematics are those of the {' or '.join(names)}.",
        )
    else:
        arm = given.arm(path)
    nominal = ur_robot(arm) if robot is None else robot
    moved = checked_distance(path, arm, lambda _: content.chain, given.advice)
    _, mounted = the_mount(nominal, arm)
    if content.hash is None:
        remarks += (f"{path} has no hash; the ROS driver wants the robot's own.",)
    else:
        remarks += hash_remarks(path, content.hash)
    calibrated = nominal.with_placements(mounted.placements_of(content.chain, nominal))
    remarks += _name_remark(nominal, arm, mounted) + odd(path, moved, arm)
    return UrSource(nominal, calibrated, content.hash, arm, remarks)


def write_ur_yaml(
    robot: Robot,
    nominal: Robot,
    path: PathLike,
    *,
    hash: str,
    model: UrModel | str | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the ``kinematics.yaml`` that the ROS driver and Universal Robots' description take.

    Args:
        robot: The calibrated robot.
        nominal: The robot that it was corrected from: the arm's nominal one, or one that was calibrated before and has
            the link names of Universal Robots' descriptions.
        path: File to write.
        hash: The robot's own, see `read_ur_hash`: the driver compares it with what the controller reports.
        model: The arm, or its name; default: what the nominal robot is recognised as. Give that of the source: an arm
            of a ``urcontrol.conf`` may be near to another one.
        overwrite: Whether a file that exists may be replaced.

    Returns:
        The file, and a displacement of the flange behind the last joint, for which it has no place.

    Raises:
        ModelError: The nominal robot is not a Universal Robots arm, or the robot is no correction of it.
        FileError: The file cannot be written, or the hash is none.
    """
    arm, mounted, chain = _chain_of(robot, nominal, model)
    chain = at_flange(chain)
    T_tool = np.eye(4) if np.abs(chain[6] - np.eye(4)).max() < ROUNDING else chain[6]
    kind = arm.name if arm.known else "arm"
    comments = (
        f"Kinematics of one Universal Robots {kind}: lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll).",
    )
    written = write_yaml(path, chain, hash, comments, overwrite=overwrite)
    remarks = _name_remark(nominal, arm, mounted) + _end_remarks(written, np.eye(4), T_tool)
    return UrWritten(written, read_only(np.eye(4)), read_only(T_tool), remarks)


def write_ur_conf(
    robot: Robot,
    nominal: Robot,
    path: PathLike,
    *,
    update: PathLike | None = None,
    like: FullDH | None = None,
    model: UrModel | str | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the DH deltas of a ``calibration.conf``.

    Args:
        robot: The calibrated robot.
        nominal: The robot that it was corrected from: the arm's nominal one, or one that was calibrated before and has
            the link names of Universal Robots' descriptions.
        path: File to write.
        update: A ``calibration.conf`` of this arm whose other lines are kept; default: the deltas alone.
        like: Deltas whose signs and whole turns are kept, so that what did not change is the same number; default:
            those of ``update``, or else none.
        model: The arm, or its name, as of `write_ur_yaml`.
        overwrite: Whether a file that exists may be replaced.

    Returns:
        The file, and displacements of the base and of the flange, for which standard DH rows have no place.

    Raises:
        ModelError: The nominal robot is not a Universal Robots arm, or the robot is no correction of it.
        FileError: A file cannot be read or written.
    """
    arm, mounted, chain = _chain_of(robot, nominal, model)
    if update is not None:
        like = deltas = read_deltas(update)
        advice = "Give the calibration.conf of this robot's own controller."
        checked_distance(update, arm, lambda one: (one.nominal + deltas).chain(), advice)
    fitted = fitted_rows(chain, arm.nominal, like)
    made = fitted.T_base @ fitted.rows.poses(SPREAD) @ fitted.T_tool
    missed = float(np.abs(made - chain_poses(chain, SPREAD)).max())
    remarks = list(_name_remark(nominal, arm, mounted))
    if missed > _EXACT:
        longest = float(np.abs(fitted.rows.d).max())
        reason = (
            f"d is {longest:.2g} m where two axes are almost parallel, and no more digits fit"
            if longest > _LONG
            else "two axes that are less than 0.01 microradians from parallel are taken as parallel"
        )
        remarks.append(f"The rows hold the robot to {missed:.1e} m: {reason}.")
    if update is None:
        written = write_deltas(path, fitted.deltas, overwrite=overwrite)
    else:
        written = update_deltas(update, path, fitted.deltas, overwrite=overwrite)
        kept = other_keys(update)
        if kept:
            remarks.append(
                f"{', '.join(kept)} are as in {update}: calib does not know how the controller makes them. Keep a "
                "copy of the controller's own file."
            )
    remarks += _end_remarks(written, fitted.T_base, fitted.T_tool)
    # Rows between almost parallel axes may hold less, which is said.
    exact = 1e-6 if missed > _EXACT else _EXACT
    return UrWritten(written, fitted.T_base, fitted.T_tool, tuple(remarks), exact)


def read_ur_hash(
    path: PathLike,
    *,
    urcontrol: PathLike | None = None,
    model: UrModel | str | None = None,
    robot: Robot | None = None,
) -> UrHash:
    """The hash of a robot's own ``kinematics.yaml`` or ``calibration.conf``, which its controller reports, too.

    Args:
        path: The file; one that ends in ``.conf`` needs one of the other three. A ``kinematics.yaml`` is held against
            the arm that they say.
        urcontrol: A ``urcontrol.conf`` with the nominal rows.
        model: The arm, or its name, such as ``"UR5e"``.
        robot: The nominal robot.

    Raises:
        FileError: The file cannot be read, has no hash, or is of another arm.
        ModelError: The model is not known or not given.
    """
    given = Given(urcontrol, model, robot)
    if Path(path).suffix.lower() == ".conf":
        arm, deltas = given.arm(path), read_deltas(path)
        moved = checked_distance(path, arm, lambda one: (one.nominal + deltas).chain(), _OWN)
        hash = kinematics_hash(arm.nominal + deltas)
        return UrHash(hash, odd(path, moved, arm) + hash_remarks(path, hash))
    content = read_yaml(path)
    if content.hash is None:
        raise FileError(
            f"{path}: there is no 'hash' in it. Give the robot's own kinematics.yaml, or its calibration.conf."
        )
    arm = nearest(content.chain) if given.nothing else given.arm(path)
    moved = checked_distance(path, arm, lambda _: content.chain, _OWN)
    return UrHash(content.hash, odd(path, moved, arm) + hash_remarks(path, content.hash))


def _chain_of(
    robot: Robot, nominal: Robot, model: UrModel | str | None
) -> tuple[UrModel, Mount, Array]:
    """The arm, how it is mounted, and its placements when calibrated, shape (7, 4, 4), [m].

    Raises:
        ModelError: It is no correction of the nominal robot.
    """
    arm, mounted = the_mount(nominal, None if model is None else ur_model(model))
    check_same_joints(robot, nominal)
    chain = mounted.chain_of(robot)
    moved = distance_from(chain, arm)
    if moved > FARTHEST:
        raise ModelError(
            f"The robot '{robot.name}' has its flange up to {moved:.2f} m from where the nominal {arm.name} has it, so "
            "that it is no correction of it. Give the nominal URDF that the robot was corrected from."
        )
    return arm, mounted, chain


# What is to be said of an arm


def _name_remark(robot: Robot, arm: UrModel, mounted: Mount) -> tuple[str, ...]:
    """A sentence about a robot that is not nominal, whose base and flange were found by name."""
    if mounted.off == mounted.turned == 0.0:
        return ()
    return (
        f"'{robot.name}' ({robot.urdf.source}) is not the nominal {arm.name}: its flange lies up to "
        f"{1e3 * mounted.off:.2g} mm and {1e3 * mounted.turned:.2g} mrad off, because it was calibrated before or its "
        "numbers are rounded. Its base and its flange are taken to be where the names of its links say.",
    )


def _end_remarks(written: Path, T_base: Array, T_tool: Array) -> tuple[str, ...]:
    """What to do with displacements of the base and of the flange."""
    base, tool = _displacement(T_base), _displacement(T_tool)
    remarks = (
        f"Not in {written}: the first axis lies {base}, along and about the axes of the controller's base (link "
        "'base'), from where the base has it, and DH rows begin on it. To put this right move the frame that poses "
        "are given in: T_base_frame becomes T_base^-1 T_base_frame, where T_base is this displacement.",
        f"Not in {written}: the flange lies {tool}, along and about the axes of the controller's flange (link "
        "'tool0'), from where the last joint has it, and there is no place for that behind the joint. To put this "
        "right add it to the tool: T_flange_tcp becomes T_tool T_flange_tcp, where T_tool is this displacement.",
    )
    return tuple(said for said, lies in zip(remarks, (base, tool), strict=True) if lies)


def _displacement(T: Array) -> str:
    """A small displacement in words: x, y, z in mm and the rotation vector in mrad; empty below 1e-9 m and rad."""
    # Rounded first, so that nothing is said to be -0.
    rounded = [
        [round(1e3 * float(value), _DECIMALS) + 0.0 for value in vector]
        for vector in (T[:3, 3], pin.log3(T[:3, :3]))
    ]
    if not any(map(any, rounded)):
        return ""
    shift, turn = (", ".join(f"{value:.{_DECIMALS}f}" for value in vector) for vector in rounded)
    return f"({shift}) mm and ({turn}) mrad"
