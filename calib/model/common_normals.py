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
from calib.robot.dh_rows import HAYATI, MODIFIED, NEARLY_PARALLEL_RAD, DHRow

#: Parallel axes whose offset is shorter than this coincide except for rounding [m].
_COINCIDENT = 1e-13

#: A tip whose origin is closer to the last axis than this is on it [m].
_ON_AXIS = 1e-3

#: Poses by rows agree with the robot's within this [m; rotation matrices: 1]; products within this are zero.
TOLERANCE = 1e-9

#: A direction whose part across an axis is shorter than this is along it.
_ALONG = 1e-6


@dataclass(frozen=True, slots=True)
class Rule:
    """The convention of rows, and the angle below which they take axes as parallel."""

    #: One of `calib.robot.dh_rows.CONVENTIONS`
    convention: str
    #: Axes at a smaller angle are parallel, in the standard and modified conventions [rad]
    limit: float
    #: True if the references are rows as a controller has them, and every number that can be is kept: d between
    #: parallel axes, the place of a sliding axis, and a, alpha and beta of the last row.
    keeps: bool = False

    @property
    def hayati(self) -> bool:
        """True for Hayati's rows."""
        return self.convention == HAYATI

    def parallel(self, sine: float, reference: Reference | None) -> bool:
        """Return True if two axes count as parallel, for Hayati's rows also if they are nearly so.

        For Hayati's rows the reference decides, if there is one: its axes count as nearly parallel, or not, and so do
        these. Other conventions do not look at it.

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
    """A row of another robot whose open choices are kept."""

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

    Between parallel axes d is 0, or, if the rule keeps numbers, the reference's.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        point: Shape (3,), [m], a point of the next axis, in the base.
        axis: Shape (3,), unit vector along it.
        reference: The row whose open choices are kept; None for none.
        rule: The convention, and the angle below which axes count as parallel.
    """
    x = T[:3, 0]
    z = T[:3, 2]
    normal = cross(z, axis)
    sine = float(np.linalg.norm(normal))
    between = point - T[:3, 3]
    if rule.parallel(sine, reference):
        near = x
        kept_d = 0.0
        if reference is not None:
            near = reference.x
            if rule.keeps:
                kept_d = reference.row.d
        beyond_d = between - kept_d * z
        # Along the axis into the plane across z: there d = 0.
        offset = beyond_d - axis * (beyond_d @ z) / (axis @ z)
        return _parallel_row(T, axis, offset, near, tilted=rule.hayati)._replace(d=kept_d)

    normal /= sine
    if reference is not None:
        is_backwards = normal @ reference.x < 0
    else:
        # x_i points as near as possible to x of the frame, or, where it is square to that, towards the next axis.
        along = normal @ x
        is_square = -TOLERANCE <= along < TOLERANCE
        is_backwards = along < -TOLERANCE or (is_square and between @ normal < -TOLERANCE)
    if is_backwards:
        normal = -normal
    # Feet of the common normal: origin + d z + a normal = point + s axis.
    d, a, _ = np.linalg.solve(np.stack([z, normal, -axis], axis=1), between)
    return RowNumbers(
        theta=_turn(x, normal, about=z),
        d=float(d),
        a=float(a),
        alpha=_turn(z, axis, about=normal),
        beta=0.0,
    )


def _turn(start: Array, end: Array, *, about: Array) -> float:
    """Return the angle in (-pi, pi] by which a turn about an axis takes one unit vector across it to another [rad]."""
    return float(np.arctan2(cross(start, end) @ about, start @ end))


def _parallel_row(T: Array, axis: Array, offset: Array, near: Array, *, tilted: bool) -> RowNumbers:
    """Return the row, with d = 0, from a frame T, (4, 4), to a parallel axis at an offset, (3,) [m], from its origin.

    Axis and offset are in the base; x_i points nearest to the direction ``near``, (3,). A tilted row has a beta, for an
    axis that is nearly parallel.
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
    """Return the row from the last axis to the tip, whose frame is the tip's if it can be.

    If it cannot, the frame after the row is on the last axis, or where the reference's a, alpha and beta put it, and
    T_n_tip, which is not returned here, leads on to the tip.

    Args:
        T: Shape (4, 4), [m], the frame before the row, in the base at q = 0.
        T_base_tip: Shape (4, 4), [m], the tip at q = 0.
        reference: The row whose open choices are kept; None for none.
        rule: The convention, and the angle below which axes count as parallel.
    """
    z = T[:3, 2]
    axis = T_base_tip[:3, 2]
    sine = np.linalg.norm(cross(z, axis))
    is_tilted = sine >= np.sin(NEARLY_PARALLEL_RAD)
    if reference is not None and (rule.keeps or not is_tilted):
        # With the reference's a, alpha and beta T_n_tip takes up how the tip moved.
        row = reference.row
        fixed = replace(row, theta=0.0, d=0.0).matrix()
        T_tip_row = rigid_inverse(fixed @ reference.T_n_tip)
        turn = rigid_inverse(T) @ T_base_tip @ T_tip_row
        theta = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        return RowNumbers(float(theta), float(turn[2, 3]), row.a, row.alpha, row.beta)
    if is_tilted:
        return row_to(T, T_base_tip[:3, 3], axis, reference, rule)

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


def sliding_axis(
    T: Array,
    axis: Array,
    reference: Reference,
    rule: Rule,
    beyond: tuple[Array, Array, Reference] | None,
) -> Array:
    """Return a point that the axis of a sliding joint is taken through.

    Only the direction in which a joint slides matters: its axis may be moved sideways, here so that rows keep their
    numbers. The row to the axis keeps d and a. If the axis after it is parallel, the row from it keeps d, a and theta
    instead: if the two were one line, no number of that row could hold a correction that moves one beside the other.

    Args:
        T: Shape (4, 4), [m], the frame before the row to the sliding axis, in the base at q = 0.
        axis: Shape (3,), unit vector along the sliding axis.
        reference: The row to it.
        rule: The convention, and the angle below which axes count as parallel.
        beyond: A point (3,) [m] of the axis after it, that axis (3,), and the row to it; None if the sliding joint is
            the last, or the joint after it slides, too.

    Returns:
        Shape (3,), [m], in the base.
    """
    along = row_to(T, T[:3, 3], axis, reference, rule)
    if beyond is not None:
        point, next_axis, row_beyond = beyond
        if rule.parallel(float(np.linalg.norm(cross(axis, next_axis))), row_beyond):
            # The axis meets the plane in which the frame after the row to it can be: across z where that row keeps d,
            # between parallel axes, else along z and x, with its theta and any d.
            start = T[:3, 3]
            z = T[:3, 2]
            if rule.parallel(float(np.linalg.norm(cross(z, axis))), reference):
                start = start + z * reference.row.d
                across = z
            else:
                theta = along.theta
                across = cross(z, T[:3, :3] @ np.array([np.cos(theta), np.sin(theta), 0.0]))
            back = axis * row_beyond.row.d + _across(axis, row_beyond.x) * row_beyond.row.a
            end = point - back
            return np.asarray(end + next_axis * (((start - end) @ across) / (next_axis @ across)))
    kept = replace(reference.row, theta=along.theta, alpha=0.0, beta=0.0)
    return np.asarray((T @ kept.matrix())[:3, 3])


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
    """Return the unit vector, (3,), across z that is nearest to another, or to base y or z if that lies along z."""
    for direction in (near, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])):
        across = direction - z * (z @ direction)
        length = np.linalg.norm(across)
        if length >= _ALONG:
            # Once more: rounding of a short vector leaves a part along z after the first pass.
            across = across / length
            across = across - z * (z @ across)
            break
    return np.asarray(across / np.linalg.norm(across))


def cross(a: Array, b: Array) -> Array:
    """Return the product a x b, (3,), of two vectors, (3,); `numpy.cross`, for stacks, takes ten times as long."""
    a0, a1, a2 = a
    b0, b1, b2 = b
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
