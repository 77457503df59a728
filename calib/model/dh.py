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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array

#: The convention of Denavit and Hartenberg; see the module's text.
STANDARD = "standard"

#: The convention of Craig.
MODIFIED = "modified"

#: The convention of Hayati, with a rotation beta between nearly parallel axes.
HAYATI = "hayati"

CONVENTIONS = (STANDARD, MODIFIED, HAYATI)
"""The conventions; see the module's text."""

EQUATIONS = {
    STANDARD: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)",
    MODIFIED: "M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i) Tz(d_i)",
    HAYATI: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)",
}
"""The transform that a row states, for each convention."""

NEARLY_PARALLEL_RAD = np.radians(3.0)
"""Axes closer to parallel than this get a Hayati row [rad]; a real arm's parallel axes differ by a few mrad."""

#: Axes closer to parallel than the first of these [rad] are rounding of a URDF's text: the common normal would be of
#: noise. Behind a common normal that lies far away even such an angle is metres: there the first that holds is taken.
_PARALLEL = (5e-7, 1e-8, 1e-10, 1e-12)

#: An offset between parallel axes below this is rounding [m].
_COINCIDENT = 1e-13

#: A tip whose z axis lies beside the last axis by less is on it [m].
_ON_AXIS = 1e-3

#: Poses by rows agree with the robot's within this [m; rotation matrices: 1]; products within this are zero.
_TOLERANCE = 1e-9

#: Number of joint values at which rows are compared with the robot.
_POSES = 8

#: Seed of these joint values, so that the same robot always gets the same rows.
_SEED = 20170401

#: A direction whose part across an axis is shorter than this is along it.
_ALONG = 1e-6


@dataclass(frozen=True, slots=True)
class DHRow:
    """One row; lengths [m], angles [rad]."""

    joint: str  #: The joint whose value is added.
    prismatic: bool  #: True if it is added to d instead of theta.
    theta: float  #: About z.
    d: float  #: Along z.
    a: float  #: Along x: a_i, or a_(i-1) in the modified convention.
    alpha: float  #: About x: alpha_i, or alpha_(i-1) in the modified convention.
    beta: float = 0.0  #: About y, Hayati's; 0 in the others.

    @property
    def near_parallel(self) -> bool:
        """True if the row's axes are nearly parallel; Hayati's rows then have a beta and, but for the last, d = 0."""
        sine = np.hypot(np.sin(self.alpha), np.cos(self.alpha) * np.sin(self.beta))
        return bool(sine < np.sin(NEARLY_PARALLEL_RAD))

    def matrix(self, q: ArrayLike = 0.0, *, modified: bool = False) -> Array:
        """Return A_i, or M_i of the modified convention.

        Args:
            q: One value of the row's joint or N of them, [rad] or [m].
            modified: True if the row is of the modified convention.

        Returns:
            Shape (4, 4) or (N, 4, 4), [m].
        """
        values = np.asarray(q, dtype=np.float64)
        turn: float | Array = 0.0
        slide: float | Array = 0.0
        if self.prismatic:
            slide = values
        else:
            turn = values
        along_x = screw(0, self.alpha, self.a)
        along_z = screw(2, self.theta + turn, self.d + slide)
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
        """Return T_base_tip from the rows alone.

        Args:
            values: Shape (N, n) or (n,), values of the chain's joints as of `Robot.chain_values`, [rad] or [m].

        Returns:
            Shape (N, 4, 4), [m].
        """
        q = np.atleast_2d(np.asarray(values, dtype=np.float64))
        T = np.tile(self.T_base_0, (len(q), 1, 1))
        for row, column in zip(self.rows, q.T, strict=True):
            T = T @ row.matrix(column, modified=self.convention == MODIFIED)
        return np.asarray(T @ self.T_n_tip)


def dh_frames(table: DHTable) -> list[Array]:
    """Return the frames of standard or Hayati rows before the rotation about beta, at q = 0.

    Returns:
        n poses in the base, each of shape (4, 4), [m].
    """
    T = table.T_base_0
    frames = []
    for row in table.rows:
        frames.append(T @ replace(row, beta=0.0).matrix())
        T = T @ row.matrix()
    return frames


def screw(axis: int, angle: ArrayLike, length: ArrayLike) -> Array:
    """Return a rotation about, and translation along, a coordinate axis.

    Args:
        axis: 0, 1 or 2 for x, y, z.
        angle: One angle or N of them [rad].
        length: One length or N of them [m].

    Returns:
        Shape (4, 4) or (N, 4, 4), [m].
    """
    angle, length = np.broadcast_arrays(np.asarray(angle, float), np.asarray(length, float))
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    T = np.zeros((*angle.shape, 4, 4))
    T[..., axis, axis] = T[..., 3, 3] = 1.0
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., axis, 3] = length
    return T


def dh_table(robot: Robot, convention: str = HAYATI, like: Robot | None = None) -> DHTable:
    """Return the DH rows of a robot's chain; `DHTable.poses` then equals ``robot.poses`` up to rounding.

    Args:
        robot: The robot.
        convention: One of `CONVENTIONS`.
        like: A robot of the same chain, such as the nominal one, whose open choices are kept so that columns compare;
            None to choose as a data sheet does.

    Example:
        >>> table = dh_table(Robot.load("ur3", base="base", tip="tool0"))
        >>> [round(1000 * row.a, 2) + 0.0 for row in table.rows]
        [0.0, -243.65, -213.25, 0.0, 0.0, 0.0]
    """
    reference = None
    if like is not None:
        reference = _product(like, _rule_for(like, convention))
    table = _product(robot, _rule_for(robot, convention), reference)
    return _rebracketed(table) if convention == MODIFIED else table


def near_parallel(robot: Robot) -> dict[tuple[str, str], float]:
    """Return the angle [rad] between axes of consecutive joints that are nearly, but not exactly, parallel.

    Returns:
        By the two joints' names, base to tip.
    """
    limit = _parallel_limit(robot)
    names = [joint.name for joint in robot.joints]
    angles = {}
    for pair, sine in zip(pairwise(names), _sines(robot), strict=True):
        if limit <= sine < np.sin(NEARLY_PARALLEL_RAD):
            angles[pair] = float(np.arcsin(sine))
    return angles


def taken_as_parallel(robot: Robot) -> float:
    """Return the largest angle [rad] between consecutive axes that standard rows take as parallel; 0 without such."""
    limit = _parallel_limit(robot)
    return max((sine for sine in _sines(robot) if sine < limit), default=0.0)


def zero_poses(robot: Robot) -> tuple[list[Array], Array]:
    """Return the joints' frames and the tip's at q = 0: n poses T_base_joint and T_base_tip, (4, 4), [m]."""
    T = rigid_inverse(robot.T_root_base)
    frames = []
    for placement in robot.placements:
        T = T @ placement
        frames.append(T)
    return frames[:-1], frames[-1]


@dataclass(frozen=True, slots=True)
class _Rule:
    """The convention of rows, and the angle below which it takes axes as parallel."""

    convention: str  #: One of `CONVENTIONS`.
    limit: float  #: Of the standard and modified conventions [rad].

    @property
    def hayati(self) -> bool:
        """True for Hayati's rows."""
        return self.convention == HAYATI

    def parallel(self, sine: float, reference: _Reference | None) -> bool:
        """Return True if axes at an angle of this sine count as parallel.

        Axes that are nearly parallel are so in both robots, although the one may lie on this side of the limit.
        """
        if not self.hayati:
            return sine < self.limit
        if reference is not None:
            return reference.row.near_parallel
        return bool(sine < np.sin(NEARLY_PARALLEL_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """A row of the robot whose open choices are kept."""

    row: DHRow  #: The row.
    x: Array  #: shape (3,), x axis of its frame, in the base at q = 0.
    T_n_tip: Array  #: shape (4, 4), [m], pose of that robot's tip in frame n.


class _RowNumbers(NamedTuple):
    """The numbers of one row, [rad] and [m]."""

    theta: float
    d: float
    a: float
    alpha: float
    beta: float


def _rule_for(robot: Robot, convention: str) -> _Rule:
    """Return the rule of a convention; of Hayati's rows, no angle below that of nearly parallel axes is a limit."""
    limit = 0.0 if convention == HAYATI else _parallel_limit(robot)
    return _Rule(convention, limit)


def _parallel_limit(robot: Robot) -> float:
    """Return the angle [rad] below which axes count as parallel: the largest of `_PARALLEL` whose rows hold the robot.

    If none holds, that with the smallest error.
    """
    sines = _sines(robot)
    q = np.random.default_rng(_SEED).uniform(-np.pi, np.pi, (_POSES, len(robot.joint_names)))
    values = robot.chain_values(q)
    poses = robot.poses(q)
    reach = 1.0 + float(np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum())
    errors: dict[float, float] = {}
    for limit in _PARALLEL:
        table = _product(robot, _Rule(STANDARD, limit))
        errors[limit] = float(np.abs(table.poses(values) - poses).max())
        neglected = max((sine for sine in sines if sine < limit), default=0.0)
        if errors[limit] <= _TOLERANCE + 2.0 * reach * neglected:
            return limit
    return min(errors, key=lambda limit: errors[limit])


def _axes(robot: Robot, T_base_joint: Sequence[Array]) -> list[Array]:
    """Return the axis of each joint, shape (3,), in the base, by the joints' frames."""
    return [T[:3, :3] @ joint.axis for T, joint in zip(T_base_joint, robot.joints, strict=True)]


def _sines(robot: Robot) -> list[float]:
    """Return the sine of the angle between the axes of each joint and the next, n - 1 of them."""
    T_base_joint, _ = zero_poses(robot)
    axes = _axes(robot, T_base_joint)
    return [float(np.linalg.norm(_cross(*pair))) for pair in pairwise(axes)]


def _references(like: DHTable | None, count: int) -> list[_Reference | None]:
    """Return the rows of another robot as references, or so many None."""
    if like is None:
        return [None] * count
    return [
        _Reference(row, frame[:3, 0], like.T_n_tip)
        for row, frame in zip(like.rows, dh_frames(like), strict=True)
    ]


def _product(robot: Robot, rule: _Rule, like: DHTable | None = None) -> DHTable:
    """Return the rows in the standard bracketing, also for the modified convention.

    Args:
        robot: The robot.
        rule: The convention, and the angle below which axes count as parallel.
        like: Rows of a robot of the same chain, in the same bracketing, whose open choices are kept; None for none.
    """
    T_base_joint, T_base_tip = zero_poses(robot)
    axes = _axes(robot, T_base_joint)
    references = _references(like, len(axes))
    near = np.eye(4) if like is None else like.T_base_0
    T_base_0 = _first_frame(T_base_joint[0][:3, 3], axes[0], near)
    # Each row begins where those before it end: digits that one cannot hold, as the last of a d of kilometres, go into
    # the next.
    T = T_base_0
    rows: list[DHRow] = []
    for i, joint in enumerate(robot.joints):
        if i + 1 < len(axes):
            numbers = _row(T, T_base_joint[i + 1][:3, 3], axes[i + 1], references[i], rule)
        else:
            numbers = _last_row(T, T_base_tip, references[i], rule)
        row = DHRow(joint.name, joint.type == "prismatic", *numbers)
        rows.append(_tidy(row, references[i]))
        T = T @ rows[-1].matrix()
    return DHTable(
        rows=tuple(rows),
        T_base_0=read_only(T_base_0),
        T_n_tip=read_only(rigid_inverse(T) @ T_base_tip),
        convention=HAYATI if rule.hayati else STANDARD,
    )


def _rebracketed(table: DHTable) -> DHTable:
    """Return standard rows as modified ones: a and alpha move down by a row, those of the last into the tip."""
    moved = []
    a = 0.0
    alpha = 0.0
    for row in table.rows:
        moved.append(replace(row, a=a, alpha=alpha))
        a = row.a
        alpha = row.alpha
    T_n_tip = read_only(screw(0, alpha, a) @ table.T_n_tip)
    return DHTable(tuple(moved), table.T_base_0, T_n_tip, MODIFIED)


def _row(
    T: Array, point: Array, axis: Array, reference: _Reference | None, rule: _Rule
) -> _RowNumbers:
    """Return the row from a frame to the axis of the next joint.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        point: Shape (3,), [m], a point of the next axis, in the base.
        axis: Shape (3,), unit vector along it.
        reference: The row whose open choices are kept; None for none.
        rule: The convention, and the angle below which axes count as parallel.
    """
    x = T[:3, 0]
    z = T[:3, 2]
    normal = _cross(z, axis)
    sine = float(np.linalg.norm(normal))
    between = point - T[:3, 3]
    if rule.parallel(sine, reference):
        # The next origin is where the next axis meets the plane through this one's origin: d = 0.
        offset = between - axis * (between @ z) / (axis @ z)
        near = x if reference is None else reference.x
        return _parallel_row(T, axis, offset, near, tilted=rule.hayati)
    normal /= sine
    if _points_backwards(normal, x, between, reference):
        normal = -normal
    # Feet of the common normal: origin + d z + a normal = point + s axis.
    d, a, _ = np.linalg.solve(np.stack([z, normal, -axis], axis=1), between)
    alpha = np.arctan2(_cross(z, axis) @ normal, z @ axis)
    theta = np.arctan2(_cross(x, normal) @ z, x @ normal)
    return _RowNumbers(float(theta), float(d), float(a), float(alpha), 0.0)


def _points_backwards(
    normal: Array, x: Array, between: Array, reference: _Reference | None
) -> bool:
    """Return True if a common normal is to be turned round, so that x_i points as it should.

    Args:
        normal: Shape (3,), unit vector along the common normal.
        x: Shape (3,), x axis of the frame before the row: x_i points as near to it as possible.
        between: Shape (3,), [m], from that frame's origin to the next axis: decides where x and the normal are square.
        reference: The row whose x axis decides instead; None for none.
    """
    if reference is not None:
        return bool(normal @ reference.x < 0)
    along = normal @ x
    if along < -_TOLERANCE:
        return True
    return bool(along < _TOLERANCE and between @ normal < -_TOLERANCE)


def _parallel_row(
    T: Array, axis: Array, offset: Array, near: Array, *, tilted: bool
) -> _RowNumbers:
    """Return the row, with d = 0, to an axis that is parallel or nearly so.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        axis: Shape (3,), unit vector along the next axis.
        offset: Shape (3,), [m], from the frame's origin to that axis.
        near: Shape (3,), the direction that x_i points nearest to.
        tilted: True for a row with beta, whose axes need not be parallel.
    """
    x = T[:3, 0]
    z = T[:3, 2]
    offset = offset - z * (z @ offset)
    a = float(np.linalg.norm(offset))
    if a > _COINCIDENT:
        normal = _across(z, offset / a)
        a = float(offset @ normal)
        if normal @ near < -_TOLERANCE:
            a = -a
            normal = -normal
    else:
        a = 0.0
        normal = _across(z, near)
    beta = 0.0
    if tilted:
        beta = float(np.arcsin(np.clip(axis @ normal, -1.0, 1.0)))
    alpha = np.arctan2(-(axis @ _cross(z, normal)), axis @ z)
    theta = np.arctan2(_cross(x, normal) @ z, x @ normal)
    return _RowNumbers(float(theta), 0.0, a, float(alpha), beta)


def _last_row(
    T: Array, T_base_tip: Array, reference: _Reference | None, rule: _Rule
) -> _RowNumbers:
    """Return the row from the last axis to the tip, whose frame is the tip's where it can be.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        T_base_tip: Shape (4, 4), [m], the tip at q = 0.
        reference: The row whose open choices are kept; None for none.
        rule: The convention, and the angle below which axes count as parallel.
    """
    z = T[:3, 2]
    axis = T_base_tip[:3, 2]
    sine = np.linalg.norm(_cross(z, axis))
    if sine >= np.sin(NEARLY_PARALLEL_RAD):
        return _row(T, T_base_tip[:3, 3], axis, reference, rule)
    if reference is not None:
        return _last_row_like(T, T_base_tip, reference)
    between = T_base_tip[:3, 3] - T[:3, 3]
    along = float(between @ z)
    across = between - along * z
    on_axis = np.linalg.norm(across) < _ON_AXIS
    if not rule.hayati and (rule.convention == MODIFIED or sine >= rule.limit or on_axis):
        # Frame n stays on the last axis, and T_n_tip leads from there to the tip.
        across = np.zeros(3)
        axis = z * np.sign(axis @ z)
    near = T_base_tip[:3, 0]
    numbers = _parallel_row(T, axis, across, near, tilted=rule.hayati)
    return numbers._replace(d=along)


def _last_row_like(T: Array, T_base_tip: Array, reference: _Reference) -> _RowNumbers:
    """Return the last row with a, alpha and beta of another robot's, so that T_n_tip takes up how the tip moved.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        T_base_tip: Shape (4, 4), [m], the tip at q = 0.
        reference: The other robot's last row.
    """
    row = reference.row
    fixed = replace(row, theta=0.0, d=0.0).matrix()
    turn = rigid_inverse(T) @ T_base_tip @ rigid_inverse(fixed @ reference.T_n_tip)
    theta = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    return _RowNumbers(float(theta), float(turn[2, 3]), row.a, row.alpha, row.beta)


def _tidy(row: DHRow, reference: _Reference | None) -> DHRow:
    """Return the row without signs of zero, and its angles in the turn of the reference's, or half a turn as pi."""
    theta = row.theta
    alpha = row.alpha
    if reference is None:
        theta = _half_turn_positive(theta)
        alpha = _half_turn_positive(alpha)
    else:
        theta = _in_turn_of(reference.row.theta, theta)
        alpha = _in_turn_of(reference.row.alpha, alpha)
    return replace(
        row,
        theta=theta + 0.0,
        d=row.d + 0.0,
        a=row.a + 0.0,
        alpha=alpha + 0.0,
        beta=row.beta + 0.0,
    )


def _half_turn_positive(angle: float) -> float:
    """Return an angle between -pi and pi [rad], half a turn as pi, not -pi."""
    return angle + 2 * np.pi if angle < -np.pi + _TOLERANCE else angle


def _in_turn_of(reference: float, angle: float) -> float:
    """Return an angle [rad] plus the whole turns that bring it nearest to a reference."""
    return angle + 2 * np.pi * round((reference - angle) / (2 * np.pi))


def _first_frame(point: Array, axis: Array, near: Array) -> Array:
    """Return frame 0: z along the first axis, origin and x nearest to those of another frame.

    Args:
        point: Shape (3,), [m], a point of the first axis, in the base.
        axis: Shape (3,), unit vector along it.
        near: Shape (4, 4), [m], the other frame, in the base.

    Returns:
        T_base_0, shape (4, 4), [m].
    """
    T = np.eye(4)
    x = _across(axis, near[:3, 0])
    T[:3, :3] = np.stack([x, _cross(axis, x), axis], axis=1)
    T[:3, 3] = point + axis * (axis @ (near[:3, 3] - point))
    return T


def _across(z: Array, near: Array) -> Array:
    """Return the unit vector across z that is nearest to another, or to base y or z where that lies along z."""
    for direction in (near, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])):
        across = direction - z * (z @ direction)
        length = np.linalg.norm(across)
        if length >= _ALONG:
            # Twice is enough: the part along z after the first pass is rounding of a short vector.
            across = across / length
            across = across - z * (z @ across)
            break
    return np.asarray(across / np.linalg.norm(across))


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of two vectors of three: `numpy.cross` is made for stacks and takes ten times as long."""
    a0, a1, a2 = a
    b0, b1, b2 = b
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
