"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``.

    calibration.conf  ->  nominal rows + deltas  ->  placements  ->  frames near their nominal places  ->  Robot
    kinematics.yaml   ->  placements  ->  Robot

and back, whichever frames the robot's URDF uses, because its nominal kinematics are recognised. What a file has no
place for is returned and said, never dropped in silence.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.compensate.ur_arm import (
    FARTHEST,
    advice,
    arm_of,
    checked_distance,
    distance_from,
    fits_others,
    hash_remarks,
    joint_values,
    nearest_arm,
    odd,
    same,
)
from calib.compensate.ur_conf import (
    not_linearised,
    other_keys,
    read_deltas,
    update_deltas,
    write_deltas,
)
from calib.compensate.ur_dh import FullDH, at_flange, chain_poses, fitted_rows, kinematics_hash
from calib.compensate.ur_findings import (
    base_remark,
    name_remark,
    rows_remark,
    status_remark,
    tidy,
    tool_remark,
)
from calib.compensate.ur_models import MODELS, UrModel, ur_model, ur_robot
from calib.compensate.ur_mount import Mount, the_mount, with_chain
from calib.compensate.ur_yaml import check_hash, read_yaml, write_yaml
from calib.errors import FileError, ModelError
from calib.model.anchoring import anchored_placements, check_same_joints
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Written rows may differ from the robot by this [m and rad].
_EXACT = 1e-9


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
    """The name of a calibration, as the ROS driver makes it.

    Attributes:
        hash: Such as ``"calib_12788084448423163542"``.
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
        model: Which arm it is.
        T_base: shape (4, 4), [m]: a displacement of the base that the file cannot hold; the identity if there is none.
        T_tool: shape (4, 4), [m]: the same of the flange, behind the last joint.
        remarks: What to tell the user about these and about the file, sentence by sentence; none if it holds all.
    """

    path: Path
    model: UrModel
    T_base: Array
    T_tool: Array
    remarks: tuple[str, ...]


def read_ur_conf(
    path: str | os.PathLike[str],
    *,
    urcontrol: str | os.PathLike[str] | None = None,
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
    arm = arm_of(path, urcontrol, model, robot)
    nominal = ur_robot(arm) if robot is None else robot
    _, mounted = the_mount(nominal, arm)
    deltas = read_deltas(path)
    rows = arm.nominal + deltas

    def chain_of(one: UrModel) -> Array:
        return (one.nominal + deltas).chain()

    moved = checked_distance(path, arm, chain_of, advice(urcontrol, robot))
    raw = mounted.placements_of(rows.chain(), nominal)
    placements = anchored_placements(raw, nominal.placements, nominal.joints)
    calibrated = nominal.with_placements(placements)
    hash = kinematics_hash(rows)
    remarks = name_remark(nominal, arm, mounted) + odd(path, moved, arm)
    if urcontrol is None:
        given = [("--robot", robot), ("--ur-model", model)]
        names = " and ".join(option for option, value in given if value is not None)
        remarks += fits_others(path, arm, chain_of, moved, names)
    remarks += status_remark(path, not_linearised(path)) + hash_remarks(path, hash)
    return UrSource(nominal, calibrated, hash, arm, remarks)


def read_ur_yaml(
    path: str | os.PathLike[str],
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
    given = None if model is None else ur_model(model)
    content = read_yaml(path)
    remarks: tuple[str, ...] = ()
    if robot is not None:
        arm, _ = the_mount(robot, given)
    elif given is not None:
        arm = given
    else:
        arm = nearest_arm(content.chain)
        names = [one.name for one in MODELS if same(one.nominal, arm.nominal)]
        remarks = (
            f"{path} does not say of which arm it is; its kinematics are those of the {' or '.join(names)}.",
        )
    nominal = ur_robot(arm) if robot is None else robot
    moved = checked_distance(path, arm, lambda _: content.chain, advice(None, robot))
    _, mounted = the_mount(nominal, arm)
    if content.hash is None:
        remarks += (f"{path} has no hash; the ROS driver wants the robot's own.",)
    else:
        remarks += hash_remarks(path, content.hash)
    calibrated = with_chain(nominal, mounted, content.chain)
    remarks += name_remark(nominal, arm, mounted) + odd(path, moved, arm)
    return UrSource(nominal, calibrated, content.hash, arm, remarks)


def write_ur_yaml(
    robot: Robot,
    nominal: Robot,
    path: str | os.PathLike[str],
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
    check_hash(hash)
    arm, mounted = the_mount(nominal, None if model is None else ur_model(model))
    chain = at_flange(_chain_of(robot, nominal, arm, mounted))
    T_tool = tidy(chain[6])
    kind = arm.name if arm.known else "arm"
    comments = (
        f"Kinematics of one Universal Robots {kind}: lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll).",
    )
    written = write_yaml(path, chain, hash, comments, overwrite=overwrite)
    remarks = name_remark(nominal, arm, mounted) + tool_remark(written, T_tool)
    return UrWritten(written, arm, read_only(np.eye(4)), T_tool, remarks)


def write_ur_conf(
    robot: Robot,
    nominal: Robot,
    path: str | os.PathLike[str],
    *,
    update: str | os.PathLike[str] | None = None,
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
    arm, mounted = the_mount(nominal, None if model is None else ur_model(model))
    chain = _chain_of(robot, nominal, arm, mounted)
    if update is not None:
        like = read_deltas(update)
        _check_deltas(
            update, arm, like, "Give the calibration.conf of this robot's own controller."
        )
    fitted = fitted_rows(chain, arm.nominal, like)
    q = joint_values()
    made = fitted.T_base @ fitted.rows.poses(q) @ fitted.T_tool
    missed = float(np.abs(made - chain_poses(chain, q)).max())
    remarks = list(name_remark(nominal, arm, mounted))
    if missed > _EXACT:
        remarks.append(rows_remark(fitted.rows, missed))
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
    remarks += [*base_remark(written, fitted.T_base), *tool_remark(written, fitted.T_tool)]
    return UrWritten(written, arm, fitted.T_base, fitted.T_tool, tuple(remarks))


def read_ur_hash(
    path: str | os.PathLike[str],
    *,
    urcontrol: str | os.PathLike[str] | None = None,
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
    own = "Give the file of this robot's own controller."
    if Path(path).suffix.lower() == ".conf":
        arm = arm_of(path, urcontrol, model, robot)
        deltas = read_deltas(path)
        moved = _check_deltas(path, arm, deltas, own)
        hash = kinematics_hash(arm.nominal + deltas)
        return UrHash(hash, odd(path, moved, arm) + hash_remarks(path, hash))
    content = read_yaml(path)
    if content.hash is None:
        message = f"{path}: there is no 'hash' in it. Give the robot's own kinematics.yaml, or its calibration.conf."
        raise FileError(message)
    told = urcontrol is not None or model is not None or robot is not None
    arm = arm_of(path, urcontrol, model, robot) if told else nearest_arm(content.chain)
    moved = checked_distance(path, arm, lambda _: content.chain, own)
    return UrHash(content.hash, odd(path, moved, arm) + hash_remarks(path, content.hash))


def _check_deltas(path: str | os.PathLike[str], arm: UrModel, deltas: FullDH, advice: str) -> float:
    """How far the deltas of a file move the flange [m].

    Raises:
        FileError: They are another arm's.
    """
    return checked_distance(path, arm, lambda one: (one.nominal + deltas).chain(), advice)


def _chain_of(robot: Robot, nominal: Robot, arm: UrModel, mounted: Mount) -> Array:
    """The placements of a calibrated arm, shape (7, 4, 4), [m].

    Raises:
        ModelError: It is no correction of the nominal robot.
    """
    check_same_joints(robot, nominal)
    chain = mounted.chain_of(robot)
    moved = distance_from(chain, arm)
    if moved > FARTHEST:
        message = (
            f"The robot '{robot.name}' has its flange up to {moved:.2f} m from where the nominal {arm.name} has it, so "
            "that it is no correction of it. Give the nominal URDF that the robot was corrected from."
        )
        raise ModelError(message)
    return chain
