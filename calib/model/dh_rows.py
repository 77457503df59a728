"""The DH rows of a robot's chain, in any of `dh_conventions.CONVENTIONS`.

Rows of two robots compare if their free choices agree, which `dh_rows` sees to: signs and turns nearest to those of
the robot that they are held against, frame 0 nearest to its frame 0, and what lies behind the last axis, where the tip
turns about it, in T_n_tip alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.model.dh import NEARLY_PARALLEL_RAD, zero_poses
from calib.model.dh_conventions import (
    CONVENTIONS,
    HAYATI,
    MODIFIED,
    STANDARD,
    DHRows,
    Row,
    row_matrix,
    screw,
)
from calib.model.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: Axes closer to parallel than the first of these [rad] are rounding of a URDF's text: the common normal would be of
#: noise. Behind a common normal that lies far away even such an angle is metres: there the first that holds is taken.
_PARALLEL = (5e-7, 1e-8, 1e-10, 1e-12)

#: An offset between parallel axes below this is rounding [m].
_COINCIDENT = 1e-13

#: A tip whose z axis lies beside the last axis by less is on it [m]: what a calibration moves it by has no direction.
_ON_AXIS = 1e-3

_TOLERANCE = 1e-9

#: Joint values at which rows are compared with the robot to see whether they hold it, the same every time.
_POSES, _SEED = 8, 20170401


def dh_rows(robot: Robot, convention: str = STANDARD, like: Robot | None = None) -> DHRows:
    """The DH rows of a robot's chain; `DHRows.poses` then equals ``robot.poses`` up to rounding.

    Axes within 5e-7 rad of parallel are taken as parallel by the pure conventions, standard and modified: the poses
    are then off by that angle times the arm's reach. Beside axes that are nearly, but not so nearly, parallel, where
    they would be off by more, only axes within 1e-8, 1e-10 or 1e-12 rad are.

    Args:
        robot: The robot.
        convention: One of `CONVENTIONS`.
        like: A robot of the same chain, such as the nominal one: choices that the convention leaves open are made as
            in ``dh_rows(like, convention)``, so that the columns compare.

    Raises:
        ModelError: No such convention, or ``like`` has other joints.

    Example:
        >>> rows = dh_rows(Robot.load("panda", tip="panda_link8"), "modified").rows
        >>> [round(1000 * row.a, 1) for row in rows]
        [0.0, 0.0, 0.0, 82.5, -82.5, 0.0, 88.0]
    """
    if convention not in CONVENTIONS:
        message = f"There is no DH convention '{convention}'; it is one of {choices(CONVENTIONS)}."
        raise ModelError(message)
    wanted = None
    if like is not None:
        _check_same_chain(robot, like)
        wanted = _product(like, convention, None, _limit(like))
    found = _product(robot, convention, wanted, _limit(robot))
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
    return _largest_below(_limit(robot), _sines(robot))


def _limit(robot: Robot) -> float:
    """The angle [rad] below which axes are taken as parallel: the largest of `_PARALLEL` whose rows hold the robot."""
    sines = _sines(robot)
    if _largest_below(_PARALLEL[0], sines) <= _PARALLEL[-1]:
        return _PARALLEL[0]
    q = np.random.default_rng(_SEED).uniform(-np.pi, np.pi, (_POSES, len(robot.joint_names)))
    values, poses = robot.chain_values(q), robot.poses(q)
    reach = 1.0 + float(np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum())
    off = {}
    for limit in _PARALLEL:
        rows = _product(robot, STANDARD, None, limit)
        off[limit] = float(np.abs(rows.poses(values) - poses).max())
        if off[limit] <= _TOLERANCE + 2.0 * reach * _largest_below(limit, sines):
            return limit
    return min(off, key=lambda limit: off[limit])


def _largest_below(limit: float, sines: list[float]) -> float:
    """The largest of the sines below a limit; 0 without such."""
    return max((sine for sine in sines if sine < limit), default=0.0)


def _sines(robot: Robot) -> list[float]:
    """The sine of the angle between the axes of each joint and the next."""
    frames, _ = zero_poses(robot)
    axes = [T[:3, :3] @ joint.axis for T, joint in zip(frames, robot.joints, strict=True)]
    return [float(np.linalg.norm(np.cross(*pair))) for pair in pairwise(axes)]


def _check_same_chain(robot: Robot, like: Robot) -> None:
    """Refuse robots whose rows cannot stand beside each other."""
    ours, theirs = (
        [(joint.name, joint.type == "prismatic") for joint in one.joints] for one in (robot, like)
    )
    if ours != theirs:
        message = (
            f"The robots have other joints: {choices(name for name, _ in ours)} between '{robot.base}' and "
            f"'{robot.tip}', and {choices(name for name, _ in theirs)} between '{like.base}' and '{like.tip}'. DH rows "
            "compare if both are the same chain: give two states of one robot, with the same base and tip."
        )
        raise ModelError(message)


def _rebracketed(rows: DHRows) -> DHRows:
    """Standard rows as modified ones: a and alpha move down by a row, those of the last into the tip."""
    moved = []
    a, alpha = 0.0, 0.0
    for row in rows.rows:
        moved.append(replace(row, a=a, alpha=alpha))
        a, alpha = row.a, row.alpha
    return DHRows(
        MODIFIED, tuple(moved), rows.T_base_0, read_only(screw(0, alpha, a) @ rows.T_n_tip)
    )


def _product(robot: Robot, convention: str, like: DHRows | None, limit: float) -> DHRows:
    """The rows in the standard bracketing, each relative to the frame that the rows before it give.

    So what one row cannot hold, as the last digits of a d of kilometres, the next makes good. ``limit`` is the angle
    [rad] below which the pure conventions take axes as parallel.
    """
    frames, T_base_tip = zero_poses(robot)
    axes = [T[:3, :3] @ joint.axis for T, joint in zip(frames, robot.joints, strict=True)]
    seen = None if like is None else _frames(like)
    T_base_0 = _first_frame(axes[0], frames[0][:3, 3], np.eye(4) if like is None else like.T_base_0)
    T, rows = T_base_0, []
    for i, joint in enumerate(robot.joints):
        wanted = None if like is None or seen is None else _Wanted(like.rows[i], seen[i][:3, 0])
        if i + 1 < len(axes):
            line = (frames[i + 1][:3, 3], axes[i + 1])
            numbers = _row(T, line, convention, wanted, limit)
        else:
            T_n_tip = None if like is None else like.T_n_tip
            numbers = _last_row(T, T_base_tip, convention, wanted, T_n_tip, limit)
        row = _tidy(Row(joint.name, joint.type == "prismatic", *numbers), wanted)
        rows.append(row)
        T = T @ row_matrix(row)
    T_n_tip = rigid_inverse(T) @ T_base_tip
    return DHRows(convention, tuple(rows), read_only(T_base_0), read_only(T_n_tip))


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What a row is to be like: another robot's row, and its x direction in base at q = 0."""

    row: Row
    x: Array


#: theta, d, a, alpha, beta.
_Numbers = tuple[float, float, float, float, float]


def _row(
    T: Array, line: tuple[Array, Array], convention: str, wanted: _Wanted | None, limit: float
) -> _Numbers:
    """The row from a frame to the axis of the next joint, a line through a point."""
    point, axis = line
    z, x = T[:3, 2], T[:3, 0]
    normal = np.cross(z, axis)
    sine = float(np.linalg.norm(normal))
    between = point - T[:3, 3]
    if convention == HAYATI:
        # What is nearly parallel is so in both robots, although the one may lie on this side of the limit.
        leaning = sine if wanted is None else _sine(wanted.row)
        parallel = leaning < np.sin(NEARLY_PARALLEL_RAD)
    else:
        parallel = sine < limit
    if parallel:
        # The next origin is where the next axis meets the plane through this one's origin: d = 0.
        offset = between - axis * (between @ z) / (axis @ z)
        return _parallel_row(T, axis, offset, convention, x if wanted is None else wanted.x)
    normal /= sine
    if wanted is not None:
        turned = normal @ wanted.x < 0
    else:
        along = normal @ x
        turned = along < -_TOLERANCE or (along < _TOLERANCE and between @ normal < -_TOLERANCE)
    if turned:
        normal = -normal
    # Feet of the common normal: origin + d z + a normal = point + s axis.
    d, a, _ = np.linalg.solve(np.stack([z, normal, -axis], axis=1), between)
    alpha = np.arctan2(np.cross(z, axis) @ normal, z @ axis)
    theta = np.arctan2(np.cross(x, normal) @ z, x @ normal)
    return float(theta), float(d), float(a), float(alpha), 0.0


def _sine(row: Row) -> float:
    """The sine of the angle between a row's two axes."""
    return float(np.hypot(np.sin(row.alpha), np.cos(row.alpha) * np.sin(row.beta)))


def _parallel_row(T: Array, axis: Array, offset: Array, convention: str, hint: Array) -> _Numbers:
    """The row to a (nearly) parallel axis: a along x in the plane across z, then alpha and, Hayati's, beta tilt z."""
    z, x = T[:3, 2], T[:3, 0]
    offset = offset - z * (z @ offset)
    a = float(np.linalg.norm(offset))
    if a > _COINCIDENT:
        normal = _across(z, offset / a)
        a = float(offset @ normal)
        if normal @ hint < -_TOLERANCE:
            a, normal = -a, -normal
    else:
        a, normal = 0.0, _across(z, hint)
    beta = float(np.arcsin(np.clip(axis @ normal, -1.0, 1.0))) if convention == HAYATI else 0.0
    alpha = np.arctan2(-(axis @ np.cross(z, normal)), axis @ z)
    theta = np.arctan2(np.cross(x, normal) @ z, x @ normal)
    return float(theta), 0.0, a, float(alpha), beta


def _last_row(
    T: Array,
    T_base_tip: Array,
    convention: str,
    wanted: _Wanted | None,
    T_n_tip: Array | None,
    limit: float,
) -> _Numbers:
    """The row from the last axis to the tip, whose frame is the tip's where it can be."""
    z, axis, between = T[:3, 2], T_base_tip[:3, 2], T_base_tip[:3, 3] - T[:3, 3]
    sine = np.linalg.norm(np.cross(z, axis))
    if sine >= np.sin(NEARLY_PARALLEL_RAD):
        return _row(T, (T_base_tip[:3, 3], axis), convention, wanted, limit)
    if wanted is not None and T_n_tip is not None:
        # How the tip lies behind the axis is no matter of the joint: T_n_tip says how it moved.
        row = wanted.row
        fixed = row_matrix(replace(row, theta=0.0, d=0.0))
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
    theta, _, a, alpha, beta = _parallel_row(T, axis, across, convention, T_base_tip[:3, 0])
    return theta, along, a, alpha, beta


def _tidy(row: Row, wanted: _Wanted | None) -> Row:
    """Without signs of zero, and angles in the turn of those that they are held against."""
    theta, alpha = row.theta, row.alpha
    if wanted is None:
        theta, alpha = _half_turn(theta), _half_turn(alpha)
    else:
        theta, alpha = _nearest(theta, wanted.row.theta), _nearest(alpha, wanted.row.alpha)
    return replace(
        row,
        theta=theta + 0.0,
        d=row.d + 0.0,
        a=row.a + 0.0,
        alpha=alpha + 0.0,
        beta=row.beta + 0.0,
    )


def _half_turn(angle: float) -> float:
    """Half a turn is said as pi, not as -pi, of which rounding makes one or the other."""
    return angle + 2 * np.pi if angle < -np.pi + _TOLERANCE else angle


def _nearest(angle: float, to: float) -> float:
    """The angle a whole number of turns on that is nearest to another."""
    return angle + 2 * np.pi * round((to - angle) / (2 * np.pi))


def _frames(rows: DHRows) -> list[Array]:
    """The frames F_i before the rotation about beta, at q = 0, in base; n of them, (4, 4), [m]."""
    T, frames = rows.T_base_0, []
    for row in rows.rows:
        frames.append(T @ row_matrix(replace(row, beta=0.0)))
        T = T @ row_matrix(row)
    return frames


def _first_frame(axis: Array, point: Array, near: Array) -> Array:
    """Frame 0: z along the first axis, origin and x nearest to those of another frame."""
    T = np.eye(4)
    x = _across(axis, near[:3, 0])
    T[:3, :3] = np.stack([x, np.cross(axis, x), axis], axis=1)
    T[:3, 3] = point + axis * (axis @ (near[:3, 3] - point))
    return T


def _across(z: Array, hint: Array) -> Array:
    """The unit vector across z that is nearest to the hint, or to base y or z where the hint lies along z."""
    for direction in (hint, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])):
        across = direction - z * (z @ direction)
        length = np.linalg.norm(across)
        if length >= 1e-6:
            # Twice is enough: what the first pass leaves along z is rounding of a short vector.
            across = across / length
            across = across - z * (z @ across)
            break
    result: Array = across / np.linalg.norm(across)
    return result
