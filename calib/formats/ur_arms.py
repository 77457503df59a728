"""The Universal Robots arms: their DH rows, nominal and with deltas, a bare URDF of each, a calibration's hash.

Universal Robots writes standard (distal) DH without any row for nearly parallel axes,

    T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),

so that in a calibrated arm d_2 and d_3 are hundreds of metres. A *chain* here is the same arm as placements of joints
that turn about z, shape (7, 4, 4): joint i in joint i - 1, the first in the controller's base, the seventh its flange
in joint 6; with the nominal rows these are the poses that ``kinematics.yaml`` gives its six links.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from calib.errors import ModelError, choices
from calib.model.dh_table import screw
from calib.robot.kernel import turns_to
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import Urdf

Array = NDArray[np.float64]

COLUMNS = ("theta", "a", "d", "alpha")
"""The columns of the rows."""

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
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

TOLERANCE = 1e-6
"""A robot that is an arm of the table may lie this far from it [m and rad]."""

#: Half of pi as the controllers' own files write it [rad].
_HALF_PI = 1.570796327

#: Axes closer to parallel than this have no common normal that doubles could hold [rad].
_PARALLEL = 1e-8

#: A displacement below this is rounding [m and rad].
ROUNDING = 1e-12

#: A value this near to the one that it replaces is that one [m, rad]: what went through a robot comes back unchanged.
_SAME = np.array([1e-15, 1e-13, 1e-13, 1e-15])

_MASK = (1 << 64) - 1
_MULTIPLIER = 0xC6A4A7935BD1E995
_SEED = 0xC70F6907


@dataclass(frozen=True, slots=True, eq=False)
class FullDH:
    """Six standard DH rows, shape (6,) each, [rad] and [m]: T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i)."""

    theta: Array
    a: Array
    d: Array
    alpha: Array

    def __post_init__(self) -> None:
        """Make the columns read-only."""
        for name in COLUMNS:
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __add__(self, deltas: FullDH) -> FullDH:
        """Nominal plus deltas, column by column."""
        return FullDH(*(getattr(self, name) + getattr(deltas, name) for name in COLUMNS))

    def poses(self, q: ArrayLike) -> Array:
        """The flange in the controller's base at q (N, 6) or (6,) [rad], T_1 ... T_6, shape (N, 4, 4), [m]."""
        T = np.eye(4)[None]
        for i, column in enumerate(np.reshape(np.asarray(q, dtype=np.float64), (-1, 6)).T):
            T = T @ screw(2, self.theta[i] + column, self.d[i]) @ screw(0, self.alpha[i], self.a[i])
        return T

    def chain(self) -> Array:
        """The placements of the joints, shape (7, 4, 4), [m]; see the module's text."""
        theta, a, d, alpha = self.theta, self.a, self.d, self.alpha
        links = [screw(2, theta[i], 0.0) @ screw(0, alpha[i], a[i]) for i in range(6)]
        # Where each joint's frame stands on its axis: at the end of its d, but for those of parallel axes.
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


class Fitted(NamedTuple):
    """Rows that hold a chain, nominal plus deltas, and what they cannot hold: the chain is T_base rows T_tool.

    T_base is the first axis tilted and shifted in the controller's base, T_tool the flange across the last axis [m].
    """

    deltas: FullDH
    rows: FullDH
    T_base: Array
    T_tool: Array


def fitted_rows(chain: Array, nominal: FullDH, like: FullDH | None = None) -> Fitted:
    """The standard DH rows of a chain (7, 4, 4), each worked out in the frame that the rounded rows before it give.

    ``like`` are deltas that make the choices which the convention leaves open: of the two senses of a common normal and
    of an angle's whole turns the nearest, of parallel axes the d. Without them the nominal rows do.
    """
    like = FullDH(*np.zeros((4, 6))) if like is None else like
    rows = nominal + like
    frames = frames_at_zero(chain)
    T_base = _first_frame(frames[0])
    F = T_base
    deltas = np.zeros((6, 4))
    for i in range(6):
        local = rigid_inverse(F) @ frames[i + 1]
        own, old, wished = (
            np.array([getattr(one, name)[i] for name in COLUMNS]) for one in (nominal, like, rows)
        )
        row = _row_to(local, wished) if i < 5 else _last_row(local, wished)
        # The old number itself, not nominal + delta - nominal, which is rounded.
        deltas[i] = np.where(np.abs(row - wished) < _SAME, old, row - own)
        theta, a, d, alpha = own + deltas[i]
        F = F @ screw(2, theta, d) @ screw(0, alpha, a)
    T_tool = rigid_inverse(F) @ frames[6]
    if np.abs(T_tool - np.eye(4)).max() < ROUNDING:
        T_tool = np.eye(4)
    offsets = FullDH(*deltas.T)
    return Fitted(offsets, nominal + offsets, read_only(T_base), read_only(T_tool))


def chain_poses(chain: Array, q: ArrayLike) -> Array:
    """The same of placements, shape (7, 4, 4), [m]: the flange at q (N, 6) or (6,) [rad], shape (N, 4, 4), [m]."""
    T = np.eye(4)[None]
    for placement, column in zip(chain, np.reshape(np.asarray(q, float), (-1, 6)).T, strict=False):
        T = T @ placement @ screw(2, column, 0.0)
    return np.asarray(T @ chain[6])


def frames_at_zero(chain: Array) -> Array:
    """The poses of the six joints and of the flange in the controller's base at q = 0, shape (7, 4, 4), [m]."""
    frames = np.array(chain)
    for i in range(1, len(frames)):
        frames[i] = frames[i - 1] @ frames[i]
    return frames


def at_flange(chain: Array) -> Array:
    """The same chain with joint 6 slid along and turned about its axis to stand nearest to the flange."""
    result = np.array(chain)
    R = result[6]
    G = screw(2, np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]), R[2, 3])
    result[5], result[6] = result[5] @ G, rigid_inverse(G) @ result[6]
    return read_only(result)


def kinematics_hash(rows: FullDH) -> str:
    """What the ROS driver calls a controller's kinematics: ``"calib_"`` and a hash of its DH rows.

    It prints theta, d, a and alpha of one joint after the other with six digits and takes the standard
    library's hash of that text, which in GNU's library is MurmurHash64A.

    Example:
        >>> zero = FullDH(*[[0.0] * 6] * 4)
        >>> kinematics_hash(zero)
        'calib_8811247710799071897'
    """
    text = "".join(
        f"{getattr(rows, name)[i]:g}" for i in range(6) for name in ("theta", "d", "a", "alpha")
    )
    return f"calib_{_murmur(text.encode())}"


def _murmur(data: bytes) -> int:
    """``std::hash<std::string>`` of GNU's library on a 64-bit machine."""
    value = (_SEED ^ (len(data) * _MULTIPLIER)) & _MASK
    whole = len(data) & ~7
    for (word,) in struct.iter_unpack("<Q", data[:whole]):
        mixed = (word * _MULTIPLIER) & _MASK
        mixed = ((mixed ^ (mixed >> 47)) * _MULTIPLIER) & _MASK
        value = ((value ^ mixed) * _MULTIPLIER) & _MASK
    if whole < len(data):
        rest = int.from_bytes(data[whole:], "little")
        value = ((value ^ rest) * _MULTIPLIER) & _MASK
    value = ((value ^ (value >> 47)) * _MULTIPLIER) & _MASK
    return value ^ (value >> 47)


def _first_frame(first: Array) -> Array:
    """DH frame 0: the base turned and shifted least so that its z is the first axis."""
    z, point = first[:3, 2], first[:3, 3]
    foot = point - z * (point @ z)
    T = np.eye(4)
    if max(np.abs(z[:2]).max(), np.abs(foot).max()) < ROUNDING and z[2] > 0:
        return T
    T[:3, :3] = turns_to(z[None])[0]  # the shortest turn of z onto the axis
    T[:3, 3] = foot
    return T


def _row_to(local: Array, wished: Array) -> Array:
    """theta, a, d, alpha to the next axis, the z of a pose in this frame; the pair nearest to the one wished for."""
    axis, point = local[:3, 2], local[:3, 3]
    sine = float(np.hypot(axis[0], axis[1]))
    if sine > _PARALLEL:
        normal = np.array([-axis[1], axis[0], 0.0]) / sine
        # The common normal's foot on z.
        along = (axis[0] * point[0] + axis[1] * point[1]) / sine**2
        d = float(point[2] - axis[2] * along)
        a = float(normal @ point)
    else:
        d = float(wished[2])
        crossing = point + axis * (d - point[2]) / axis[2]
        a = float(np.hypot(crossing[0], crossing[1]))
        normal = crossing * [1.0, 1.0, 0.0] / a if a > ROUNDING else np.array([1.0, 0.0, 0.0])
        a = a if a > ROUNDING else 0.0
    # Of the normal's two senses that with the wished sense of alpha; between parallel axes, whose theta may wander, and
    # whose alpha has either sign, that with the nearer x.
    if abs(np.sin(wished[3])) > 0.5:
        turned = (normal[0] * axis[1] - normal[1] * axis[0]) * np.sin(wished[3]) > 0.0
    else:
        turned = normal @ [np.cos(wished[0]), np.sin(wished[0]), 0.0] < 0.0
    if turned:
        normal, a = -normal, -a
    theta = _near(float(np.arctan2(normal[1], normal[0])), wished[0])
    across = np.array([-normal[1], normal[0], 0.0])
    alpha = _near(float(np.arctan2(-(across @ axis), axis[2])), wished[3])
    return np.array([theta, a, d, alpha])


def _last_row(local: Array, wished: Array) -> Array:
    """theta, a, d, alpha to the flange: a and alpha only where they hold all of it, else as they were."""
    R, point = local[:3, :3], local[:3, 3]
    theta = np.arctan2(R[1, 0], R[0, 0])
    row = np.array([theta, point @ R[:, 0], point[2], np.arctan2(R[2, 1], R[2, 2])])
    made = screw(2, theta, row[2]) @ screw(0, row[3], row[1])
    if np.abs(made - local).max() > ROUNDING:
        # The turn about z that is nearest to the flange's.
        row = np.array([np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]), 0.0, point[2], 0.0])
    return np.array([_near(row[0], wished[0]), row[1], row[2], _near(row[3], wished[3])])


def _near(angle: float, wished: float) -> float:
    """The angle with whole turns added so that it lies within half a turn of the one wished for [rad]."""
    return float(angle + 2.0 * np.pi * np.round((wished - angle) / (2.0 * np.pi)))


@dataclass(frozen=True, slots=True, eq=False)
class UrModel:
    """One type of arm.

    ``name`` is such as ``"UR5e"``; of an arm that calib does not know ``"arm of urcontrol.conf"``.
    """

    name: str
    nominal: FullDH

    @property
    def known(self) -> bool:
        """Whether Universal Robots sells it under this name."""
        return self.name in _LENGTHS

    def same(self, rows: FullDH) -> bool:
        """Whether rows are those of this type of arm."""
        return all(
            np.abs(getattr(self.nominal, name) - getattr(rows, name)).max() < TOLERANCE
            for name in COLUMNS
        )

    @property
    def said(self) -> str:
        """Its name with the article: ``"a UR5e"``."""
        return f"{'a' if self.known else 'an'} {self.name}"

    @property
    def default_hash(self) -> str:
        """What the ROS driver makes of the nominal rows."""
        return kinematics_hash(self.nominal)


MODELS = tuple(
    UrModel(
        name,
        FullDH(
            theta=np.zeros(6),
            a=np.array([0.0, a2, a3, 0.0, 0.0, 0.0]),
            d=np.array([d1, 0.0, 0.0, d4, d5, d6]),
            alpha=np.array([_HALF_PI, 0.0, 0.0, _HALF_PI, -_HALF_PI, 0.0]),
        ),
    )
    for name, (d1, a2, a3, d4, d5, d6) in _LENGTHS.items()
)
"""The arms that are known."""

NAMES = tuple(_LENGTHS)
"""Their names."""


def ur_model(name: str | UrModel) -> UrModel:
    """The arm of that name, whatever its capitals, spaces and underscores; an arm itself is returned.

    Raises:
        ModelError: There is none.

    Example:
        >>> ur_model("ur5e").nominal.a.tolist()
        [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
    """
    if isinstance(name, UrModel):
        return name
    for model in MODELS:
        if _plain(model.name) == _plain(name):
            return model
    raise ModelError(
        f"'{name}' is not an arm of Universal Robots that calib knows: {choices(NAMES, limit=40)}. For another one "
        "give its urcontrol.conf, which has the nominal rows."
    )


def ur_robot(model: UrModel | str) -> Robot:
    """A bare URDF of an arm with its nominal kinematics, from ``base``, the controller's, to ``tool0``, its flange.

    Links, joints and origins are those of Universal Robots' description for ROS 2, without bodies.

    Raises:
        ModelError: No arm has that name.

    Example:
        >>> ur_robot("ur5e")
        Robot('ur5e', base to tool0, 6 joints)
    """
    model = ur_model(model)
    urdf = Urdf.from_bytes(_urdf_text(model).encode(), f"the nominal {model.name}")
    return Robot.from_urdf(urdf, base="base", tip="tool0")


def _plain(name: str) -> str:
    """A name without capitals, spaces, hyphens and underscores."""
    return "".join(letter for letter in name.lower() if letter not in " -_")


def _urdf_text(model: UrModel) -> str:
    """The bare URDF; where nothing turns, an <origin> of the nominal rows says so exactly."""
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f"<!-- Kinematics of a Universal Robots {model.name}, without bodies, by calib: efforts and speeds are only",
        "     there because a URDF must have them. -->",
        f'<robot name="{_plain(model.name)}">',
        '  <link name="base_link"/>',
    ]
    half, fixed = np.pi / 2.0, '<origin xyz="0.0 0.0 0.0" rpy="{}"/>'
    turned = fixed.format(f"0.0 0.0 {np.pi}")
    joints = [
        ("base_link-base_link_inertia", "base_link", "base_link_inertia", turned),
        ("base_link-base_fixed_joint", "base_link", "base", turned),
    ]
    parent = "base_link_inertia"
    for link, joint, T in zip(LINKS, JOINTS, model.nominal.chain(), strict=False):
        xyz, rpy = (
            " ".join(repr(float(value) + 0.0) for value in values)
            for values in (T[:3, 3], pin.rpy.matrixToRpy(T[:3, :3]))
        )
        joints.append((joint, parent, f"{link}_link", f'<origin xyz="{xyz}" rpy="{rpy}"/>'))
        parent = f"{link}_link"
    joints += [
        ("wrist_3_link-ft_frame", parent, "ft_frame", fixed.format(f"{np.pi} 0.0 0.0")),
        ("wrist_3-flange", parent, "flange", fixed.format(f"0.0 {-half} {-half}")),
        ("flange-tool0", "flange", "tool0", fixed.format(f"{half} 0.0 {half}")),
    ]
    for joint, parent, child, origin in joints:
        turns = joint in JOINTS
        lines += [
            f'  <link name="{child}"/>',
            f'  <joint name="{joint}" type="{"revolute" if turns else "fixed"}">',
            f"    {origin}",
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
        ]
        if turns:
            bound = np.pi if joint == "elbow_joint" else 2.0 * np.pi
            lines += [
                '    <axis xyz="0 0 1"/>',
                f'    <limit lower="{-bound}" upper="{bound}" effort="1000" velocity="{np.pi}"/>',
            ]
        lines.append("  </joint>")
    return "\n".join([*lines, "</robot>", ""])
