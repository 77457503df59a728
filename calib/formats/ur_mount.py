"""How a robot is an arm of Universal Robots: which one, and where its base and its flange are.

A nominal arm is recognised by its axes to a micrometre. Those of a calibrated one do not say where its base and its
flange are, and no axes show an error of the first joint's zero and height or of the last one's: the names of the links
in Universal Robots' descriptions do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import ModelError, UrdfError, choices
from calib.formats.ur_arms import (
    JOINTS,
    MODELS,
    NAMES,
    TOLERANCE,
    UrModel,
    chain_poses,
    frames_at_zero,
)
from calib.model.dh import zero_poses
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: One that is calibrated already may lie this far from it [m; rotation matrices: 1].
CALIBRATED = 0.05

#: Links that are the controller's base, and whether they are turned by half a turn about z against it.
_BASES = (("base_link_inertia", False), ("base", False), ("base_link", True))

#: Links that are its flange. In the old descriptions the last link is not.
_FLANGES = ("tool0", "wrist_3_link")

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

#: No calibration moves a flange further [m].
FARTHEST = 0.2

#: Joint values within one turn at which arms are compared, shape (200, 6), [rad], the same every time.
SPREAD = read_only(np.random.default_rng(20170401).uniform(-np.pi, np.pi, (200, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """How a URDF's frames are fixed to those of an arm: T_base_tip = T_base_arm chain(q) T_flange_tip.

    Attributes:
        T_base_arm, T_flange_tip: shape (4, 4), [m]: the controller's base in the robot's, the tip in its flange.
        T_arm_joint: shape (6, 4, 4), [m]: each joint's frame in the arm's frame of that joint, see `FullDH.chain`; a
            motion along and about the axis.
        off, turned: How far the flange lies from the nominal arm's, at most [m], [rad], where the robot is not nominal,
            and base and flange are where the links' names say; else 0.
    """

    T_base_arm: Array
    T_flange_tip: Array
    T_arm_joint: Array
    off: float = 0.0
    turned: float = 0.0

    def chain_of(self, robot: Robot) -> Array:
        """The placements of a robot mounted so as those of the arm, shape (7, 4, 4), [m]."""
        at, back = self.T_arm_joint, rigid_inverse(self.T_arm_joint)
        P = robot.placements
        first = rigid_inverse(self.T_base_arm) @ rigid_inverse(robot.T_root_base) @ P[0] @ back[0]
        between = [at[i - 1] @ P[i] @ back[i] for i in range(1, 6)]
        return read_only([first, *between, at[5] @ P[6] @ rigid_inverse(self.T_flange_tip)])

    def placements_of(self, chain: Array, robot: Robot) -> Array:
        """The placements of the robot whose arm is this chain: the inverse of `chain_of`."""
        at, back = self.T_arm_joint, rigid_inverse(self.T_arm_joint)
        first = robot.T_root_base @ self.T_base_arm @ chain[0] @ at[0]
        between = [back[i - 1] @ chain[i] @ at[i] for i in range(1, 6)]
        return read_only([first, *between, back[5] @ chain[6] @ self.T_flange_tip])


def recognised(robot: Robot) -> tuple[UrModel, ...]:
    """The arms whose nominal kinematics a robot has, wherever its base and its tip are fixed to them.

    Arms sold under two names are both in it. An arm whose base or flange is a little beside where its links' names have
    it is calibrated, and not nominal.
    """
    return tuple(model for model in MODELS if mount(robot, model) is not None)


def mount(robot: Robot, model: UrModel) -> Mount | None:
    """How a robot's frames are fixed to those of an arm; None where it has not the arm's nominal kinematics."""
    joints = robot.joints
    if tuple(joint.name for joint in joints) != robot.joint_names or len(joints) != 6:
        return None
    if any(joint.type == "prismatic" for joint in joints):
        return None
    T_base_joint, _ = zero_poses(robot)
    axes = [T[:3, :3] @ joint.axis for T, joint in zip(T_base_joint, joints, strict=True)]
    chain = model.nominal.chain()
    frames = frames_at_zero(chain)
    if np.linalg.norm(np.cross(axes[0], axes[1])) < TOLERANCE:
        return None
    # The first two axes and the common normal between them fix the base.
    found = _first_axes(T_base_joint[0][:3, 3], axes[0], T_base_joint[1][:3, 3], axes[1])
    wanted = _first_axes(frames[0][:3, 3], frames[0][:3, 2], frames[1][:3, 3], frames[1][:3, 2])
    T_base_arm = found @ rigid_inverse(wanted)
    on_axes = []
    for T, axis, frame, joint in zip(T_base_joint, axes, frames, joints, strict=False):
        local = rigid_inverse(T_base_arm @ frame)
        z, point = local[:3, :3] @ axis, (local @ T)[:3, 3]
        if max(np.abs(z - [0.0, 0.0, 1.0]).max(), np.abs(point[:2]).max()) > TOLERANCE:
            return None
        on_axes.append(_on_axis(local @ T, joint.axis))
    # Behind the last joint, not at the end of the whole chain, so that a tip without an <origin> keeps its place.
    T_flange_tip = rigid_inverse(chain[6]) @ on_axes[5] @ robot.placements[6]
    if _beside_names(robot, T_base_arm, T_flange_tip):
        return None
    return Mount(read_only(T_base_arm), read_only(T_flange_tip), read_only(on_axes))


def the_mount(robot: Robot, model: UrModel | None = None) -> tuple[UrModel, Mount]:
    """The arm that a robot is (that it must be, if one is given), and how its frames are fixed to the arm's.

    A robot that is calibrated already, such as the URDF that the ROS driver makes, is taken for the arm that it is
    nearest to if its links have the names of Universal Robots' descriptions.

    Raises:
        ModelError: It is not that arm, or none.
    """
    wanted = MODELS if model is None else (model,)
    for candidate in wanted:
        mounted = mount(robot, candidate)
        if mounted is not None:
            return candidate, mounted
    names = [other.name for other in recognised(robot)]
    for T_base_arm, T_flange_tip in () if names else _named_frames(robot):
        arm = rigid_inverse(T_base_arm) @ robot.poses(SPREAD) @ rigid_inverse(T_flange_tip)
        off = [float(np.abs(arm - one.nominal.poses(SPREAD)).max()) for one in wanted]
        if min(off) < CALIBRATED:
            nearest = wanted[int(np.argmin(off))]
            return nearest, _named_mount(robot, nearest, T_base_arm, T_flange_tip, arm)
    chain = f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}'"
    if model is not None:
        others = f"the {' and the '.join(names)}" if names else "no Universal Robots arm"
        raise ModelError(
            f"{chain} has not the nominal kinematics of the {model.name}: it has those of {others}. Name the arm that "
            f"the URDF describes, or give the URDF of the {model.name}."
        )
    raise ModelError(
        f"{chain} has the nominal kinematics of no Universal Robots arm that calib knows ({choices(NAMES, limit=40)}), "
        "nor their links' names. Give the arm's nominal URDF, and a base and a tip with all six joints between them."
    )


def distance_from(chain: Array, arm: UrModel) -> float:
    """How far the flange of a chain, shape (7, 4, 4), lies from that of the nominal arm, at most [m]."""
    moved = chain_poses(chain, SPREAD)[:, :3, 3] - arm.nominal.poses(SPREAD)[:, :3, 3]
    return float(np.linalg.norm(moved, axis=1).max())


def _beside_names(robot: Robot, T_base_arm: Array, T_flange_tip: Array) -> bool:
    """Whether base or flange lie a little beside where the links' names have them, which no axis shows."""
    for named_base, named_flange in _named_frames(robot):
        for T, named in ((T_base_arm, named_base), (T_flange_tip, named_flange)):
            off = np.abs(rigid_inverse(named) @ T - np.eye(4))
            # Further off it is another frame of that name, such as the old description's wrist_3_link.
            if off.max() > TOLERANCE and off[:3, 3].max() < CALIBRATED and off[:3, :3].max() < 0.5:
                return True
    return False


def _named_mount(
    robot: Robot, model: UrModel, T_base_arm: Array, T_flange_tip: Array, arm: Array
) -> Mount:
    """The mount of a robot that is not nominal; its frames are the arm's where they stand as the new description's."""
    on_axes = []
    frames = T_base_arm @ frames_at_zero(model.nominal.chain())
    for T, frame, joint in zip(zero_poses(robot)[0], frames, robot.joints, strict=False):
        on_axes.append(_on_axis(rigid_inverse(frame) @ T, joint.axis, near=CALIBRATED))
    apart = arm[:, :3] - model.nominal.poses(SPREAD)[:, :3]
    off = float(np.linalg.norm(apart[:, :, 3], axis=1).max())
    chord = float(np.linalg.norm(apart[:, :, :3], axis=(1, 2)).max()) / np.sqrt(8.0)
    turned = 2.0 * float(np.arcsin(min(chord, 1.0)))
    return Mount(read_only(T_base_arm), read_only(T_flange_tip), read_only(on_axes), off, turned)


def _first_axes(point: Array, axis: Array, other_point: Array, other: Array) -> Array:
    """A frame with z along an axis, x across it towards another, on their common normal, shape (4, 4)."""
    x = other - axis * (axis @ other)
    x = x / np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(axis, x), axis], axis=1)
    offset, cosine = other_point - point, axis @ other
    along = (axis @ offset - cosine * (other @ offset)) / (1.0 - cosine**2)
    T[:3, 3] = point + axis * along
    return T


def _on_axis(T: Array, axis: Array, near: float = 0.0) -> Array:
    """The pose Tz(s) Rz(phi) R nearest to T, where R turns the axis into z; no s below ``near``, phi a right angle."""
    seed = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = seed - axis * (axis @ seed)
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(axis, x), axis])
    turned = T[:3, :3] @ R.T
    phi = np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
    right = np.round(phi / (np.pi / 2.0)) * np.pi / 2.0
    phi = right if abs(phi - right) < near else phi
    result = np.eye(4)
    result[:3, :3] = pin.rpy.rpyToMatrix(0.0, 0.0, float(phi)) @ R
    result[2, 3] = T[2, 3] if abs(T[2, 3]) >= near else 0.0
    return result


def _named_frames(robot: Robot) -> Iterator[tuple[Array, Array]]:
    """T_base_arm and T_flange_tip, every pair that the links' names allow, the robot's own base and tip first."""
    names = [joint.name for joint in robot.joints]
    prefix = names[0].removesuffix(JOINTS[0])
    if names != [prefix + joint for joint in JOINTS] or robot.joint_names != tuple(names):
        return
    zero = np.zeros(len(names))
    here = robot.poses(zero)[0]
    flanges = sorted(_FLANGES, key=lambda link: prefix + link != robot.tip)
    bases = sorted(_BASES, key=lambda base: prefix + base[0] != robot.base)
    for flange in flanges:
        at_flange = _between(robot, robot.base, prefix + flange)
        for base, turned in bases:
            at_base = _between(robot, prefix + base, robot.tip)
            if at_flange is None or at_base is None:
                continue
            T_base_link = here @ rigid_inverse(at_base.poses(zero)[0])
            T_flange_tip = rigid_inverse(at_flange.poses(zero)[0]) @ here
            yield T_base_link @ _HALF_TURN if turned else T_base_link, T_flange_tip


def _between(robot: Robot, base: str, tip: str) -> Robot | None:
    """The robot between two links, None unless there are both with the same joints between them."""
    try:
        other = robot.rebuilt(base=base, tip=tip)
    except UrdfError:  # no such link, or no joint between them
        return None
    same = [joint.name for joint in other.joints] == [joint.name for joint in robot.joints]
    return other if same and not other.base_moves else None
