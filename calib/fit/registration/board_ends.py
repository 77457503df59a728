"""Which end of a board is the first: told by the robot, where the print looks the same from several sides.

A chessboard of which columns and rows are both even, or both odd, looks the same after half a turn, and a square one of
odd squares after a quarter. A picture alone does not show from which end its corners are to be numbered. The robot's
motion does: if the corners of the views i and j are numbered from one end,

    R_i R_j^T = R_f (B_i B_j^T) R_f^T,

with the board's orientation R_i in the camera, the tip's orientation B_i in the base, and the camera's unknown
orientation R_f in it. Both sides turn by the same angle, whatever R_f is; with different ends they hardly ever do. So
the ends of the views of one camera follow from each other; which of them is called the first is a convention of the
board's frame, which all cameras have in common.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.basics.arrays import Array, Integers, read_only
from calib.boards.board import Board
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.fit.registration.registration import register_all_rows
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.registration.views import views_as_poses
from calib.robot.robot import Robot

#: Angles of motions that differ by more than this are not those of one motion, however much more it is [rad].
_NOT_THE_SAME = 0.3

#: Rounds in which each view's end is chosen again by those of the others, and by the frames and targets registered.
_ROUNDS = 10

#: Tolerance of a registration: three digits are enough to tell ends apart.
_TOLERANCE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class _Turns:
    """The k turns about its centre after which a board looks the same; the first is none."""

    #: Shape (k, n), the corner that each corner comes to lie on
    orders: Integers
    #: Shape (k, 4, 4), motion of the board's frame that takes each corner to that one [m]
    T: Array

    @classmethod
    def of(cls, board: Board) -> _Turns:
        """Return the turns of a board."""
        corners = board.corners
        centre = corners.mean(axis=0)
        first = corners[0, :2] - centre[:2]
        T = np.tile(np.eye(4), (len(board.orders_alike), 1, 1))
        for turn, order in zip(T, board.orders_alike, strict=True):
            to = corners[order[0], :2] - centre[:2]
            cosine, sine = first @ to, first[0] * to[1] - first[1] * to[0]
            turn[:2, :2] = np.array([[cosine, -sine], [sine, cosine]]) / (first @ first)
            turn[:3, 3] = centre - turn[:3, :3] @ centre
        return cls(board.orders_alike, T)


def numbered_from_one_end(robot: Robot, table: Measurements, cell: Cell) -> Measurements:
    """Number the corners of boards that look the same from several sides from one end, as the robot's motion tells.

    Args:
        robot: The nominal robot.
        table: Rows of any kind, N in all.
        cell: Its boards say which of them look the same after a turn.

    Returns:
        The table with other corners and places on the board in the views that were numbered from another end than most,
        which are listed in `Measurements.other_end`; as it is if it has no such board, or no view determines a pose.

    Raises:
        MeasurementError: What is known of a camera is not enough or contradicts its rows.
    """
    if not _alike_targets(table, cell):
        return table
    rows, setup = rows_and_setup(robot, table, cell)
    T_base_tip = robot.poses(rows.joints, rows.samples.chain)
    return with_ends_of(table, cell, rows, setup.with_given_fixed(), T_base_tip)


def with_ends_of(
    table: Measurements, cell: Cell, rows: Rows, setup: Setup, T_base_tip: Array
) -> Measurements:
    """Number the corners of boards from the ends that suit frames and targets, known ones or registered.

    Args:
        table: N rows.
        cell: Its boards.
        rows: The same rows as arrays.
        setup: Frames and targets; those that it leaves unknown are registered.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].

    Returns:
        The table, see `numbered_from_one_end`.
    """
    turns = _alike_targets(table, cell)
    is_alike = table.is_image & np.isin(table.targets, list(turns))
    if not np.any(is_alike):
        return table
    places = np.flatnonzero(is_alike)
    try:
        poses, first = views_as_poses(rows.select(places))
    except MeasurementError:  # the fit says so
        return table
    by_number = {t: turns[name] for t, name in enumerate(setup.targets) if name in turns}
    ends = _ends(T_base_tip[places[first]], setup, poses, by_number)

    # All rows of a view have its end.
    labels = np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])
    board_points, corners = np.array(table.board_points), list(table.corners)
    other_end = []
    for row, end in zip(places[first].tolist(), ends.tolist(), strict=True):
        if end == 0:
            continue
        turn = turns[table.targets[row]]
        of_view = np.flatnonzero(is_alike & np.all(labels == labels[row], axis=1))
        board_points[of_view] = board_points[of_view] @ turn.T[end, :3, :3].T + turn.T[end, :3, 3]
        for i in of_view.tolist():
            corners[i] = str(turn.orders[end][int(corners[i])])
        other_end.append(table.images[row] or f"row {table.rows[row]}")
    return replace(
        table,
        board_points=read_only(board_points),
        corners=tuple(corners),
        other_end=tuple(other_end),
    )


def _alike_targets(table: Measurements, cell: Cell) -> Mapping[str, _Turns]:
    """Return the turns of each target, by name, whose board looks the same after them; corners have its numbers."""
    result = {}
    for name in dict.fromkeys(table.targets):
        board = cell.boards.get(name, cell.boards.get(""))
        if board is None or not board.looks_same_turned:
            continue
        of_target = table.is_image & np.isin(table.targets, name)
        names = {table.corners[i] for i in np.flatnonzero(of_target).tolist()}
        if all(word.isdecimal() and int(word) < len(board.corners) for word in names):
            result[name] = _Turns.of(board)
    return result


def _ends(T_base_tip: Array, setup: Setup, poses: Rows, turns: Mapping[int, _Turns]) -> Integers:
    """Return the turn of each of V views that puts its board's first corner to one end, shape (V,).

    The tip is at T_base_tip, (V, 4, 4) [m]; ``poses`` are the boards' poses in the cameras, and ``turns`` those of each
    target by its number.
    """
    frame, target = poses.samples.frame, poses.samples.target
    ends = np.zeros(len(poses), dtype=np.int_)
    # Views of one camera and board, one pair after the other: what the first pairs determine is then known.
    pairs, counts = np.unique(np.column_stack([frame, target]), axis=0, return_counts=True)
    registered = setup
    seen = np.zeros(len(poses), dtype=bool)
    for f, t in pairs[np.argsort(-counts, kind="stable")].tolist():
        of_pair = (frame == f) & (target == t)
        among_each_other = _ends_of_pair(
            T_base_tip[of_pair, :3, :3], _orientations(poses.select(of_pair)), turns[t].T[:, :3, :3]
        )
        part, tips = poses.select(of_pair), T_base_tip[of_pair]
        known = registered.with_fixed(*registered.seen_by(poses.samples.select(seen)))
        tried = []
        for k in range(len(turns[t].orders)):
            turned = _turned(part, _after(turns[t], among_each_other, k), turns)
            placed = register_all_rows(tips, known, turned, tolerance=_TOLERANCE)
            tried.append((float(np.median(_off(placed, tips, turned))), k, placed))
        _, k, registered = min(tried, key=lambda entry: entry[:2])
        registered = setup.with_poses(registered.T_frame_base, registered.T_tip_target)
        ends[of_pair] = _after(turns[t], among_each_other, k)
        seen |= of_pair

    # All together, each view by itself.
    for _ in range(_ROUNDS):
        turned = _turned(poses, ends, turns)
        placed = register_all_rows(T_base_tip, setup, turned, tolerance=_TOLERANCE)
        nearest = _nearest_ends(placed, T_base_tip, poses, turns)
        if np.array_equal(nearest, ends):
            break
        ends = nearest

    # Which end of an estimated board is the first is a convention: that of most views.
    for t, of_board in turns.items():
        of_target = target == t
        if setup.target_unknown[t] and np.any(of_target):
            conventions = [_after(of_board, ends[of_target], k) for k in range(len(of_board.T))]
            ends[of_target] = min(conventions, key=lambda turned: int(np.sum(turned != 0)))
    return ends


def _ends_of_pair(R_tip: Array, R_board: Array, turns: Array) -> Integers:
    """Return the turn of each of v views of one camera and board that puts all to the end of one of them, shape (v,).

    Orientations of the tip in the base and of the board in the camera are of shape (v, 3, 3), the turns (k, 3, 3).
    """
    count = len(R_tip)
    angles = _angles(R_tip, R_tip)
    # How far the angles of motions from j to i are off if i is turned by a and j by b, (a, b, v, v).
    off = np.zeros((len(turns), len(turns), count, count))
    for a, b in product(range(len(turns)), repeat=2):
        differ = _angles(R_board @ turns[a].T, R_board @ turns[b].T) - angles
        off[a, b] = np.minimum(np.abs(differ), _NOT_THE_SAME)
    every = np.arange(count)
    off[:, :, every, every] = 0.0  # a view's own end is no reason to keep it
    # Start from the view whose motions tell the ends of the others best.
    spread = np.ptp(off[:, 0], axis=0)
    surest = int(np.argmax(np.sum(spread, axis=0)))
    ends = np.argmin(off[:, 0, :, surest], axis=0)
    for _ in range(_ROUNDS):
        before = ends.copy()
        for i in range(count):
            ends[i] = np.argmin(np.sum(off[:, ends, i, every], axis=1))
        if np.array_equal(before, ends):
            break
    return np.asarray(ends)


def _angles(R: Array, S: Array) -> Array:
    """Return the angles of the rotations R_i S_j^T, (v, 3, 3) each, shape (v, v) [rad]."""
    traces = R.reshape(len(R), 9) @ S.reshape(len(S), 9).T
    return np.asarray(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))


def _orientations(poses: Rows) -> Array:
    """Return the measured orientations of pose rows, shape (V, 3, 3)."""
    return poses.measured[:, 3:12].reshape(-1, 3, 3)


def _after(turns: _Turns, ends: Integers, further: int) -> Integers:
    """Return the numbers of the turns of views (v,), each followed by one more turn."""
    first = turns.orders[further][
        turns.orders[:, 0]
    ]  # of each turn, where it takes the first corner
    number = {int(corner): k for k, corner in enumerate(turns.orders[:, 0])}
    return np.array([number[int(corner)] for corner in first])[ends]


def _turned(poses: Rows, ends: Integers, turns: Mapping[int, _Turns]) -> Rows:
    """Return the poses of boards, V rows, numbered from other ends, (V,): T_camera_board G^-1 after a turn G."""
    measured = poses.measured.copy()
    for t, of_board in turns.items():
        rows = (poses.samples.target == t) & (ends != 0)
        if np.any(rows):
            inverse = np.linalg.inv(of_board.T[ends[rows]])
            R = _orientations(poses)[rows]
            measured[rows, :3] += (R @ inverse[:, :3, 3, None])[:, :, 0]
            measured[rows, 3:12] = (R @ inverse[:, :3, :3]).reshape(-1, 9)
    return replace(poses, measured=measured)


def _off(setup: Setup, T_base_tip: Array, poses: Rows) -> Array:
    """Return the angle between the measured and the predicted orientation of each view, shape (V,) [rad]."""
    predicted = setup.target_poses(T_base_tip, poses.samples)[:, :3, :3]
    traces = np.sum(predicted * _orientations(poses), axis=(1, 2))
    return np.asarray(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))


def _nearest_ends(
    setup: Setup, T_base_tip: Array, poses: Rows, turns: Mapping[int, _Turns]
) -> Integers:
    """Return the turn of each view with which its board's orientation is nearest to the predicted one, shape (V,)."""
    most = max(len(of_board.orders) for of_board in turns.values())
    off = np.full((most, len(poses)), np.inf)
    for k in range(most):
        turned = {t: of_board for t, of_board in turns.items() if k < len(of_board.orders)}
        rows = np.isin(poses.samples.target, list(turned))
        ends = np.where(rows, k, 0)
        off[k, rows] = _off(setup, T_base_tip, _turned(poses, ends, turned))[rows]
    return np.asarray(np.argmin(off, axis=0))
