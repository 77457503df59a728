"""The Universal Robots arms: their DH rows, a chain of them, a bare URDF of each, and how a robot is one of them.

Universal Robots writes standard (distal) DH without any row for nearly parallel axes,

    T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),

so that in a calibrated arm d_2 and d_3 are hundreds of metres. *Rows* are theta, a, d, alpha, shape (6, 4), [rad] and
[m]; a file's deltas are added to nominal ones. A *chain* is the same arm as placements of joints that turn about z,
shape (7, 4, 4): joint i in joint i - 1, the first in the controller's base, the seventh its flange in joint 6; with the
nominal rows these are the poses that ``kinematics.yaml`` gives its six links.

The names of the links in Universal Robots' descriptions say where the controller's base and flange are: no axes show an
error of the first joint's zero and height or of the last one's. The arm is the one with the nearest nominal kinematics.

A joint's frame may slide along and turn about the joint's axis without any pose changing: that motion G_i commutes
with the joint's own, so that P_i' = P_i G_i, P_(i+1)' = G_i^-1 P_(i+1) are the placements of the same robot. DH rows
leave that choice to the common normals; `anchored_placements` puts frame i where the next axis, or the tip, lies in
link i as near as it can to where the nominal robot has it, and else nearest to its nominal pose in link i - 1.
"""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.errors import ModelError, UrdfError, choices
from calib.model.dh import screw, zero_poses
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import Urdf
from calib.units import Array

COLUMNS = ("theta", "a", "d", "alpha")
"""The columns of the rows."""

_NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINTS = tuple(f"{name}_joint" for name in _NAMES)
"""The joints of Universal Robots' descriptions; a prefix may stand before them."""

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

#: A robot that is a nominal arm may lie this far from it, one that is calibrated already this far [m and rad].
_SAME, _CALIBRATED = 1e-6, 0.05

#: Links that are the controller's base, or turned against it; links that are its flange: in the old descriptions the
#: last link is not.
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
_BASES = (("base_link_inertia", np.eye(4)), ("base", np.eye(4)), ("base_link", _HALF_TURN))
_FLANGES = ("tool0", "wrist_3_link")

SPREAD = read_only(np.random.default_rng(20170401).uniform(-np.pi, np.pi, (200, 6)))
"""Joint values within one turn at which arms are compared [rad], the same every time."""

#: Half of pi as the controllers' own files write it [rad].
_HALF_PI = 1.570796327

_MASK = (1 << 64) - 1
_MULTIPLIER = 0xC6A4A7935BD1E995
_SEED = 0xC70F6907


@dataclass(frozen=True, slots=True, eq=False)
class UrModel:
    """One type of arm.

    ``name`` is such as ``"UR5e"``, of an arm that calib does not know ``"arm of urcontrol.conf"``; ``rows`` are the
    nominal ones, shape (6, 4).
    """

    name: str
    rows: Array

    @property
    def known(self) -> bool:
        """Whether Universal Robots sells it under this name."""
        return self.name in _LENGTHS

    @property
    def plain(self) -> str:
        """The name without capitals and spaces."""
        return self.name.lower().replace(" ", "")

    @property
    def chain(self) -> Array:
        """The nominal chain, shape (7, 4, 4), [m]."""
        return chain_of_rows(self.rows)

    def same(self, rows: Array) -> bool:
        """Whether rows are those of this type of arm."""
        return bool(np.abs(self.rows - rows).max() < _SAME)


def _known(name: str, d1: float, a2: float, a3: float, d4: float, d5: float, d6: float) -> UrModel:
    """An arm with these lengths."""
    a, d = (0.0, a2, a3, 0.0, 0.0, 0.0), (d1, 0.0, 0.0, d4, d5, d6)
    alpha = (_HALF_PI, 0.0, 0.0, _HALF_PI, -_HALF_PI, 0.0)
    return UrModel(name, read_only(np.transpose([np.zeros(6), a, d, alpha])))


MODELS = tuple(_known(name, *lengths) for name, lengths in _LENGTHS.items())
"""The arms that are known."""


def ur_model(name: str | UrModel) -> UrModel:
    """The arm of that name, whatever its capitals, spaces and underscores; an arm itself is returned.

    Example:
        >>> ur_model("ur5e").rows[:, 1].tolist()
        [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
    """
    if isinstance(name, UrModel):
        return name
    for model in MODELS:
        if model.plain == re.sub("[ _-]", "", name.lower()):
            return model
    raise ModelError(
        f"'{name}' is not an arm of Universal Robots that calib knows: {choices(_LENGTHS, limit=40)}. For another one "
        "give its urcontrol.conf, which has the nominal rows."
    )


def ur_robot(model: UrModel | str) -> Robot:
    """A bare URDF of an arm with its nominal kinematics, from ``base``, the controller's, to ``tool0``, its flange.

    Links, joints and origins are those of Universal Robots' description for ROS 2, without bodies.
    """
    model = ur_model(model)
    urdf = Urdf.from_bytes(_urdf_text(model).encode(), f"the nominal {model.name}")
    return Robot.from_urdf(urdf, base="base", tip="tool0")


def chain_of_rows(rows: Array) -> Array:
    """The placements of the joints of rows (6, 4), shape (7, 4, 4), [m]; see the module's text."""
    theta, a, d, alpha = rows.T
    links = [screw(2, theta[i], 0.0) @ screw(0, alpha[i], a[i]) for i in range(6)]
    # Where each joint's frame lies on its axis: at the end of its d, but for those of parallel axes.
    at = [screw(2, 0.0, d[i]) for i in range(6)]
    placements = [
        at[0],
        links[0],
        at[1] @ links[1],
        at[2] @ links[2] @ at[3],
        links[3] @ at[4],
        links[4] @ at[5] @ screw(2, theta[5], 0.0),
        screw(0, alpha[5], a[5]),
    ]
    return read_only(placements)


def chain_poses(chain: Array, q: ArrayLike) -> Array:
    """The flange in the controller's base at q (N, 6) or (6,) [rad], of a chain (7, 4, 4); shape (N, 4, 4), [m]."""
    T = np.eye(4)[None]
    for placement, column in zip(chain, np.reshape(np.asarray(q, float), (-1, 6)).T, strict=False):
        T = T @ placement @ screw(2, column, 0.0)
    return np.asarray(T @ chain[6])


def at_flange(chain: Array) -> Array:
    """The same chain with joint 6 slid along and turned about its axis so that it is nearest to the flange."""
    result = np.array(chain)
    R = result[6]
    G = screw(2, np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]), R[2, 3])
    result[5], result[6] = result[5] @ G, rigid_inverse(G) @ result[6]
    return read_only(result)


def kinematics_hash(rows: Array) -> str:
    """What the ROS driver calls a controller's kinematics: ``"calib_"`` and a hash of its DH rows (6, 4).

    It prints theta, d, a and alpha of one joint after the other with six digits and takes the standard
    library's hash of that text, which in GNU's library is MurmurHash64A.

    Example:
        >>> kinematics_hash(np.zeros((6, 4)))
        'calib_8811247710799071897'
    """
    data = "".join(f"{value:g}" for value in rows[:, [0, 2, 1, 3]].flat).encode()
    value = (_SEED ^ (len(data) * _MULTIPLIER)) & _MASK
    whole = len(data) & ~7
    for (word,) in struct.iter_unpack("<Q", data[:whole]):
        mixed = (word * _MULTIPLIER) & _MASK
        mixed = ((mixed ^ (mixed >> 47)) * _MULTIPLIER) & _MASK
        value = ((value ^ mixed) * _MULTIPLIER) & _MASK
    if whole < len(data):
        value = ((value ^ int.from_bytes(data[whole:], "little")) * _MULTIPLIER) & _MASK
    value = ((value ^ (value >> 47)) * _MULTIPLIER) & _MASK
    return f"calib_{value ^ (value >> 47)}"


def _urdf_text(model: UrModel) -> str:
    """The bare URDF; where nothing turns, an <origin> of the nominal rows says so exactly."""
    half, pi = np.pi / 2.0, np.pi
    links = ["base_link_inertia", *(f"{link}_link" for link in LINKS)]
    chain = [(tuple(T[:3, 3]), tuple(pin.rpy.matrixToRpy(T[:3, :3]))) for T in model.chain]
    here = (0.0, 0.0, 0.0)
    joints = [
        ("base_link-base_link_inertia", "base_link", links[0], here, (0.0, 0.0, pi)),
        ("base_link-base_fixed_joint", "base_link", "base", here, (0.0, 0.0, pi)),
        *((JOINTS[i], links[i], links[i + 1], *chain[i]) for i in range(6)),
        ("wrist_3_link-ft_frame", links[-1], "ft_frame", here, (pi, 0.0, 0.0)),
        ("wrist_3-flange", links[-1], "flange", here, (0.0, -half, -half)),
        ("flange-tool0", "flange", "tool0", here, (half, 0.0, half)),
    ]
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- Kinematics of a Universal Robots {model.name}, without bodies, by calib: efforts and speeds are only",
        "     there because a URDF must have them. -->",
        f'<robot name="{model.plain}">',
        '  <link name="base_link"/>',
    ]
    for joint, parent, child, *origin in joints:
        xyz, rpy = (" ".join(repr(float(value) + 0.0) for value in one) for one in origin)
        lines += [
            f'  <link name="{child}"/>',
            f'  <joint name="{joint}" type="{"revolute" if joint in JOINTS else "fixed"}">',
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
        ]
        if joint in JOINTS:
            bound = pi if joint == "elbow_joint" else 2.0 * pi
            lines += [
                '    <axis xyz="0 0 1"/>',
                f'    <limit lower="{-bound}" upper="{bound}" effort="1000" velocity="{pi}"/>',
            ]
        lines.append("  </joint>")
    return "\n".join([*lines, "</robot>", ""])


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """How a URDF's frames are fixed to those of an arm: T_base_tip = T_base_arm chain(q) T_flange_tip."""

    model: UrModel
    T_base_arm: Array  #: shape (4, 4), [m], the controller's base in the robot's.
    T_flange_tip: Array  #: shape (4, 4), [m], the robot's tip in the flange.
    T_arm_joint: Array
    """shape (6, 4, 4), [m], each joint's frame in the arm's of that joint: a motion along and about the axis."""
    nominal: bool  #: Whether the robot has the arm's nominal kinematics.

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


def the_mount(robot: Robot, model: UrModel | None = None) -> Mount:
    """How a robot's frames are fixed to those of the arm that it is, or that it must be; `ModelError` if it is not."""
    wanted = MODELS if model is None else (model,)
    for T_base_arm, T_flange_tip in _named_frames(robot):
        arm = rigid_inverse(T_base_arm) @ robot.poses(SPREAD) @ rigid_inverse(T_flange_tip)
        apart = [float(np.abs((arm - chain_poses(m.chain, SPREAD))[:, :3]).max()) for m in wanted]
        nearest, off = wanted[int(np.argmin(apart))], min(apart)
        if off < _CALIBRATED:
            near = _CALIBRATED if off > _SAME else 0.0
            frame, on_axes = T_base_arm, []
            for T, P, joint in zip(zero_poses(robot)[0], nearest.chain, robot.joints, strict=False):
                frame = frame @ P
                on_axes.append(_on_axis(rigid_inverse(frame) @ T, joint.axis, near))
            base, tip, joints = map(read_only, (T_base_arm, T_flange_tip, np.array(on_axes)))
            return Mount(nearest, base, tip, joints, nominal=off <= _SAME)
    raise ModelError(
        f"The robot '{robot.name}' from '{robot.base}' to '{robot.tip}' is no "
        f"{model.name if model else 'arm of Universal Robots that calib knows'}: that has the joints {choices(JOINTS)} "
        "between base and tip, the link names of Universal Robots' description, and kinematics near the nominal ones."
    )


def distance_from(chain: Array, arm: UrModel) -> float:
    """How far the flange of a chain, shape (7, 4, 4), lies from that of the nominal arm, at most [m]."""
    nominal = chain_poses(arm.chain, SPREAD)
    moved = chain_poses(chain, SPREAD)[:, :3, 3] - nominal[:, :3, 3]
    return float(np.linalg.norm(moved, axis=1).max())


def _on_axis(T: Array, axis: Array, near: float) -> Array:
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
    for flange, (base, turn) in itertools.product(flanges, bases):
        try:
            at_flange = robot.rebuilt(tip=prefix + flange)
            arm = at_flange.rebuilt(base=prefix + base)
        except UrdfError:  # no such link, or no joint between them
            continue
        if [joint.name for joint in arm.joints] == names and not arm.base_moves:
            T_base_flange = at_flange.poses(zero)[0]
            T_base_link = T_base_flange @ rigid_inverse(arm.poses(zero)[0])
            yield T_base_link @ turn, rigid_inverse(T_base_flange) @ here


# Frames near the nominal ones

#: Where two axes of a link lie closer to parallel than this, they do not say how far along them a frame stands [rad].
PARALLEL_RAD = np.radians(30.0)

#: A distance of two axes below this gives no direction [m].
_COINCIDENT = 1e-3


def anchored_placements(placements: Array, nominal: Array, axes: Sequence[Array]) -> Array:
    """Other placements of the same chain, near the nominal ones, all (n + 1, 4, 4), [m]; see the module's text.

    ``axes`` are those of the joints, in their own frames; all turn.
    """
    result = np.array(placements, dtype=np.float64)
    for i, axis in enumerate(axes):
        P, own = result[i], nominal[i]
        # The motion along and about the axis that brings the frame nearest to its nominal pose.
        G = _turn(axis, _least_turn(own[:3, :3].T @ P[:3, :3], axis))
        G[:3, 3] = axis * (axis @ P[:3, :3].T @ (own[:3, 3] - P[:3, 3]))
        behind = rigid_inverse(G) @ result[i + 1]
        if i + 1 == len(axes):
            G = G @ _to_tip(behind, nominal[i + 1], axis)
        else:
            G = G @ _to_next_axis(behind, nominal[i + 1], axis, axes[i + 1])
        result[i] = P @ G
        result[i + 1] = rigid_inverse(G) @ result[i + 1]
    return read_only(result)


def _to_tip(T: Array, nominal: Array, axis: Array) -> Array:
    """The motion of the last frame that brings the tip, now at T in it, nearest to its nominal pose."""
    G = _turn(axis, -_least_turn(T[:3, :3] @ nominal[:3, :3].T, axis))
    G[:3, 3] = axis * (axis @ (T[:3, 3] - nominal[:3, 3]))
    return G


def _to_next_axis(T: Array, nominal: Array, axis: Array, following: Array) -> Array:
    """The motion of a frame that brings the next joint's axis, now at T, nearest to where the nominal link has it."""
    direction, point = T[:3, :3] @ following, T[:3, 3]
    wanted, wanted_point = nominal[:3, :3] @ following, nominal[:3, 3]
    if abs(axis @ wanted) <= np.cos(PARALLEL_RAD):
        G = _turn(axis, _angle_about(axis, wanted, direction))
        back = G[:3, :3].T
        slid = _foot(axis, back @ point, back @ direction) - _foot(axis, wanted_point, wanted)
        G[:3, 3] = axis * slid
        return G
    # Where the next axis passes at the height of its nominal joint.
    passes = point + direction * ((wanted_point - point) @ axis / (direction @ axis))
    if min(_distance(axis, wanted_point), _distance(axis, passes)) > _COINCIDENT:
        return _turn(axis, _angle_about(axis, wanted_point, passes))
    return np.eye(4)


def _least_turn(M: Array, axis: Array) -> float:
    """The angle about the axis whose rotation R makes M R nearest to no rotation [rad]."""
    x, y, z = axis
    sine = x * (M[1, 2] - M[2, 1]) + y * (M[2, 0] - M[0, 2]) + z * (M[0, 1] - M[1, 0])
    return float(np.arctan2(sine, np.trace(M) - axis @ M @ axis))


def _angle_about(axis: Array, start: Array, end: Array) -> float:
    """The angle from one vector to another about an axis [rad]."""
    across = start - axis * (axis @ start)
    return float(np.arctan2(np.cross(axis, across) @ end, across @ end))


def _distance(axis: Array, point: Array) -> float:
    """How far a point lies from the axis through the origin [m]."""
    return float(np.linalg.norm(point - axis * (axis @ point)))


def _foot(axis: Array, point: Array, direction: Array) -> float:
    """Where, along the axis through the origin, the common normal with a line stands [m]."""
    cosine = axis @ direction
    return float((axis @ point - cosine * (direction @ point)) / (1.0 - cosine**2))


def _turn(axis: Array, angle: float) -> Array:
    """A rotation about an axis, shape (4, 4)."""
    return np.asarray(pin.SE3(pin.exp3(axis * angle), np.zeros(3)).homogeneous)
