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

from calib.compensate.ur_conf import (
    other_keys,
    read_deltas,
    read_nominal,
    update_deltas,
    write_deltas,
)
from calib.compensate.ur_dh import FullDH, at_flange, chain_poses, fitted_rows, kinematics_hash
from calib.compensate.ur_findings import (
    FARTHEST,
    base_remark,
    check_arm,
    checked_distance,
    distance_from,
    joint_values,
    name_remark,
    odd,
    same,
    tidy,
    tool_remark,
)
from calib.compensate.ur_models import (
    MODELS,
    Mount,
    UrModel,
    the_mount,
    ur_model,
    ur_robot,
    with_chain,
)
from calib.compensate.ur_yaml import check_hash, read_yaml, write_yaml
from calib.errors import FileError, ModelError, choices
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
    model: str | None = None,
    robot: Robot | None = None,
) -> UrSource:
    """The arm that a ``calibration.conf`` describes.

    Args:
        path: The file, with the deltas in ``[mounting]``.
        urcontrol: A ``urcontrol.conf`` with the nominal rows in ``[DH]``; default: those of the model.
        model: Name of the arm, such as ``"UR5e"``; default: what urcontrol or the robot is recognised as.
        robot: The nominal robot whose URDF is corrected; default: a bare one, see `ur_robot`.

    Raises:
        FileError: A file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot, or is not given.
    """
    arm = _arm(path, urcontrol, model, robot)
    nominal = ur_robot(arm) if robot is None else robot
    _, mounted = the_mount(nominal, arm)
    deltas = read_deltas(path)
    rows = arm.nominal + deltas
    check_arm(path, arm, lambda one: distance_from((one.nominal + deltas).chain(), one))
    moved = checked_distance(path, rows.chain(), arm)
    raw = mounted.placements_of(rows.chain(), nominal)
    placements = anchored_placements(raw, nominal.placements, nominal.joints)
    calibrated = nominal.with_placements(placements)
    remarks = name_remark(nominal, arm, mounted) + odd(path, moved, arm)
    return UrSource(nominal, calibrated, kinematics_hash(rows), arm, remarks)


def read_ur_yaml(
    path: str | os.PathLike[str], *, model: str | None = None, robot: Robot | None = None
) -> UrSource:
    """The arm that a ``kinematics.yaml`` of the ROS driver describes.

    Args:
        path: The file.
        model: Name of the arm, such as ``"UR5e"``; default: what the robot is recognised as, or else the arm that the
            file's kinematics are nearest to.
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
        arm = min(MODELS, key=lambda one: distance_from(content.chain, one))
        names = [one.name for one in MODELS if same(one.nominal, arm.nominal)]
        remarks = (
            f"{path} does not say of which arm it is; its kinematics are those of the {' or '.join(names)}.",
        )
    nominal = ur_robot(arm) if robot is None else robot
    check_arm(path, arm, lambda one: distance_from(content.chain, one))
    moved = checked_distance(path, content.chain, arm)
    _, mounted = the_mount(nominal, arm)
    if content.hash is None:
        remarks += (f"{path} has no hash; the ROS driver wants the robot's own.",)
    elif content.hash == arm.default_hash:
        remarks += (
            f"{path} has the hash of the nominal {arm.name}: it is of no particular robot.",
        )
    calibrated = with_chain(nominal, mounted, content.chain)
    remarks += name_remark(nominal, arm, mounted) + odd(path, moved, arm)
    return UrSource(nominal, calibrated, content.hash, arm, remarks)


def write_ur_yaml(
    robot: Robot,
    nominal: Robot,
    path: str | os.PathLike[str],
    *,
    hash: str,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the ``kinematics.yaml`` that the ROS driver and Universal Robots' description take.

    Args:
        robot: The calibrated robot.
        nominal: The robot that it was corrected from: the arm's nominal one, or one that was calibrated before and has
            the link names of Universal Robots' descriptions.
        path: File to write.
        hash: The robot's own, see `read_ur_hash`: the driver compares it with what the controller reports.
        overwrite: Whether a file that exists may be replaced.

    Returns:
        The file, and a displacement of the flange behind the last joint, for which it has no place.

    Raises:
        ModelError: The nominal robot is not a Universal Robots arm, or the robot is no correction of it.
        FileError: The file cannot be written, or the hash is none.
    """
    check_hash(hash)
    arm, mounted = the_mount(nominal)
    chain = at_flange(_chain_of(robot, nominal, arm, mounted))
    T_tool = tidy(chain[6])
    comments = (
        f"Kinematics of one Universal Robots {arm.name}: lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll).",
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
    model: str | None = None,
    overwrite: bool = False,
) -> UrWritten:
    """Write a robot as the DH deltas of a ``calibration.conf``.

    Args:
        robot: The calibrated robot.
        nominal: The robot that it was corrected from: the arm's nominal one, or one that was calibrated before and has
            the link names of Universal Robots' descriptions.
        path: File to write.
        update: A ``calibration.conf`` whose other lines are kept; default: the deltas alone.
        model: Name of the arm; default: what the nominal robot is recognised as.
        overwrite: Whether a file that exists may be replaced.

    Returns:
        The file, and displacements of the base and of the flange, for which standard DH rows have no place.

    Raises:
        ModelError: The nominal robot is not a Universal Robots arm, or the robot is no correction of it.
        FileError: A file cannot be read or written.
    """
    arm, mounted = the_mount(nominal, None if model is None else ur_model(model))
    chain = _chain_of(robot, nominal, arm, mounted)
    like = None if update is None else arm.nominal + read_deltas(update)
    fitted = fitted_rows(chain, arm.nominal, like)
    q = joint_values()
    made = fitted.T_base @ fitted.rows.poses(q) @ fitted.T_tool
    missed = float(np.abs(made - chain_poses(chain, q)).max())
    remarks = list(name_remark(nominal, arm, mounted))
    if missed > _EXACT:
        remarks.append(
            f"The rows hold the robot to {missed:.1e} m: d is {np.abs(fitted.rows.d).max():.2g} m where two axes are "
            "almost parallel, and no more digits fit."
        )
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
    model: str | None = None,
    robot: Robot | None = None,
) -> str:
    """The hash of a robot's own ``kinematics.yaml`` or ``calibration.conf``, which its controller reports, too.

    Args:
        path: The file; one that ends in ``.conf`` needs one of the other three.
        urcontrol: A ``urcontrol.conf`` with the nominal rows.
        model: Name of the arm, such as ``"UR5e"``.
        robot: The nominal robot.

    Raises:
        FileError: The file cannot be read or has no hash.
        ModelError: The model is not known or not given.
    """
    if Path(path).suffix.lower() == ".conf":
        arm = _arm(path, urcontrol, model, robot)
        rows = _rows(path, arm)
        checked_distance(path, rows.chain(), arm)
        return kinematics_hash(rows)
    found = read_yaml(path).hash
    if found is None:
        message = f"{path}: there is no 'hash' in it. Give the robot's own kinematics.yaml, or its calibration.conf."
        raise FileError(message)
    return found


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


def _arm(
    path: str | os.PathLike[str],
    urcontrol: str | os.PathLike[str] | None,
    model: str | None,
    robot: Robot | None,
) -> UrModel:
    """The arm that a ``calibration.conf`` is of, from what was given beside it.

    Raises:
        ModelError: Nothing was given, the model is not known, or two of them do not agree.
    """
    given = None if model is None else ur_model(model)
    if urcontrol is not None:
        rows = read_nominal(urcontrol)
        named = [one for one in MODELS if same(one.nominal, rows)]
        if given is not None and given not in named:
            is_what = (
                f"those of the {' or '.join(one.name for one in named)}"
                if named
                else "no arm's that is known"
            )
            message = (
                f"The rows in [DH] of {urcontrol} are {is_what}, not those of the {given.name}. Leave the name of "
                "the arm out, or give the urcontrol.conf of this robot's own controller."
            )
            raise ModelError(message)
        name = given.name if given else named[0].name if named else f"arm of {Path(urcontrol).name}"
        return UrModel(name, rows)
    if robot is not None:
        return the_mount(robot, given)[0]
    if given is None:
        message = (
            f"{path}: a calibration.conf has only what is added to the nominal rows. Say of which arm it is "
            f"({choices((one.name for one in MODELS), limit=40)}), or give its urcontrol.conf or its URDF."
        )
        raise ModelError(message)
    return given


def _rows(path: str | os.PathLike[str], arm: UrModel) -> FullDH:
    """The complete rows: nominal plus the deltas of a ``calibration.conf``."""
    return arm.nominal + read_deltas(path)
