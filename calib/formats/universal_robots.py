"""Universal Robots' own files into robots and back: ``calibration.conf`` and ``kinematics.yaml``.

    calibration.conf  ->  nominal rows + deltas  ->  placements  ->  frames near their nominal places  ->  Robot
    kinematics.yaml   ->  placements  ->  Robot

and back, whichever frames the robot's URDF uses, because its nominal kinematics are recognised. What a file has no
place for is returned and said, never dropped in silence; what is written is read back before it appears.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import FileError, ModelError, choices
from calib.files import write_atomically
from calib.formats.ur_arms import (
    MODELS,
    ROUNDING,
    TOLERANCE,
    FullDH,
    UrModel,
    at_flange,
    chain_poses,
    fitted_rows,
    kinematics_hash,
    ur_model,
    ur_robot,
)
from calib.formats.ur_files import (
    Conf,
    UrYaml,
    conf_bytes,
    kinematics_bytes,
    read_kinematics,
    read_nominal,
)
from calib.formats.ur_mount import FARTHEST, SPREAD, Mount, distance_from, the_mount
from calib.model.anchoring import anchored_placements, check_same_joints
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot, read_only

Array = NDArray[np.float64]
PathLike = str | os.PathLike[str]

#: Written rows may differ from the robot by this [m and rad]; and where axes are almost parallel, which is said.
_EXACT, _LESS_EXACT = 1e-9, 1e-6

#: Decimals of mm and mrad in which 1e-9 m and rad can be seen.
_DECIMALS = 6

#: A d is longer than an arm where a common normal stands far away [m].
_LONG = 10.0

#: A calibration that moves the flange further is odd, and beyond the other it is worth looking whether the file fits
#: another arm [m].
_ODD, _SUSPECT = 0.02, 0.01

#: What a file has no place for: displacements of the base and of the flange.
_NO_BASE = (
    "the first axis lies {}, along and about the axes of the controller's base (link 'base'), from where the base has "
    "it. To put this right T_base_frame of the frame that poses are given in becomes T_base^-1 T_base_frame, where "
    "T_base is this displacement."
)
_NO_TOOL = (
    "the flange lies {}, along and about the axes of the controller's flange (link 'tool0'), from where the last joint "
    "has it. To put this right T_flange_tcp of the tool becomes T_tool T_flange_tcp, where T_tool is this displacement."
)

_OWN = "Give the calibration.conf of this robot's own controller."

#: Hashes as the ROS driver makes them.
_HASH = re.compile(r"calib_[0-9]+")


@dataclass(frozen=True, slots=True, eq=False)
class UrSource:
    """What a file of Universal Robots says about an arm.

    Attributes:
        nominal, robot: The robot given, or a bare arm, ``base`` to ``tool0``; and the same chain, calibrated.
        hash: The ROS driver's name for the calibration, ``"calib_..."``; None where the yaml has none.
        model: Which arm it is.
        remarks: What the reader of the file should know, sentence by sentence; most often none.
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
        T_base, T_tool: shape (4, 4), [m]: displacements of the base and of the flange that the file cannot hold.
        remarks: What to tell the user about these and about the file, sentence by sentence; none if it holds all.
    """

    path: Path
    T_base: Array
    T_tool: Array
    remarks: tuple[str, ...]


def read_ur(
    path: PathLike,
    *,
    urcontrol: PathLike | None = None,
    model: UrModel | str | None = None,
    robot: Robot | None = None,
) -> UrSource:
    """The arm that a ``calibration.conf`` or a ``kinematics.yaml`` of the ROS driver describes.

    Args:
        path: The file; one that ends in ``.conf`` needs one of the other three.
        urcontrol: A ``urcontrol.conf`` with the nominal rows in ``[DH]``; default: those of the model.
        model: The arm, or its name, such as ``"UR5e"``; default: what urcontrol or the robot is recognised as, or else
            the arm that a yaml's kinematics are nearest to.
        robot: The nominal robot whose URDF is corrected; default: a bare one, see `ur_robot`.

    Raises:
        FileError: A file cannot be read, or its numbers are not those of a calibration of this arm.
        ModelError: The model is not known, or is not that of the robot, or is not given.
    """
    conf = content = None
    if Path(path).suffix.lower() == ".conf":
        conf = Conf.read(path)
    else:
        content = read_kinematics(path)
    arm = _arm_of(path, urcontrol, model, robot, None if content is None else content.chain)
    advice = "Name the right one with --ur-model, or give its URDF."
    if urcontrol is not None:
        advice = f"Give the urcontrol.conf of the same controller; {urcontrol} is another one's."
    elif robot is not None:
        advice = f"Give the URDF of the right one; {robot.urdf.source} is another one's."
    chain_of = _chain_maker(conf, content)
    nominal = ur_robot(arm) if robot is None else robot
    _, mounted = the_mount(nominal, arm)
    moved = _checked_distance(path, arm, chain_of, advice)
    placements = mounted.placements_of(chain_of(arm), nominal)
    remarks = list(_name_remark(nominal, arm, mounted))
    if moved >= _ODD:
        remarks.append(
            f"{path} moves the flange by up to {1e3 * moved:.0f} mm from the nominal {arm.name}, more than "
            "calibrations do: check that it is of this arm."
        )
    if conf is not None:
        hash: str | None = kinematics_hash(arm.nominal + conf.deltas)
        placements = anchored_placements(placements, nominal.placements, nominal.joints)
        if urcontrol is None:
            options = [("--robot", robot), ("--ur-model", model)]
            named = " and ".join(option for option, value in options if value is not None)
            remarks += _fits_others(path, arm, chain_of, moved, named)
        if conf.status:
            remarks.append(
                f"{path} has calibration_status = {conf.status}, which is not 2, linearised: the controller may not "
                "use these deltas. They were taken as they are; check that the robot is calibrated."
            )
    else:
        hash = content.hash if content is not None else None
        if robot is None and model is None:
            names = [one.name for one in MODELS if one.same(arm.nominal)]
            remarks.insert(
                0,
                f"{path} does not say of which arm it is; its kinematics are those of the {' or '.join(names)}.",
            )
        if hash is None:
            remarks.append(f"{path} has no hash; the ROS driver wants the robot's own.")
    remarks += _hash_remarks(path, hash)
    return UrSource(nominal, nominal.with_placements(placements), hash, arm, tuple(remarks))


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
        path: File to write; it is read back and compared with the robot before it appears.
        hash: The robot's own, that of its own file: the driver compares it with what the controller reports.
        model: The arm, or its name; default: what the nominal robot is recognised as. Give that of the source: an arm
            of a ``urcontrol.conf`` may be near to another one.
        overwrite: Whether a file that exists may be replaced.

    Returns:
        The file, and a displacement of the flange behind the last joint, for which it has no place.

    Raises:
        ModelError: The nominal robot is not a Universal Robots arm, or the robot is no correction of it, or the file
            does not read back.
        FileError: The file cannot be written, or the hash is none.
    """
    arm, mounted, chain = _chain_of(robot, nominal, model)
    chain = at_flange(chain)
    T_tool = np.eye(4) if np.abs(chain[6] - np.eye(4)).max() < ROUNDING else chain[6]
    kind = arm.name if arm.known else "arm"
    comment = f"Kinematics of one Universal Robots {kind}: lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll)."
    data = kinematics_bytes(chain, hash, comment)
    back = read_kinematics(path, data).chain
    _check(robot, mounted, path, lambda q: chain_poses(back, q) @ T_tool, _EXACT)
    written = write_atomically(path, data, overwrite=overwrite)
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
        nominal: The robot that it was corrected from: as of `write_ur_yaml`.
        path: File to write; it is read back and compared with the robot before it appears.
        update: A ``calibration.conf`` of this arm whose other lines are kept; default: the deltas alone.
        like: Deltas whose signs and whole turns are kept, so that what did not change is the same number; default:
            those of ``update``, or else none.
        model: The arm, or its name, as of `write_ur_yaml`.
        overwrite: Whether a file that exists may be replaced.

    Returns:
        The file, and displacements of the base and of the flange, for which standard DH rows have no place.

    Raises:
        ModelError: As of `write_ur_yaml`.
        FileError: A file cannot be read or written.
    """
    arm, mounted, chain = _chain_of(robot, nominal, model)
    old = None
    if update is not None:
        old = Conf.read(update)
        _checked_distance(update, arm, _chain_maker(old, None), _OWN)
        like = old.deltas
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
    data = conf_bytes(fitted.deltas) if old is None else old.with_deltas(fitted.deltas)
    back = arm.nominal + Conf.read(path, data).deltas
    exact = _LESS_EXACT if missed > _EXACT else _EXACT
    _check(robot, mounted, path, lambda q: fitted.T_base @ back.poses(q) @ fitted.T_tool, exact)
    written = write_atomically(path, data, overwrite=overwrite)
    if old is not None and old.others:
        remarks.append(
            f"{', '.join(old.others)} are as in {update}: calib does not know how the controller makes them. Keep a "
            "copy of the controller's own file."
        )
    remarks += _end_remarks(written, fitted.T_base, fitted.T_tool)
    return UrWritten(written, fitted.T_base, fitted.T_tool, tuple(remarks))


def _chain_of(
    robot: Robot, nominal: Robot, model: UrModel | str | None
) -> tuple[UrModel, Mount, Array]:
    """The arm, how it is mounted, and its placements when calibrated, shape (7, 4, 4), [m]."""
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


def _check(
    robot: Robot, mounted: Mount, path: PathLike, flange: Callable[[Array], Array], exact: float
) -> None:
    """Compare a file that was read back, what it has no place for put back, with the robot."""
    q = random_joint_values(robot)
    made = mounted.T_base_arm @ flange(q) @ mounted.T_flange_tip
    off = float(np.abs(made - robot.poses(q)).max())
    if not off <= exact:
        raise ModelError(
            f"{Path(path).name}: read back, it puts the tip of '{robot.name}' {off:.1e} m or rad off; {exact:g} is "
            "allowed, so it is not written. Please report this with what was converted."
        )


# Of which arm a file is


def _arm_of(
    path: PathLike,
    urcontrol: PathLike | None,
    model: UrModel | str | None,
    robot: Robot | None,
    chain: Array | None,
) -> UrModel:
    """The arm that a file is of: as is said, or the one that the chain of a yaml is nearest to."""
    given = None if model is None else ur_model(model)
    if urcontrol is not None:
        rows = read_nominal(urcontrol)
        named = [one.name for one in MODELS if one.same(rows)]
        if given is not None and not given.same(rows):
            is_what = f"those of the {' or '.join(named)}" if named else "no arm's that is known"
            raise ModelError(
                f"The rows in [DH] of {urcontrol} are {is_what}, not those of the {given.name}. Leave the name of the "
                "arm out, or give the urcontrol.conf of this robot's own controller."
            )
        names = [given.name] if given is not None else named
        return UrModel((names or [f"arm of {Path(urcontrol).name}"])[0], rows)
    if robot is not None:
        return the_mount(robot, given)[0]
    if given is None and chain is not None:
        return min(MODELS, key=lambda one: distance_from(chain, one))
    if given is None:
        raise ModelError(
            f"{path}: a calibration.conf has only what is added to an arm's nominal rows. Say of which arm it is, as "
            "in --ur-model UR5e, or give its --urcontrol, or its nominal URDF as --robot."
        )
    return given


def _chain_maker(conf: Conf | None, content: UrYaml | None) -> Callable[[UrModel], Array]:
    """The chain that a file makes of an arm, shape (7, 4, 4), [m]; of a yaml it is the same for every arm."""

    def chain_of(one: UrModel) -> Array:
        if content is not None:
            return content.chain
        assert conf is not None  # it is one of the two
        return (one.nominal + conf.deltas).chain()

    return chain_of


def _checked_distance(
    path: PathLike, arm: UrModel, chain_of: Callable[[UrModel], Array], advice: str
) -> float:
    """How far a calibration moves the flange [m]: some millimetres, and centimetres that of an arm of another size."""
    moved = distance_from(chain_of(arm), arm)
    if moved > _SUSPECT:
        by_arm = {one: distance_from(chain_of(one), one) for one in MODELS}
        least = min(by_arm.values())
        if 3.0 * least < moved:
            names = [one.name for one, distance in by_arm.items() if distance <= 1.5 * least]
            raise FileError(
                f"{path}: this calibration moves the flange of {arm.said} by up to {1e3 * moved:.0f} mm, and that of "
                f"{choices(names)} by {1e3 * least:.1f} mm only. A calibration moves it by millimetres: the file is "
                f"of another arm. {advice}"
            )
    if moved > FARTHEST:
        raise FileError(
            f"{path}: these kinematics put the flange up to {moved:.2f} m from where that of a nominal {arm.name} is; "
            f"a calibration moves it by millimetres. Check that the file is of {arm.said}, in metres and radians."
        )
    return moved


# What is to be said of an arm


def _fits_others(
    path: PathLike,
    arm: UrModel,
    chain_of: Callable[[UrModel], Array],
    moved: float,
    taken_from: str,
) -> tuple[str, ...]:
    """A sentence about the other arms that deltas fit as well, which nothing in them tells apart."""
    most = max(_SUSPECT, 3.0 * moved)
    fitting = [one for one in MODELS if distance_from(chain_of(one), one) <= most]
    apart = max((distance_from(one.nominal.chain(), arm) for one in fitting), default=0.0)
    if apart < TOLERANCE:
        return ()
    return (
        f"The deltas in {path} fit {choices(one.name for one in fitting)} alike: that it is {arm.said} is taken from "
        f"{taken_from}. Taken for the wrong one of these, the flange is up to {1e3 * apart:.0f} mm off. The "
        "controller's urcontrol.conf (--urcontrol) has the rows that are right.",
    )


def _hash_remarks(path: PathLike, hash: str | None) -> tuple[str, ...]:
    """Sentences about a hash that is no robot's own, or of another form than the ROS driver's."""
    names = [one.name for one in MODELS if one.default_hash == hash]
    if names:
        return (
            f"{path} has the hash of the nominal {' or '.join(names)}: it is of no particular robot.",
        )
    if hash is not None and not _HASH.fullmatch(hash):
        return (
            f"The hash '{hash}' in {path} is not of the driver's form, such as 'calib_12788084448423163542': the "
            "driver will not find it equal to the controller's.",
        )
    return ()


def _name_remark(robot: Robot, arm: UrModel, mounted: Mount) -> tuple[str, ...]:
    """A sentence about a robot that is not nominal, whose base and flange were found by name."""
    remark = (
        f"'{robot.name}' ({robot.urdf.source}) is not the nominal {arm.name}: its flange lies up to "
        f"{1e3 * mounted.off:.2g} mm and {1e3 * mounted.turned:.2g} mrad off, because it was calibrated before or its "
        "numbers are rounded. Its base and its flange are taken to be where the names of its links say."
    )
    return () if mounted.off == mounted.turned == 0.0 else (remark,)


def _end_remarks(written: Path, T_base: Array, T_tool: Array) -> tuple[str, ...]:
    """What to do with displacements of the base and of the flange."""
    said = []
    for T, text in ((T_base, _NO_BASE), (T_tool, _NO_TOOL)):
        # Rounded first, so that nothing is said to be -0.
        vectors = [np.round(1e3 * v, _DECIMALS) + 0.0 for v in (T[:3, 3], pin.log3(T[:3, :3]))]
        if np.any(vectors):
            shift, turn = (", ".join(f"{value:.{_DECIMALS}f}" for value in v) for v in vectors)
            said.append(f"Not in {written}: {text.format(f'({shift}) mm and ({turn}) mrad')}")
    return tuple(said)
