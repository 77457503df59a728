"""Arms of Universal Robots: poses of their chains, the hash of their kinematics, and how a robot's URDF is such an arm.

Universal Robots writes standard (distal) DH without any row for nearly parallel axes,

    T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),

so that in a calibrated arm d_2 and d_3 are hundreds of metres. *Rows* are theta, a, d, alpha, shape (6, 4), [rad] and
[m]; a file's deltas are added to nominal ones. A *chain* is the same arm as placements of joints that turn about z,
shape (7, 4, 4): joint i in joint i - 1, the first in the controller's base, the seventh its flange in joint 6; with the
nominal rows these are the poses that ``kinematics.yaml`` gives its six links.

A *mount* says which frames of a URDF are the arm's base and flange. The names of the links in Universal Robots'
descriptions identify them; the axes would not, because they do not show errors of the zero and height of the first
joint and of the last one. The arm is the one with the nearest nominal kinematics.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.errors import ModelError, UrdfError, choices
from calib.model.dh_table import zero_poses
from calib.robot.dh_rows import screw
from calib.robot.robot import Robot
from calib.robot.ur_models import JOINTS, MODELS, UrModel, ur_model, ur_urdf
from calib.robot.urdf import Urdf

SPREAD = read_only(np.random.default_rng(20170401).uniform(-np.pi, np.pi, (200, 6)))
"""Joint values within one turn at which arms are compared, shape (200, 6) [rad], the same every time."""

#: A robot within this of a nominal arm is nominal [m and rad].
_SAME = 1e-6

#: A robot within this of a nominal arm is that arm, calibrated [m and rad].
_CALIBRATED = 0.05

#: From ``base_link`` to the controller's base.
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

#: Links at the controller's base, with the pose of the controller's base in each.
_BASES = (("base_link_inertia", np.eye(4)), ("base", np.eye(4)), ("base_link", _HALF_TURN))

#: Links that are the controller's flange; in the old descriptions the last link is another frame.
_FLANGES = ("tool0", "wrist_3_link")

#: MurmurHash64A works with 64 bits.
_MASK = (1 << 64) - 1

#: The multiplier of MurmurHash64A.
_MULTIPLIER = 0xC6A4A7935BD1E995

#: The seed that GNU's standard library hashes texts with.
_SEED = 0xC70F6907


def ur_robot(model: UrModel | str) -> Robot:
    """Return the nominal robot of an arm, from a URDF whose links are cylinders.

    Args:
        model: The arm or its name.

    Returns:
        The robot from ``base``, the controller's base, to ``tool0``, its flange.

    Raises:
        ModelError: No arm of this name is known.
    """
    model = ur_model(model)
    urdf = Urdf.from_bytes(ur_urdf(model), f"the nominal {model.name}")
    return Robot.from_urdf(urdf, base="base", tip="tool0")


def chain_poses(chain: Array, q: ArrayLike) -> Array:
    """Return the poses of a chain's flange in the controller's base.

    Args:
        chain: Placements of the six joints and the flange, shape (7, 4, 4) [m].
        q: Joint values, shape (N, 6) or (6,) [rad].

    Returns:
        The poses, shape (N, 4, 4) [m].
    """
    joint_values = np.reshape(np.asarray(q, float), (-1, 6))
    T = np.eye(4)[None]
    for placement, column in zip(chain, joint_values.T, strict=False):
        T = T @ placement @ screw(2, column, 0.0)
    return np.asarray(T @ chain[6])


def at_flange(chain: Array) -> Array:
    """Return the same chain with the frame of joint 6 as near to the flange as possible.

    The frame slides along and turns about the joint's axis, which changes no pose of the flange.

    Args:
        chain: Placements of the six joints and the flange, shape (7, 4, 4) [m].

    Returns:
        Placements of the same poses, shape (7, 4, 4) [m], read-only.
    """
    result = np.array(chain)
    T_joint_flange = result[6]
    sine = T_joint_flange[1, 0] - T_joint_flange[0, 1]
    cosine = T_joint_flange[0, 0] + T_joint_flange[1, 1]
    G = screw(2, np.arctan2(sine, cosine), T_joint_flange[2, 3])
    result[5] = result[5] @ G
    result[6] = rigid_inverse(G) @ result[6]
    return read_only(result)


# How a URDF is an arm


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Mount of an arm in a URDF: T_base_tip = T_base_arm chain(q) T_flange_tip."""

    #: The arm.
    model: UrModel
    #: Shape (4, 4), [m], pose of the controller's base in the robot's base.
    T_base_arm: Array
    #: Shape (4, 4), [m], pose of the robot's tip in the controller's flange.
    T_flange_tip: Array
    #: Shape (6, 4, 4), [m], pose of each joint's frame of the URDF in the arm's frame of that joint: a motion along and
    #: about the axis.
    T_arm_joint: Array
    #: Whether the robot has the arm's nominal kinematics.
    nominal: bool

    def chain_of(self, robot: Robot) -> Array:
        """Return the chain of the arm, in the arm's own frames, that a robot with this mount is.

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
        robot: The robot, nominal or calibrated, with the link and joint names of Universal Robots' description, with or
            without a prefix.
        model: The arm that it must be; None: the one of `MODELS` with the nearest kinematics.

    Returns:
        The mount.

    Raises:
        ModelError: The robot is not that arm, or none of the known arms.
    """
    models = MODELS if model is None else (model,)
    for T_base_arm, T_flange_tip in _named_frames(robot):
        poses = rigid_inverse(T_base_arm) @ robot.poses(SPREAD) @ rigid_inverse(T_flange_tip)
        distances = []
        for known in models:
            difference = (poses - chain_poses(known.chain, SPREAD))[:, :3]
            distances.append(float(np.abs(difference).max()))
        nearest = int(np.argmin(distances))
        if distances[nearest] < _CALIBRATED:
            arm = models[nearest]
            is_nominal = distances[nearest] <= _SAME
            # Each joint's frame in the arm's frame of that joint. For a calibrated robot small slides along the axis
            # count as zero, and small turns as right angles.
            near = 0.0 if is_nominal else _CALIBRATED
            T_base_joint = T_base_arm
            frames = []
            for T, P, joint in zip(zero_poses(robot)[0], arm.chain, robot.joints, strict=False):
                T_base_joint = T_base_joint @ P
                frames.append(_on_axis(rigid_inverse(T_base_joint) @ T, joint.axis, near))
            return Mount(
                arm,
                read_only(T_base_arm),
                read_only(T_flange_tip),
                read_only(frames),
                nominal=is_nominal,
            )
    name = f"a {model.name}" if model else "an arm of Universal Robots that calib knows"
    raise ModelError(
        f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}' is not {name}: such an arm has the joints "
        f"{choices(JOINTS)} between base and tip, the link names of Universal Robots' description, and kinematics near "
        "the nominal ones."
    )


def distance_from(chain: Array, arm: UrModel) -> float:
    """Return the largest distance of a chain's flange from that of the nominal arm [m], over poses spread widely.

    Args:
        chain: Placements of the six joints and the flange, shape (7, 4, 4) [m].
        arm: The nominal arm.
    """
    nominal = chain_poses(arm.chain, SPREAD)
    moved = chain_poses(chain, SPREAD)[:, :3, 3] - nominal[:, :3, 3]
    return float(np.linalg.norm(moved, axis=1).max())


def _on_axis(T: Array, axis: Array, near: float) -> Array:
    """Return the pose Tz(s) Rz(phi) R nearest to T, (4, 4) [m], where R turns a joint's axis in the frame T into z.

    A slide s [m] below ``near`` is set to zero, and an angle phi [rad] this near to a right angle to that one.
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
    """Yield T_base_arm and T_flange_tip for every pair of links that can be base and flange, its own ones first."""
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


# The hash of a controller's kinematics


def kinematics_hash(rows: Array) -> str:
    """Return the name that the ROS driver gives a controller's kinematics.

    The driver prints theta, d, a and alpha of one joint after the other with six digits and takes the standard
    library's hash of that text, which in GNU's library is MurmurHash64A.

    Args:
        rows: theta, a, d, alpha of six joints, shape (6, 4), [rad] and [m].

    Returns:
        ``"calib_"`` and the hash.

    Example:
        >>> kinematics_hash(np.zeros((6, 4)))
        'calib_8811247710799071897'
    """
    in_driver_order = rows[:, [0, 2, 1, 3]]
    text = "".join(f"{value:g}" for value in in_driver_order.flat)
    return f"calib_{_murmur_hash(text.encode())}"


def _murmur_hash(data: bytes) -> int:
    """Return the MurmurHash64A of bytes (A. Appleby), with the seed of GNU's standard library."""
    value = (_SEED ^ (len(data) * _MULTIPLIER)) & _MASK
    end_of_words = len(data) & ~7
    for (word,) in struct.iter_unpack("<Q", data[:end_of_words]):
        mixed = (word * _MULTIPLIER) & _MASK
        mixed = ((mixed ^ (mixed >> 47)) * _MULTIPLIER) & _MASK
        value = ((value ^ mixed) * _MULTIPLIER) & _MASK
    if end_of_words < len(data):
        last_word = int.from_bytes(data[end_of_words:], "little")
        value = ((value ^ last_word) * _MULTIPLIER) & _MASK
    value = ((value ^ (value >> 47)) * _MULTIPLIER) & _MASK
    return value ^ (value >> 47)
