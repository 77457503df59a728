"""The DH rows of a Universal Robots arm, nominal plus deltas, and the hash that the ROS driver makes of them.

Universal Robots writes standard (distal) DH without any row for nearly parallel axes,

    T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),

so that in a calibrated arm d_2 and d_3 are hundreds of metres. A *chain* here is the same arm as placements of joints
that turn about z, shape (7, 4, 4): joint i in joint i - 1, the first in the controller's base, the seventh its flange
in joint 6; with the nominal rows these are the poses that ``kinematics.yaml`` gives its six links.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.model.dh_table import screw
from calib.model.robot import read_only, rigid_inverse

Array = NDArray[np.float64]

COLUMNS = ("theta", "a", "d", "alpha")
"""The columns of the rows."""

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
    """Six standard DH rows: T_i(q) = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i).

    Attributes:
        theta: shape (6,), [rad].
        a: shape (6,), [m].
        d: shape (6,), [m].
        alpha: shape (6,), [rad].
    """

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

    def __sub__(self, nominal: FullDH) -> FullDH:
        """What to add to the nominal rows."""
        return FullDH(*(getattr(self, name) - getattr(nominal, name) for name in COLUMNS))

    def poses(self, q: ArrayLike) -> Array:
        """The flange in the controller's base, T_1(q_1) ... T_6(q_6).

        Args:
            q: shape (N, 6) or (6,), [rad].

        Returns:
            shape (N, 4, 4), [m].
        """
        values = np.reshape(np.asarray(q, dtype=np.float64), (-1, 6))
        T = np.tile(np.eye(4), (len(values), 1, 1))
        for i in range(6):
            T = (
                T
                @ screw(2, self.theta[i] + values[:, i], self.d[i])
                @ screw(0, self.alpha[i], self.a[i])
            )
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


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Rows that hold a chain, and what they cannot hold: the chain is T_base times the rows times T_tool.

    Attributes:
        deltas: What is added to the nominal rows.
        rows: Nominal plus deltas, as their sum is rounded.
        T_base: shape (4, 4), [m]: the first axis tilted and shifted in the controller's base.
        T_tool: shape (4, 4), [m]: the flange tilted and shifted across the last axis.
    """

    deltas: FullDH
    rows: FullDH
    T_base: Array
    T_tool: Array


def fitted_rows(chain: Array, nominal: FullDH, like: FullDH | None = None) -> Fitted:
    """The standard DH rows of a chain, each worked out in the frame that the rounded rows before it give.

    Args:
        chain: shape (7, 4, 4), [m], see the module's text.
        nominal: The rows that deltas are added to.
        like: Deltas that make the choices which the convention leaves open: of the two senses of a common normal and
            of an angle's whole turns the nearest, of parallel axes the d. Default: none, the nominal rows make them.
    """
    like = FullDH(*np.zeros((4, 6))) if like is None else like
    rows = nominal + like
    frames = _frames(chain)
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
    """The flange in the controller's base, from placements.

    Args:
        chain: shape (7, 4, 4), [m], see the module's text.
        q: shape (N, 6) or (6,), [rad].

    Returns:
        shape (N, 4, 4), [m].
    """
    values = np.reshape(np.asarray(q, dtype=np.float64), (-1, 6))
    T = np.tile(np.eye(4), (len(values), 1, 1))
    for i in range(6):
        T = T @ chain[i] @ screw(2, values[:, i], 0.0)
    return np.asarray(T @ chain[6])


def at_flange(chain: Array) -> Array:
    """The same chain with joint 6 slid along and turned about its axis to stand nearest to the flange."""
    result = np.array(chain)
    R = result[6]
    G = screw(2, np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]), R[2, 3])
    result[5], result[6] = result[5] @ G, rigid_inverse(G) @ result[6]
    return read_only(result)


def kinematics_hash(rows: FullDH) -> str:
    """What the ROS driver calls a controller's kinematics: ``"calib_"`` and a hash of its DH rows.

    The driver prints theta, d, a and alpha of one joint after the other with six digits and takes the standard
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


def _frames(chain: Array) -> list[Array]:
    """The poses of the six joints and of the flange in the controller's base at q = 0."""
    frames = [np.array(chain[0])]
    for placement in chain[1:]:
        frames.append(frames[-1] @ placement)
    return frames


def _first_frame(first: Array) -> Array:
    """DH frame 0: the base turned and shifted least so that its z is the first axis."""
    z, point = first[:3, 2], first[:3, 3]
    foot = point - z * (point @ z)
    T = np.eye(4)
    if max(np.abs(z[:2]).max(), np.abs(foot).max()) < ROUNDING and z[2] > 0:
        return T
    # The shortest turn of z onto the axis.
    x, y, c = z
    T[:3, :3] = np.array(
        [
            [1.0 - x * x / (1.0 + c), -x * y / (1.0 + c), x],
            [-x * y / (1.0 + c), 1.0 - y * y / (1.0 + c), y],
            [-x, -y, c],
        ]
    )
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
