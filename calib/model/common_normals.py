"""The numbers of one DH row: from a frame to the common normal with the next axis.

A row leads from a frame, whose z lies along a joint's axis, to one whose z lies along the next: x of the new frame lies
along the common normal of the two axes. Between axes that are parallel, or nearly so for Hayati's rows, it lies along
the offset between them in the plane across the first axis, and d = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.robot.dh.rows import HAYATI, MODIFIED, NEARLY_PARALLEL_RAD, DHRow

#: An offset between parallel axes below this is rounding [m].
_COINCIDENT = 1e-13


#: A tip whose z axis lies beside the last axis by less is on it [m].
_ON_AXIS = 1e-3


#: Poses by rows agree with the robot's within this [m; rotation matrices: 1]; products within this are zero.
TOLERANCE = 1e-9


#: A direction whose part across an axis is shorter than this is along it.
_ALONG = 1e-6


@dataclass(frozen=True, slots=True)
class Rule:
    """The convention of rows, and the angle below which it takes axes as parallel."""

    #: One of `calib.robot.dh.rows.CONVENTIONS`
    convention: str
    #: Axes at a smaller angle are parallel, in the standard and modified conventions [rad]
    limit: float
    #: True if the references are rows as a controller has them, of which every number is kept that can be: d between
    #: parallel axes, the place of a sliding axis, and a, alpha and beta of the last row.
    keeps: bool = False

    @property
    def hayati(self) -> bool:
        """True for Hayati's rows."""
        return self.convention == HAYATI

    def parallel(self, sine: float, reference: Reference | None) -> bool:
        """Return True if two axes count as parallel.

        Axes that are nearly parallel are so in both robots, although the one may lie on this side of the limit.

        Args:
            sine: Sine of the angle between them.
            reference: The row of the other robot between these axes; None for none.
        """
        if not self.hayati:
            return sine < self.limit
        if reference is not None:
            return reference.row.near_parallel
        return bool(sine < np.sin(NEARLY_PARALLEL_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A row of the robot whose open choices are kept."""

    #: The row
    row: DHRow
    #: Shape (3,), x axis of its frame, in the base at q = 0
    x: Array
    #: Shape (4, 4), [m], pose of that robot's tip in frame n
    T_n_tip: Array


class RowNumbers(NamedTuple):
    """The numbers of one row, from a frame on a joint's axis to the next axis."""

    #: Angle about the axis, from x of the frame to the common normal [rad]
    theta: float
    #: Distance along the axis, from the frame's origin to the foot of the common normal [m]
    d: float
    #: Distance along the common normal, to the next axis [m]
    a: float
    #: Angle about the common normal, from the axis to the next [rad]
    alpha: float
    #: Tilt of the next axis along the normal, of Hayati's rows between nearly parallel axes; else 0 [rad]
    beta: float


def row_to(
    T: Array,
    point: Array,
    axis: Array,
    reference: Reference | None,
    rule: Rule,
) -> RowNumbers:
    """Return the row from a frame to the axis of the next joint.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        point: Shape (3,), [m], a point of the next axis, in the base.
        axis: Shape (3,), unit vector along it.
        reference: The row whose open choices are kept; None for none.
        rule: The convention, and the angle below which axes count as parallel.
    """
    z = T[:3, 2]
    normal = cross(z, axis)
    sine = float(np.linalg.norm(normal))
    between = point - T[:3, 3]
    if rule.parallel(sine, reference):
        return _row_to_parallel(T, axis, between, reference, rule)
    normal /= sine
    if _points_backwards(normal, T[:3, 0], between, reference):
        normal = -normal
    # Feet of the common normal: origin + d z + a normal = point + s axis.
    d, a, _ = np.linalg.solve(np.stack([z, normal, -axis], axis=1), between)
    return RowNumbers(
        theta=_turn(T[:3, 0], normal, about=z),
        d=float(d),
        a=float(a),
        alpha=_turn(z, axis, about=normal),
        beta=0.0,
    )


def _row_to_parallel(
    T: Array, axis: Array, between: Array, reference: Reference | None, rule: Rule
) -> RowNumbers:
    """Return the row from a frame to an axis that counts as parallel; d is 0, or the reference's where it is kept.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        axis: Shape (3,), unit vector along the next axis.
        between: Shape (3,), [m], from the frame's origin to a point of that axis.
        reference: The row whose open choices are kept; None for none.
        rule: The convention, and whether d is kept.
    """
    near = T[:3, 0]
    d = 0.0
    if reference is not None:
        near = reference.x
    if reference is not None and rule.keeps:
        d = reference.row.d
    z = T[:3, 2]
    offset = _offset(between - d * z, z, axis)
    row = _parallel_row(T, axis, offset, near, tilted=rule.hayati)
    return row._replace(d=d)


def _turn(start: Array, end: Array, *, about: Array) -> float:
    """Return the angle in (-pi, pi] by which a turn about an axis takes one vector to another [rad].

    Args:
        start: Shape (3,), unit vector across the axis.
        end: Shape (3,), likewise.
        about: Shape (3,), unit vector along the axis; the turn is positive by the right-hand rule.
    """
    return float(np.arctan2(cross(start, end) @ about, start @ end))


def _offset(between: Array, z: Array, axis: Array) -> Array:
    """Return the offset (3,) [m] from a frame's origin to a nearly parallel axis in the plane across z: there d = 0.

    Args:
        between: Shape (3,), [m], from the frame's origin to a point of the axis.
        z: Shape (3,), z axis of the frame.
        axis: Shape (3,), unit vector along the axis.
    """
    return between - axis * (between @ z) / (axis @ z)


def _points_backwards(normal: Array, x: Array, between: Array, reference: Reference | None) -> bool:
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
    if along < -TOLERANCE:
        return True
    return bool(along < TOLERANCE and between @ normal < -TOLERANCE)


def _parallel_row(T: Array, axis: Array, offset: Array, near: Array, *, tilted: bool) -> RowNumbers:
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
        if normal @ near < -TOLERANCE:
            a = -a
            normal = -normal
    else:
        a = 0.0
        normal = _across(z, near)
    beta = 0.0
    if tilted:
        beta = float(np.arcsin(np.clip(axis @ normal, -1.0, 1.0)))
    alpha = float(np.arctan2(-(axis @ cross(z, normal)), axis @ z))
    return RowNumbers(_turn(x, normal, about=z), 0.0, a, alpha, beta)


def last_row(T: Array, T_base_tip: Array, reference: Reference | None, rule: Rule) -> RowNumbers:
    """Return the row from the last axis to the tip, whose frame is the tip's where it can be.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        T_base_tip: Shape (4, 4), [m], the tip at q = 0.
        reference: The row whose open choices are kept; None for none.
        rule: The convention, and the angle below which axes count as parallel.
    """
    z = T[:3, 2]
    axis = T_base_tip[:3, 2]
    sine = np.linalg.norm(cross(z, axis))
    if reference is not None and rule.keeps:
        return _last_row_like(T, T_base_tip, reference)
    if sine >= np.sin(NEARLY_PARALLEL_RAD):
        return row_to(T, T_base_tip[:3, 3], axis, reference, rule)
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


def _last_row_like(T: Array, T_base_tip: Array, reference: Reference) -> RowNumbers:
    """Return the last row with a, alpha and beta of another robot's, so that T_n_tip takes up how the tip moved.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        T_base_tip: Shape (4, 4), [m], the tip at q = 0.
        reference: The other robot's last row.
    """
    row = reference.row
    fixed = replace(row, theta=0.0, d=0.0).matrix()
    T_tip_row = rigid_inverse(fixed @ reference.T_n_tip)
    turn = rigid_inverse(T) @ T_base_tip @ T_tip_row
    theta = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    return RowNumbers(float(theta), float(turn[2, 3]), row.a, row.alpha, row.beta)


def sliding_axis(
    T: Array,
    axis: Array,
    reference: Reference,
    rule: Rule,
    beyond: tuple[Array, Array, Reference] | None,
) -> Array:
    """Return a point that the axis of a sliding joint is taken through.

    Only the direction in which a joint slides matters: its axis may be moved sideways, here so that rows keep their
    numbers. The row to the axis keeps d and a. Where the axis behind it is parallel, the row from it keeps d, a and
    theta instead: if the two were one line, no number of that row could hold a correction that moves one beside the
    other.

    Args:
        T: Shape (4, 4), [m], the frame before the row to the sliding axis, in the base at q = 0.
        axis: Shape (3,), unit vector along the sliding axis.
        reference: The row to it.
        rule: The convention, and the angle below which axes count as parallel.
        beyond: A point (3,) [m] of the axis behind it, that axis (3,), and the row to it; None if the sliding joint is
            the last, or the joint behind it slides, too.

    Returns:
        Shape (3,), [m], in the base.
    """
    along = row_to(T, T[:3, 3], axis, reference, rule)
    if beyond is not None:
        point, next_axis, row_beyond = beyond
        if rule.parallel(float(np.linalg.norm(cross(axis, next_axis))), row_beyond):
            start, across = _plane_of_foot(T, axis, along.theta, reference, rule)
            back = axis * row_beyond.row.d + _across(axis, row_beyond.x) * row_beyond.row.a
            end = point - back
            return np.asarray(end + next_axis * (((start - end) @ across) / (next_axis @ across)))
    kept = replace(reference.row, theta=along.theta, alpha=0.0, beta=0.0)
    return np.asarray((T @ kept.matrix())[:3, 3])


def _plane_of_foot(
    T: Array, axis: Array, theta: float, reference: Reference, rule: Rule
) -> tuple[Array, Array]:
    """Return the plane that the frame behind a row can lie in, whose theta is given and whose a is free.

    Of a parallel axis d is kept, so that the plane lies across z; of another one d is free, so that it lies along z
    and x.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        axis: Shape (3,), unit vector along the next axis.
        theta: Angle about z of the frame, from its x to that of the frame behind the row [rad].
        reference: The row whose numbers are kept.
        rule: The convention, and the angle below which axes count as parallel.

    Returns:
        A point of the plane, shape (3,), [m], and its normal, shape (3,).
    """
    z = T[:3, 2]
    if rule.parallel(float(np.linalg.norm(cross(z, axis))), reference):
        return T[:3, 3] + z * reference.row.d, z
    x = T[:3, :3] @ np.array([np.cos(theta), np.sin(theta), 0.0])
    return T[:3, 3], cross(z, x)


def first_frame(point: Array, axis: Array, near: Array) -> Array:
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
    T[:3, :3] = np.stack([x, cross(axis, x), axis], axis=1)
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


def cross(a: Array, b: Array) -> Array:
    """Return the product a x b of two vectors; `numpy.cross` is made for stacks and takes ten times as long.

    Args:
        a: Shape (3,).
        b: Shape (3,).
    """
    a0, a1, a2 = a
    b0, b1, b2 = b
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
