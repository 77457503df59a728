"""The DH table of a robot's chain, row by row from the base to the tip; `calib.robot.dh_rows` has the conventions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.model.common_normals import (
    TOLERANCE,
    Reference,
    Rule,
    cross,
    first_frame,
    last_row,
    row_to,
    sliding_axis,
)
from calib.robot.dh_rows import (
    HAYATI,
    MODIFIED,
    NEARLY_PARALLEL_RAD,
    STANDARD,
    DHRow,
    DHTable,
    dh_frames,
    screw,
)
from calib.robot.robot import Robot

#: Axes closer to parallel than the first of these [rad] differ by the rounding of a URDF's text: their common normal
#: would be noise. After a common normal that is far away even such an angle makes metres: then the first angle whose
#: rows hold the robot is taken.
_PARALLEL = (5e-7, 1e-8, 1e-10, 1e-12)

#: A number that differs from that of a sheet by less differs by rounding [m or rad].
_ROUNDING = 1e-13

#: Number of joint values at which rows are compared with the robot.
_POSES = 8

#: Seed of these joint values, so that the same robot always gets the same rows.
_SEED = 20170401


def dh_table(
    robot: Robot,
    convention: str = HAYATI,
    like: Robot | None = None,
    sheet: DHTable | None = None,
) -> DHTable:
    """Return the DH rows of a robot's chain; `DHTable.poses` then equals ``robot.poses`` up to rounding.

    Args:
        robot: The robot.
        convention: One of `CONVENTIONS`; unless given, Hayati's: standard rows, with beta in place of d between nearly
            parallel axes.
        like: A robot of the same chain, such as the nominal one, whose open choices are kept so that columns compare;
            None to choose as a data sheet does.
        sheet: Rows of the same chain in the same convention, as a controller has them: the robot's differ from them by
            corrections alone, and have their directions and offsets. None for none; with it, ``like`` is not used.

    Example:
        >>> table = dh_table(Robot.load("ur3", base="base", tip="tool0"))
        >>> [round(1000 * row.a, 2) + 0.0 for row in table.rows]
        [0.0, -243.65, -213.25, 0.0, 0.0, 0.0]
    """
    if sheet is not None:
        rule = replace(_rule_for(robot, convention), keeps=True)
        return _in_form_of(sheet, _standard_rows(robot, rule, _standard_form(sheet)))
    reference = None
    if like is not None:
        reference = _standard_rows(like, _rule_for(like, convention))
    table = _standard_rows(robot, _rule_for(robot, convention), reference)
    return _rebracketed(table) if convention == MODIFIED else table


def near_parallel(robot: Robot) -> dict[tuple[str, str], float]:
    """Return the angles between axes of consecutive joints that are nearly, but not exactly, parallel.

    Returns:
        The angle [rad] by the names of the two joints, base to tip; no entry for other joints.
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
    """Return the frames of the chain's n joints and of the tip at q = 0: n poses T_base_joint, and T_base_tip.

    Each is of shape (4, 4), [m], in the base.
    """
    T = rigid_inverse(robot.T_root_base)
    frames = []
    for placement in robot.placements:
        T = T @ placement
        frames.append(T)
    return frames[:-1], frames[-1]


def _rule_for(robot: Robot, convention: str) -> Rule:
    """Return the rule of a convention, which keeps no numbers of a sheet; the limit of Hayati's, 0, is not used."""
    limit = 0.0 if convention == HAYATI else _parallel_limit(robot)
    return Rule(convention, limit)


def _parallel_limit(robot: Robot) -> float:
    """Return the angle [rad] below which axes count as parallel.

    It is the first of `_PARALLEL` with which standard rows have the robot's poses, up to what it neglects, at random
    joint values; else the one with the smallest error.
    """
    sines = _sines(robot)
    random = np.random.default_rng(_SEED)
    q = random.uniform(-np.pi, np.pi, (_POSES, len(robot.joint_names)))
    values = robot.chain_values(q)
    poses = robot.poses(q)
    reach = 1.0 + float(np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum())
    errors: dict[float, float] = {}
    for limit in _PARALLEL:
        table = _standard_rows(robot, Rule(STANDARD, limit))
        errors[limit] = float(np.abs(table.poses(values) - poses).max())
        neglected = max((sine for sine in sines if sine < limit), default=0.0)
        if errors[limit] <= TOLERANCE + 2.0 * reach * neglected:
            return limit
    return min(errors, key=lambda limit: errors[limit])


def _axes(robot: Robot, T_base_joint: Sequence[Array]) -> list[Array]:
    """Return the unit vector of each joint's axis, shape (3,), in the base, from its pose (4, 4) in the base."""
    return [T[:3, :3] @ joint.axis for T, joint in zip(T_base_joint, robot.joints, strict=True)]


def _sines(robot: Robot) -> list[float]:
    """Return the sine of the angle between the axes of each joint and the next, n - 1 of them."""
    T_base_joint, _ = zero_poses(robot)
    axes = _axes(robot, T_base_joint)
    return [float(np.linalg.norm(cross(*pair))) for pair in pairwise(axes)]


def _standard_rows(robot: Robot, rule: Rule, like: DHTable | None = None) -> DHTable:
    """Return the DH rows, bracketed as standard ones are also for the modified convention.

    The open choices are those of ``like``, rows of a robot of the same chain that are bracketed in the same way; None:
    they are made as a data sheet does.
    """
    T_base_joint, T_base_tip = zero_poses(robot)
    slides = [joint.type == "prismatic" for joint in robot.joints]
    near = np.eye(4)
    references: list[Reference | None] = [None] * len(robot.joints)
    if like is not None:
        near = like.T_base_0
        for i, (row, frame) in enumerate(zip(like.rows, dh_frames(like), strict=True)):
            references[i] = Reference(row, frame[:3, 0], like.T_n_tip)
    directions = [1 if of_row is None else of_row.row.direction for of_row in references]

    # A point of each joint's axis, and the axes as rows have them: turned round if the direction is -1.
    points = [T[:3, 3] for T in T_base_joint]
    axes = _axes(robot, T_base_joint)
    axes = [direction * axis for direction, axis in zip(directions, axes, strict=True)]
    if rule.keeps and slides[0]:
        points[0] = near[:3, 3]
    T_base_0 = first_frame(points[0], axes[0], near)

    # Each row begins where those before it end: digits that one cannot hold, as the last of a d of kilometres, go into
    # the next.
    T = T_base_0
    rows: list[DHRow] = []
    for i, (joint, reference) in enumerate(zip(robot.joints, references, strict=True)):
        following = i + 1
        if following == len(axes):
            numbers = last_row(T, T_base_tip, reference, rule)
        else:
            if rule.keeps and slides[following]:
                beyond = None
                row_beyond = references[following]
                if i + 2 < len(axes) and not slides[i + 2] and row_beyond is not None:
                    beyond = (points[i + 2], axes[i + 2], row_beyond)
                assert reference is not None, "only numbers of references are kept"
                points[following] = sliding_axis(T, axes[following], reference, rule, beyond)
            numbers = row_to(T, points[following], axes[following], reference, rule)
        row = DHRow(
            joint.name,
            slides[i],
            *numbers,
            direction=directions[i],
            lower=joint.lower,
            upper=joint.upper,
        )
        rows.append(_tidy(row, reference))
        T = T @ rows[-1].matrix()
    return DHTable(
        rows=tuple(rows),
        T_base_0=read_only(T_base_0),
        T_n_tip=read_only(rigid_inverse(T) @ T_base_tip),
        convention=HAYATI if rule.hayati else STANDARD,
    )


def _standard_form(sheet: DHTable) -> DHTable:
    """Return DH rows of any convention, bracketed as standard ones, with offsets in theta, or in d if they slide."""
    rows = [_with_offset(row) for row in sheet.rows]
    if sheet.convention != MODIFIED:
        return replace(sheet, rows=tuple(rows))
    moved = []
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        a, alpha = (0.0, 0.0) if following is None else (following.a, following.alpha)
        moved.append(replace(row, a=a, alpha=alpha))
    first = screw(0, rows[0].alpha, rows[0].a)
    return DHTable(tuple(moved), sheet.T_base_0 @ first, sheet.T_n_tip, STANDARD)


def _in_form_of(sheet: DHTable, table: DHTable) -> DHTable:
    """Return DH rows that are bracketed as standard ones in the convention of a sheet of DH rows, with its offsets.

    Numbers and poses that differ from the sheet's by rounding are the sheet's.
    """
    if sheet.convention == MODIFIED:
        first = sheet.rows[0]
        table = _rebracketed(table)
        # The sheet's first row may have a and alpha, which frame 0 took up in `_rebracketed`.
        moved_rows = (replace(table.rows[0], a=first.a, alpha=first.alpha), *table.rows[1:])
        before = rigid_inverse(screw(0, first.alpha, first.a))
        table = DHTable(moved_rows, read_only(table.T_base_0 @ before), table.T_n_tip, MODIFIED)
    rows = []
    for row, of_sheet in zip(table.rows, sheet.rows, strict=True):
        moved = _with_offset(row, of_sheet.offset)
        settled = replace(
            moved,
            theta=_settled(moved.theta, of_sheet.theta),
            d=_settled(moved.d, of_sheet.d),
            a=_settled(moved.a, of_sheet.a),
            alpha=_settled(moved.alpha, of_sheet.alpha),
            beta=_settled(moved.beta, of_sheet.beta),
        )
        rows.append(settled)
    return replace(
        table,
        rows=tuple(rows),
        T_base_0=read_only(_settled_pose(table.T_base_0, sheet.T_base_0)),
        T_n_tip=read_only(_settled_pose(table.T_n_tip, sheet.T_n_tip)),
    )


def _settled(value: float, of_sheet: float) -> float:
    """Return the number of a sheet if a row's own differs from it by rounding, else the row's [m or rad]."""
    return of_sheet if abs(value - of_sheet) < _ROUNDING else value


def _settled_pose(T: Array, of_sheet: Array) -> Array:
    """Return the pose of a sheet, (4, 4) [m], if another differs from it by rounding, else the other."""
    return of_sheet if np.abs(T - of_sheet).max() < _ROUNDING else T


def _with_offset(row: DHRow, offset: float = 0.0) -> DHRow:
    """Return the same row with another offset [rad or m]: theta, or d if the joint slides, takes up the difference."""
    moved = row.offset - offset
    if row.prismatic:
        return replace(row, d=row.d + moved, offset=offset)
    return replace(row, theta=row.theta + moved, offset=offset)


def _rebracketed(table: DHTable) -> DHTable:
    """Return standard DH rows as modified ones: a and alpha move a row down, the last into T_n_tip."""
    moved = []
    a = 0.0
    alpha = 0.0
    for row in table.rows:
        moved.append(replace(row, a=a, alpha=alpha))
        a = row.a
        alpha = row.alpha
    T_n_tip = read_only(screw(0, alpha, a) @ table.T_n_tip)
    return DHTable(tuple(moved), table.T_base_0, T_n_tip, MODIFIED)


def _tidy(row: DHRow, reference: Reference | None) -> DHRow:
    """Return the DH row without negative zeros, and with theta and alpha [rad] plus or minus whole turns.

    They are within half a turn of the reference's; without one -pi becomes pi.
    """
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
    return angle + 2 * np.pi if angle < -np.pi + TOLERANCE else angle


def _in_turn_of(reference: float, angle: float) -> float:
    """Return an angle [rad] plus the whole turns that bring it nearest to a reference."""
    return angle + 2 * np.pi * round((reference - angle) / (2 * np.pi))
