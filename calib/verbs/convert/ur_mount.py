"""How a robot's URDF is mounted on an arm of Universal Robots: which frames are the arm's base and flange.

The names of the links in Universal Robots' descriptions say where the controller's base and flange are: no axes show an
error of the first joint's zero and height or of the last one's. The arm is the one with the nearest nominal kinematics.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.errors import ModelError, UrdfError, choices
from calib.model.dh_table import zero_poses
from calib.robot.generated.universal_robots import JOINTS, MODELS, UrModel
from calib.robot.robot import Robot
from calib.verbs.convert.ur_arms import SPREAD, chain_poses

#: A robot within this of a nominal arm is nominal [m and rad].
_SAME = 1e-6

#: A robot within this of a nominal arm is that arm, calibrated [m and rad].
_CALIBRATED = 0.05

#: From ``base_link`` to the controller's base.
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

#: Links at the controller's base, with the pose of the controller's base in each.
_BASES = (("base_link_inertia", np.eye(4)), ("base", np.eye(4)), ("base_link", _HALF_TURN))

#: Links that are the controller's flange; in the old descriptions the last link is not.
_FLANGES = ("tool0", "wrist_3_link")


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Mount of an arm in a URDF: T_base_tip = T_base_arm chain(q) T_flange_tip."""

    #: The arm.
    model: UrModel
    #: Shape (4, 4), [m], pose of the controller's base in the robot's base.
    T_base_arm: Array
    #: Shape (4, 4), [m], pose of the robot's tip in the controller's flange.
    T_flange_tip: Array
    #: shape (6, 4, 4), [m], pose of each joint's frame of the URDF in the arm's frame of that joint: a motion along and
    #: about the axis.
    T_arm_joint: Array
    #: Whether the robot has the arm's nominal kinematics.
    nominal: bool

    def chain_of(self, robot: Robot) -> Array:
        """Return the chain of the arm that a robot with this mount is.

        Args:
            robot: A robot with the frames of the URDF, nominal or calibrated.

        Returns:
            Placements of the arm's joints and flange, shape (7, 4, 4) [m], see `UrModel.chain`.
        """
        P = robot.placements
        to_joint = self.T_arm_joint
        from_joint = rigid_inverse(to_joint)
        T_arm_root = rigid_inverse(self.T_base_arm) @ rigid_inverse(robot.T_root_base)
        first = T_arm_root @ P[0] @ from_joint[0]
        between = [to_joint[i - 1] @ P[i] @ from_joint[i] for i in range(1, 6)]
        last = to_joint[5] @ P[6] @ rigid_inverse(self.T_flange_tip)
        return read_only([first, *between, last])

    def placements_of(self, chain: Array, robot: Robot) -> Array:
        """Return the placements of the robot whose arm is a chain: the inverse of `chain_of`.

        Args:
            chain: Placements of the arm's joints and flange, shape (7, 4, 4) [m].
            robot: A robot with the frames of the URDF.

        Returns:
            Placements of the robot's joints and tip, shape (7, 4, 4) [m].
        """
        to_joint = self.T_arm_joint
        from_joint = rigid_inverse(to_joint)
        first = robot.T_root_base @ self.T_base_arm @ chain[0] @ to_joint[0]
        between = [from_joint[i - 1] @ chain[i] @ to_joint[i] for i in range(1, 6)]
        last = from_joint[5] @ chain[6] @ self.T_flange_tip
        return read_only([first, *between, last])


def the_mount(robot: Robot, model: UrModel | None = None) -> Mount:
    """Find how a robot's frames are fixed to those of the arm that it is.

    Args:
        robot: The robot, nominal or calibrated, with the link and joint names of Universal
            Robots' description, with or without a prefix.
        model: The arm that it must be; None: the one of `MODELS` with the nearest kinematics.

    Returns:
        The mount.

    Raises:
        ModelError: The robot is not that arm, or none of the known arms.
    """
    models = MODELS if model is None else (model,)
    for T_base_arm, T_flange_tip in _named_frames(robot):
        poses = rigid_inverse(T_base_arm) @ robot.poses(SPREAD) @ rigid_inverse(T_flange_tip)
        nearest, distance = _nearest_arm(poses, models)
        if distance < _CALIBRATED:
            is_nominal = distance <= _SAME
            T_arm_joint = _joint_frames(robot, nearest, T_base_arm, is_nominal=is_nominal)
            return Mount(
                nearest,
                read_only(T_base_arm),
                read_only(T_flange_tip),
                read_only(T_arm_joint),
                nominal=is_nominal,
            )
    name = model.name if model else "arm of Universal Robots that calib knows"
    raise ModelError(
        f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}' is no {name}: that has the "
        f"joints {choices(JOINTS)} between base and tip, the link names of Universal Robots' "
        "description, and kinematics near the nominal ones."
    )


def distance_from(chain: Array, arm: UrModel) -> float:
    """Return the largest distance of a chain's flange from that of the nominal arm [m].

    Args:
        chain: Placements, shape (7, 4, 4) [m].
        arm: The arm.
    """
    nominal = chain_poses(arm.chain, SPREAD)
    moved = chain_poses(chain, SPREAD)[:, :3, 3] - nominal[:, :3, 3]
    return float(np.linalg.norm(moved, axis=1).max())


def _nearest_arm(poses: Array, models: Sequence[UrModel]) -> tuple[UrModel, float]:
    """Return the arm with the nearest nominal flange poses, and the largest difference [m and rad].

    ``poses`` are those of the flange in the controller's base at `SPREAD`, shape (N, 4, 4).
    """
    distances = []
    for model in models:
        difference = (poses - chain_poses(model.chain, SPREAD))[:, :3]
        distances.append(float(np.abs(difference).max()))
    nearest = int(np.argmin(distances))
    return models[nearest], distances[nearest]


def _joint_frames(robot: Robot, arm: UrModel, T_base_arm: Array, *, is_nominal: bool) -> Array:
    """Return the pose of each joint's frame in the arm's frame of that joint, (6, 4, 4) [m].

    Of a nominal robot they are as they are; of a calibrated one small slides along the axis count
    as zero and small turns as right angles.
    """
    near = 0.0 if is_nominal else _CALIBRATED
    T_base_joint = T_base_arm
    result = []
    for T, P, joint in zip(zero_poses(robot)[0], arm.chain, robot.joints, strict=False):
        T_base_joint = T_base_joint @ P
        result.append(_on_axis(rigid_inverse(T_base_joint) @ T, joint.axis, near))
    return np.array(result)


def _on_axis(T: Array, axis: Array, near: float) -> Array:
    """Return the pose Tz(s) Rz(phi) R nearest to T, where R turns the axis into z.

    Args:
        T: The pose, shape (4, 4) [m].
        axis: Unit axis of a joint in the frame T.
        near: A slide s [m] below this is zero, an angle phi [rad] this near to a right angle is
            one.

    Returns:
        The pose, shape (4, 4) [m].
    """
    seed = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = seed - axis * (axis @ seed)
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(axis, x), axis])
    turned = T[:3, :3] @ R.T
    phi = np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
    right_angle = np.round(phi / (np.pi / 2.0)) * np.pi / 2.0
    if abs(phi - right_angle) < near:
        phi = right_angle
    result = np.eye(4)
    result[:3, :3] = pin.rpy.rpyToMatrix(0.0, 0.0, float(phi)) @ R
    if abs(T[2, 3]) >= near:
        result[2, 3] = T[2, 3]
    return result


def _named_frames(robot: Robot) -> Iterator[tuple[Array, Array]]:
    """Return T_base_arm and T_flange_tip for every pair of links that can be base and flange.

    The robot's own base and tip come first; none if its joints are not those of such an arm.
    """
    names = [joint.name for joint in robot.joints]
    prefix = names[0].removesuffix(JOINTS[0])
    has_names = names == [prefix + joint for joint in JOINTS]
    if not has_names or robot.joint_names != tuple(names):
        return
    T_base_tip = _zero_pose(robot)
    flanges = sorted(_FLANGES, key=lambda link: prefix + link != robot.tip)
    bases = sorted(_BASES, key=lambda base: prefix + base[0] != robot.base)
    for flange, (base, T_link_arm) in itertools.product(flanges, bases):
        try:
            to_flange = robot.rebuilt(tip=prefix + flange)
            arm = to_flange.rebuilt(base=prefix + base)
        except UrdfError:  # no such link, or no joint between them
            continue
        if [joint.name for joint in arm.joints] != names or arm.base_moves:
            continue
        T_base_flange = _zero_pose(to_flange)
        T_base_link = T_base_flange @ rigid_inverse(_zero_pose(arm))
        yield T_base_link @ T_link_arm, rigid_inverse(T_base_flange) @ T_base_tip


def _zero_pose(robot: Robot) -> Array:
    """Return the pose of a robot's tip in its base with all joints at zero, (4, 4) [m]."""
    return np.asarray(robot.poses(np.zeros(len(robot.joint_names)))[0])
