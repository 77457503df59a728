"""DH rows of a robot's chain, in the conventions that controllers take: standard, modified, Hayati.

    standard   T_base_tip = T_base_0  A_1 ... A_n  T_n_tip,   A_i = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i)
    hayati     the same with A_i Ry(beta_i), which is 0 but between nearly parallel axes; there d_i = 0
    modified   M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i + q_i) Tz(d_i)   (Craig), with a_0 = alpha_0 = 0

(a prismatic joint adds q_i to d_i instead). Standard and modified rows are the same product of the same common normals,
bracketed otherwise, and they are pure: the common normal of nearly parallel axes may lie kilometres away, and is given
there. Hayati's rows, which the error model stands on, have no far normals: of a nearly parallel row, the last one
apart, beta_i tilts the axis (S. Hayati, 1983).

Choices that the convention leaves open are made as a data sheet does: frame 0 is the base frame where it can be, x_i
points as near as possible to x_(i-1) at q = 0, frame n is the tip where it can be. To compare two robots, `dh_table`
makes them as those of the other robot, and leaves what lies behind the last axis to T_n_tip alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array

STANDARD, MODIFIED, HAYATI = CONVENTIONS = ("standard", "modified", "hayati")
"""The conventions; see the module's text."""

EQUATIONS = {
    STANDARD: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)",
    MODIFIED: "M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i) Tz(d_i)",
    HAYATI: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)",
}
"""What a row means, for each convention."""

NEARLY_PARALLEL_RAD = np.radians(3.0)
"""Axes closer to parallel than this get a Hayati row [rad]; a real arm's parallel axes differ by a few mrad."""


@dataclass(frozen=True, slots=True)
class DHRow:
    """One row; lengths [m], angles [rad]."""

    joint: str  #: The joint whose value is added.
    prismatic: bool  #: Whether it is added to d instead of theta.
    theta: float  #: About z.
    d: float  #: Along z.
    a: float  #: Along x: a_i, or a_(i-1) in the modified convention.
    alpha: float  #: About x, likewise.
    beta: float = 0.0  #: About y, Hayati's; 0 in the others.

    @property
    def near_parallel(self) -> bool:
        """Whether the row's axes are nearly parallel; Hayati's rows then have a beta and, but for the last, d = 0."""
        sine = np.hypot(np.sin(self.alpha), np.cos(self.alpha) * np.sin(self.beta))
        return bool(sine < np.sin(NEARLY_PARALLEL_RAD))

    def matrix(self, q: ArrayLike = 0.0, *, modified: bool = False) -> Array:
        """A_i, or M_i if ``modified``, at one value of the row's joint or N of them; shape (4, 4) or (N, 4, 4), [m]."""
        values = np.asarray(q, dtype=np.float64)
        turn, slide = (0.0, values) if self.prismatic else (values, 0.0)
        along_x, along_z = screw(0, self.alpha, self.a), screw(2, self.theta + turn, self.d + slide)
        if modified:
            return np.asarray(along_x @ along_z)
        return np.asarray(along_z @ along_x @ screw(1, self.beta, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class DHTable:
    """The rows of a chain, with the constant poses before the first and behind the last."""

    rows: tuple[DHRow, ...]  #: One for each moving joint, base to tip.
    T_base_0: Array  #: shape (4, 4), [m], pose of frame 0 in the base.
    T_n_tip: Array  #: shape (4, 4), [m], pose of the tip in frame n.
    convention: str = HAYATI  #: One of `CONVENTIONS`.

    def poses(self, values: ArrayLike) -> Array:
        """T_base_tip from the rows alone at values (N, n) or (n,), see `Robot.chain_values`; shape (N, 4, 4), [m]."""
        q = np.atleast_2d(np.asarray(values, dtype=np.float64))
        T = np.tile(self.T_base_0, (len(q), 1, 1))
        for row, column in zip(self.rows, q.T, strict=True):
            T = T @ row.matrix(column, modified=self.convention == MODIFIED)
        return np.asarray(T @ self.T_n_tip)


def dh_frames(table: DHTable) -> list[Array]:
    """The frames of standard or Hayati rows before the rotation about beta, at q = 0 in base; n times (4, 4), [m]."""
    T, frames = table.T_base_0, []
    for row in table.rows:
        frames.append(T @ replace(row, beta=0.0).matrix())
        T = T @ row.matrix()
    return frames


def screw(axis: int, angle: ArrayLike, length: ArrayLike) -> Array:
    """Rotation by angle(s) [rad] about, and translation by length(s) [m] along axis 0, 1 or 2; (4, 4) or (N, 4, 4)."""
    angle, length = np.broadcast_arrays(np.asarray(angle, float), np.asarray(length, float))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T = np.zeros((*angle.shape, 4, 4))
    T[..., axis, axis] = T[..., 3, 3] = 1.0
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., axis, 3] = length
    return T


#: Axes closer to parallel than the first of these [rad] are rounding of a URDF's text: the common normal would be of
#: noise. Behind a common normal that lies far away even such an angle is metres: there the first that holds is taken.
_PARALLEL = (5e-7, 1e-8, 1e-10, 1e-12)

_COINCIDENT = 1e-13  #: An offset between parallel axes below this is rounding [m].
_ON_AXIS = 1e-3  #: A tip whose z axis lies beside the last axis by less is on it [m].
_TOLERANCE = 1e-9
_POSES, _SEED = 8, 20170401  #: Of the joint values at which rows are compared with the robot.


def dh_table(robot: Robot, convention: str = HAYATI, like: Robot | None = None) -> DHTable:
    """The DH rows of a robot's chain; `DHTable.poses` then equals ``robot.poses`` up to rounding.

    ``like`` is a robot of the same chain, such as the nominal one, whose open choices are kept so that columns compare.

    Example:
        >>> table = dh_table(Robot.load("ur3", base="base", tip="tool0"))
        >>> [round(1000 * row.a, 2) + 0.0 for row in table.rows]
        [0.0, -243.65, -213.25, 0.0, 0.0, 0.0]
    """
    found = _product(robot, convention, None if like is None else _product(like, convention))
    return _rebracketed(found) if convention == MODIFIED else found


def near_parallel(robot: Robot) -> dict[tuple[str, str], float]:
    """The angle [rad] between axes of consecutive joints that are nearly, but not exactly, parallel, by their names."""
    names = [joint.name for joint in robot.joints]
    limit = _limit(robot)
    return {
        pair: float(np.arcsin(sine))
        for pair, sine in zip(pairwise(names), _sines(robot), strict=True)
        if limit <= sine < np.sin(NEARLY_PARALLEL_RAD)
    }


def taken_as_parallel(robot: Robot) -> float:
    """The largest angle [rad] between consecutive axes that the pure conventions take as parallel; 0 without such."""
    limit = _limit(robot)
    return max((sine for sine in _sines(robot) if sine < limit), default=0.0)


def zero_poses(robot: Robot) -> tuple[list[Array], Array]:
    """The joints' frames and the tip's at q = 0: n poses T_base_joint and T_base_tip, (4, 4), [m]."""
    T = rigid_inverse(robot.T_root_base)
    frames = []
    for placement in robot.placements:
        T = T @ placement
        frames.append(T)
    return frames[:-1], frames[-1]


def _limit(robot: Robot) -> float:
    """The angle [rad] below which axes are taken as parallel: the largest of `_PARALLEL` whose rows hold the robot."""
    sines, off = _sines(robot), {}
    q = np.random.default_rng(_SEED).uniform(-np.pi, np.pi, (_POSES, len(robot.joint_names)))
    values, poses = robot.chain_values(q), robot.poses(q)
    reach = 1.0 + float(np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum())
    for limit in _PARALLEL:
        error = _product(robot, STANDARD, limit=limit).poses(values) - poses
        off[limit] = float(np.abs(error).max())
        below = max((sine for sine in sines if sine < limit), default=0.0)
        if off[limit] <= _TOLERANCE + 2.0 * reach * below:
            return limit
    return min(off, key=lambda limit: off[limit])


def _sines(robot: Robot) -> list[float]:
    """The sine of the angle between the axes of each joint and the next."""
    frames, _ = zero_poses(robot)
    axes = [T[:3, :3] @ joint.axis for T, joint in zip(frames, robot.joints, strict=True)]
    return [float(np.linalg.norm(_cross(*pair))) for pair in pairwise(axes)]


#: What a row is to be like: another robot's row, and its x direction in base at q = 0.
_Wanted: TypeAlias = tuple[DHRow, Array] | None

#: theta, d, a, alpha, beta.
_Numbers: TypeAlias = tuple[float, float, float, float, float]


def _product(
    robot: Robot, convention: str, like: DHTable | None = None, limit: float | None = None
) -> DHTable:
    """The rows in the standard bracketing, with axes closer than ``limit`` [rad] parallel to the pure conventions."""
    if limit is None:
        # Of Hayati's rows, no angle below that of nearly parallel axes is a limit.
        limit = 0.0 if convention == HAYATI else _limit(robot)
    frames, T_base_tip = zero_poses(robot)
    axes = [T[:3, :3] @ joint.axis for T, joint in zip(frames, robot.joints, strict=True)]
    wanted: list[_Wanted] = [None] * len(axes)
    near, T_n_tip = np.eye(4), None
    if like is not None:
        x = [F[:3, 0] for F in dh_frames(like)]
        wanted, near, T_n_tip = list(zip(like.rows, x, strict=True)), like.T_base_0, like.T_n_tip
    # Each row begins where those before it end: what one cannot hold, as the last digits of a d of kilometres, the next
    # makes good.
    T = T_base_0 = _first_frame(frames[0][:3, 3], axes[0], near)
    rows: list[DHRow] = []
    for i, joint in enumerate(robot.joints):
        if i + 1 < len(axes):
            numbers = _row(T, frames[i + 1][:3, 3], axes[i + 1], wanted[i], convention, limit)
        else:
            numbers = _last_row(T, T_base_tip, wanted[i], T_n_tip, convention, limit)
        row = DHRow(joint.name, joint.type == "prismatic", *numbers)
        rows.append(_tidy(row, wanted[i]))
        T = T @ rows[-1].matrix()
    bracketed = HAYATI if convention == HAYATI else STANDARD
    T_n_tip = read_only(rigid_inverse(T) @ T_base_tip)
    return DHTable(tuple(rows), read_only(T_base_0), T_n_tip, bracketed)


def _rebracketed(table: DHTable) -> DHTable:
    """Standard rows as modified ones: a and alpha move down by a row, those of the last into the tip."""
    moved = []
    a, alpha = 0.0, 0.0
    for row in table.rows:
        moved.append(replace(row, a=a, alpha=alpha))
        a, alpha = row.a, row.alpha
    T_n_tip = read_only(screw(0, alpha, a) @ table.T_n_tip)
    return DHTable(tuple(moved), table.T_base_0, T_n_tip, MODIFIED)


def _row(
    T: Array, point: Array, axis: Array, wanted: _Wanted, convention: str, limit: float
) -> _Numbers:
    """The row from a frame to the axis of the next joint, a line through a point."""
    z, x = T[:3, 2], T[:3, 0]
    normal = _cross(z, axis)
    sine = float(np.linalg.norm(normal))
    between = point - T[:3, 3]
    # What is nearly parallel is so in both robots, although the one may lie on this side of the limit.
    leaning = sine < np.sin(NEARLY_PARALLEL_RAD) if wanted is None else wanted[0].near_parallel
    if leaning if convention == HAYATI else sine < limit:
        # The next origin is where the next axis meets the plane through this one's origin: d = 0.
        offset = between - axis * (between @ z) / (axis @ z)
        near = x if wanted is None else wanted[1]
        return _parallel_row(T, axis, offset, near, tilted=convention == HAYATI)
    normal /= sine
    if wanted is not None:
        turned = normal @ wanted[1] < 0
    else:
        along = normal @ x
        turned = along < -_TOLERANCE or (along < _TOLERANCE and between @ normal < -_TOLERANCE)
    if turned:
        normal = -normal
    # Feet of the common normal: origin + d z + a normal = point + s axis.
    d, a, _ = np.linalg.solve(np.stack([z, normal, -axis], axis=1), between)
    alpha = np.arctan2(_cross(z, axis) @ normal, z @ axis)
    theta = np.arctan2(_cross(x, normal) @ z, x @ normal)
    return float(theta), float(d), float(a), float(alpha), 0.0


def _parallel_row(T: Array, axis: Array, offset: Array, near: Array, *, tilted: bool) -> _Numbers:
    """The row to a (nearly) parallel axis at an ``offset`` from T [m]; x is to point ``near``."""
    z, x = T[:3, 2], T[:3, 0]
    offset = offset - z * (z @ offset)
    a = float(np.linalg.norm(offset))
    if a > _COINCIDENT:
        normal = _across(z, offset / a)
        a = float(offset @ normal)
        if normal @ near < -_TOLERANCE:
            a, normal = -a, -normal
    else:
        a, normal = 0.0, _across(z, near)
    beta = float(np.arcsin(np.clip(axis @ normal, -1.0, 1.0))) if tilted else 0.0
    alpha = np.arctan2(-(axis @ _cross(z, normal)), axis @ z)
    theta = np.arctan2(_cross(x, normal) @ z, x @ normal)
    return float(theta), 0.0, a, float(alpha), beta


def _last_row(
    T: Array,
    T_base_tip: Array,
    wanted: _Wanted,
    T_n_tip: Array | None,
    convention: str,
    limit: float,
) -> _Numbers:
    """The row from the last axis to the tip, whose frame is the tip's where it can be."""
    z, axis, between = T[:3, 2], T_base_tip[:3, 2], T_base_tip[:3, 3] - T[:3, 3]
    sine = np.linalg.norm(_cross(z, axis))
    if sine >= np.sin(NEARLY_PARALLEL_RAD):
        return _row(T, T_base_tip[:3, 3], axis, wanted, convention, limit)
    if wanted is not None and T_n_tip is not None:
        # How the tip lies behind the axis is no matter of the joint: T_n_tip says how it moved.
        row = wanted[0]
        fixed = replace(row, theta=0.0, d=0.0).matrix()
        turn = rigid_inverse(T) @ T_base_tip @ rigid_inverse(fixed @ T_n_tip)
        theta = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        return float(theta), float(turn[2, 3]), row.a, row.alpha, row.beta
    along = float(between @ z)
    across = between - along * z
    if convention != HAYATI and (
        convention == MODIFIED or sine >= limit or np.linalg.norm(across) < _ON_AXIS
    ):
        across = np.zeros(3)
        axis = z * np.sign(axis @ z)
    theta, _, a, alpha, beta = _parallel_row(
        T, axis, across, T_base_tip[:3, 0], tilted=convention == HAYATI
    )
    return theta, along, a, alpha, beta


def _tidy(row: DHRow, wanted: _Wanted) -> DHRow:
    """Without signs of zero; angles in the turn of the wanted row's, half a turn as pi, not -pi."""
    angles = []
    for name in ("theta", "alpha"):
        angle = getattr(row, name)
        if wanted is not None:
            angle += 2 * np.pi * round((getattr(wanted[0], name) - angle) / (2 * np.pi))
        elif angle < -np.pi + _TOLERANCE:
            angle += 2 * np.pi
        angles.append(angle)
    numbers = (value + 0.0 for value in (angles[0], row.d, row.a, angles[1], row.beta))
    return DHRow(row.joint, row.prismatic, *numbers)


def _first_frame(point: Array, axis: Array, near: Array) -> Array:
    """Frame 0: z along the first axis, origin and x nearest to those of another frame."""
    T = np.eye(4)
    x = _across(axis, near[:3, 0])
    T[:3, :3] = np.stack([x, _cross(axis, x), axis], axis=1)
    T[:3, 3] = point + axis * (axis @ (near[:3, 3] - point))
    return T


def _across(z: Array, near: Array) -> Array:
    """The unit vector across z that is nearest to another, or to base y or z where that lies along z."""
    for direction in (near, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])):
        across = direction - z * (z @ direction)
        length = np.linalg.norm(across)
        if length >= 1e-6:
            # Twice is enough: what the first pass leaves along z is rounding of a short vector.
            across = across / length
            across = across - z * (z @ across)
            break
    return np.asarray(across / np.linalg.norm(across))


def _cross(a: Array, b: Array) -> Array:
    """The product a x b of two vectors of three: `numpy.cross` is made for stacks and takes ten times as long."""
    (a0, a1, a2), (b0, b1, b2) = a, b
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
