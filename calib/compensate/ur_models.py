"""The Universal Robots arms: their nominal kinematics, a bare URDF of each, and how to recognise one in a URDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.compensate.ur_dh import FullDH, kinematics_hash
from calib.compensate.ur_frames import JOINTS, named_frames
from calib.errors import ModelError, choices
from calib.model.dh import zero_poses
from calib.model.robot import Robot, read_only, rigid_inverse
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
"""What ``kinematics.yaml`` calls the six links."""

#: d1, a2, a3, d4, d5, d6 [m], from Universal Robots' article "DH parameters for calculations of kinematics and
#: dynamics" and the descriptions and solvers for ROS that cite it. The UR7e and the UR12e are the UR5e and the UR10e
#: under the names of 2025. All but the UR8 Long, the UR15 and the UR18 give the hash that is published with them.
_LENGTHS = {
    "UR3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "UR3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "UR5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "UR5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "UR7e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "UR8 Long": (0.2186, -0.8989, -0.7149, 0.1824, 0.1361, 0.1434),
    "UR10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "UR10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "UR12e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "UR15": (0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    "UR16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "UR18": (0.2186, -0.475, -0.3389, 0.1824, 0.1361, 0.1434),
    "UR20": (0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
    "UR30": (0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
}

#: Half of pi as the controllers' own files write it [rad].
_HALF_PI = 1.570796327

#: A robot that is an arm of the table may lie this far from it [m and rad].
TOLERANCE = 1e-6

#: One that is calibrated already may lie this far from it [m; rotation matrices: 1].
CALIBRATED = 0.05

#: Joint values at which arms are compared, shape (50, 6), [rad].
_SPREAD = read_only(np.random.default_rng(20170401).uniform(-np.pi, np.pi, (50, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class UrModel:
    """One type of arm.

    Attributes:
        name: Such as ``"UR5e"``.
        nominal: Its nominal DH rows.
    """

    name: str
    nominal: FullDH

    @property
    def default_hash(self) -> str:
        """What the ROS driver makes of the nominal rows."""
        return kinematics_hash(self.nominal)


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """How a URDF's frames are fixed to those of an arm: T_base_tip = T_base_arm chain(q) T_flange_tip.

    Attributes:
        T_base_arm: shape (4, 4), [m]: the controller's base in the robot's base.
        T_flange_tip: shape (4, 4), [m]: the robot's tip in the controller's flange.
        T_arm_joint: shape (6, 4, 4), [m]: each joint's frame in the arm's frame of that joint, see `FullDH.chain`; a
            motion along and about the axis.
        off: How far the flange lies from the nominal arm's, at most [m], where the robot is not nominal, and base and
            flange are where the links' names say; else 0.
    """

    T_base_arm: Array
    T_flange_tip: Array
    T_arm_joint: Array
    off: float = 0.0

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


#: The arms by name.
_MODELS = {
    name: UrModel(
        name,
        FullDH(
            theta=np.zeros(6),
            a=np.array([0.0, a2, a3, 0.0, 0.0, 0.0]),
            d=np.array([d1, 0.0, 0.0, d4, d5, d6]),
            alpha=np.array([_HALF_PI, 0.0, 0.0, _HALF_PI, -_HALF_PI, 0.0]),
        ),
    )
    for name, (d1, a2, a3, d4, d5, d6) in _LENGTHS.items()
}

MODELS = tuple(_MODELS.values())
"""The arms that are known."""


def ur_model(name: str) -> UrModel:
    """The arm of that name, whatever its capitals, spaces and underscores.

    Raises:
        ModelError: There is none.

    Example:
        >>> ur_model("ur5e").nominal.a.tolist()
        [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
    """
    for model in MODELS:
        if _plain(model.name) == _plain(name):
            return model
    message = (
        f"'{name}' is not an arm of Universal Robots that calib knows: {choices(_MODELS, limit=40)}. For another one "
        "give its urcontrol.conf, which has the nominal rows."
    )
    raise ModelError(message)


def recognised(robot: Robot) -> tuple[UrModel, ...]:
    """The arms whose nominal kinematics a robot has, wherever its base and its tip are fixed to them.

    So any description is recognised, whichever frames it uses: ``base``, ``base_link`` or ``base_link_inertia``,
    ``wrist_3_link``, ``flange``, ``tool0`` or a tool behind it. Arms sold under two names are both in the result.
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
    frames = _poses(chain)
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
    return Mount(read_only(T_base_arm), read_only(T_flange_tip), read_only(on_axes))


def the_mount(robot: Robot, model: UrModel | None = None) -> tuple[UrModel, Mount]:
    """The arm that a robot is, and how its frames are fixed to the arm's.

    A robot that is calibrated already, such as the URDF that the ROS driver makes, is taken for the arm that it is
    nearest to if its links have the names of Universal Robots' descriptions.

    Args:
        robot: The robot.
        model: The arm that it must be; default: the first that it is recognised as.

    Raises:
        ModelError: It is not that arm, or none.
    """
    wanted = MODELS if model is None else (model,)
    for candidate in wanted:
        mounted = mount(robot, candidate)
        if mounted is not None:
            return candidate, mounted
    if not recognised(robot):
        for T_base_arm, T_flange_tip in named_frames(robot):
            arm = rigid_inverse(T_base_arm) @ robot.poses(_SPREAD) @ rigid_inverse(T_flange_tip)
            off = {one: np.abs(arm - one.nominal.poses(_SPREAD)).max() for one in wanted}
            nearest = min(wanted, key=lambda one: float(off[one]))
            if off[nearest] < CALIBRATED:
                return nearest, _named_mount(robot, nearest, T_base_arm, T_flange_tip, arm)
    names = [other.name for other in recognised(robot)]
    if model is not None:
        is_what = (
            f"has those of the {' and the '.join(names)}"
            if names
            else "has those of no Universal Robots arm"
        )
        message = (
            f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}' has not the nominal kinematics of the "
            f"{model.name}: it {is_what}. Name the arm that the URDF describes, or give the URDF of the {model.name}."
        )
        raise ModelError(message)
    message = (
        f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}' has the nominal kinematics of no Universal "
        f"Robots arm that calib knows ({choices(_MODELS, limit=40)}), nor their links' names. Give the arm's nominal "
        "URDF, and a base and a tip with all six joints between them."
    )
    raise ModelError(message)


def ur_robot(model: UrModel | str) -> Robot:
    """A bare URDF of an arm with its nominal kinematics, from ``base``, the controller's, to ``tool0``, its flange.

    Links, joints and origins are those of Universal Robots' description for ROS 2, without bodies.

    Raises:
        ModelError: No arm has that name.

    Example:
        >>> ur_robot("ur5e")
        Robot('ur5e', base to tool0, 6 joints)
    """
    model = ur_model(model) if isinstance(model, str) else model
    data = _urdf_text(model).encode()
    urdf = Urdf.from_bytes(data, f"the nominal {model.name}")
    return Robot.from_urdf(urdf, base="base", tip="tool0")


def with_chain(robot: Robot, mounted: Mount, chain: Array) -> Robot:
    """The robot whose arm has these placements, its URDF changed to match."""
    return robot.with_placements(mounted.placements_of(chain, robot))


def _named_mount(
    robot: Robot, model: UrModel, T_base_arm: Array, T_flange_tip: Array, arm: Array
) -> Mount:
    """The mount of a robot that is not nominal; its frames are the arm's where they stand as the new description's."""
    on_axes = []
    frames = T_base_arm @ _poses(model.nominal.chain())
    for T, frame, joint in zip(zero_poses(robot)[0], frames, robot.joints, strict=False):
        on_axes.append(_on_axis(rigid_inverse(frame) @ T, joint.axis, near=CALIBRATED))
    moved = arm[:, :3, 3] - model.nominal.poses(_SPREAD)[:, :3, 3]
    off = float(np.linalg.norm(moved, axis=1).max())
    return Mount(read_only(T_base_arm), read_only(T_flange_tip), read_only(on_axes), off)


def _plain(name: str) -> str:
    """A name without capitals, spaces, hyphens and underscores."""
    return "".join(letter for letter in name.lower() if letter not in " -_")


def _poses(chain: Array) -> Array:
    """The poses of a chain's frames in its base at q = 0, shape (7, 4, 4), [m]."""
    poses = np.array(chain)
    for i in range(1, len(poses)):
        poses[i] = poses[i - 1] @ poses[i]
    return poses


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


def _urdf_text(model: UrModel) -> str:
    """The bare URDF; where nothing turns, an <origin> of the nominal rows says so exactly."""
    name = _plain(model.name)
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- Nominal kinematics of the Universal Robots {model.name}, without bodies: efforts and speeds are only",
        "     there because a URDF must have them. -->",
        f'<robot name="{name}">',
        *_fixed("base_link", None, "", "0.0 0.0 0.0"),
        *_fixed(
            "base_link_inertia", "base_link", "base_link-base_link_inertia", f"0.0 0.0 {np.pi}"
        ),
        *_fixed("base", "base_link", "base_link-base_fixed_joint", f"0.0 0.0 {np.pi}"),
    ]
    parent = "base_link_inertia"
    for link, joint, placement in zip(LINKS, JOINTS, model.nominal.chain(), strict=False):
        bound = np.pi if joint == "elbow_joint" else 2.0 * np.pi
        lines += [
            f'  <link name="{link}_link"/>',
            f'  <joint name="{joint}" type="revolute">',
            f"    {_origin(placement)}",
            f'    <parent link="{parent}"/>',
            f'    <child link="{link}_link"/>',
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="{-bound}" upper="{bound}" effort="1000" velocity="{np.pi}"/>',
            "  </joint>",
        ]
        parent = f"{link}_link"
    half = np.pi / 2.0
    lines += [
        *_fixed("ft_frame", parent, "wrist_3_link-ft_frame", f"{np.pi} 0.0 0.0"),
        *_fixed("flange", parent, "wrist_3-flange", f"0.0 {-half} {-half}"),
        *_fixed("tool0", "flange", "flange-tool0", f"{half} 0.0 {half}"),
        "</robot>",
        "",
    ]
    return "\n".join(lines)


def _fixed(link: str, parent: str | None, joint: str, rpy: str) -> list[str]:
    """A link, and the fixed joint that turns it in its parent."""
    lines = [f'  <link name="{link}"/>']
    if parent is None:
        return lines
    return [
        *lines,
        f'  <joint name="{joint}" type="fixed">',
        f'    <origin xyz="0.0 0.0 0.0" rpy="{rpy}"/>',
        f'    <parent link="{parent}"/>',
        f'    <child link="{link}"/>',
        "  </joint>",
    ]


def _origin(T: Array) -> str:
    """An <origin> with numbers that read back exactly."""
    xyz = " ".join(repr(float(value) + 0.0) for value in T[:3, 3])
    rpy = " ".join(repr(float(value) + 0.0) for value in pin.rpy.matrixToRpy(T[:3, :3]))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'
