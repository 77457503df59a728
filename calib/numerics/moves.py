"""The last move of each joint before a row: what a joint with lost motion, or one that creeps, depends on."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array

#: A joint that moves by no more than this has stayed [rad or m]: repeats of a pose differ by as much.
SAME_POSE = 1e-3


def last_moves(joints: ArrayLike) -> Array:
    """Return the last move of each joint before each of N rows.

        move_i = q_i - q_rest,    q_rest: where the joint came to rest before row i

    A joint that stays, within `SAME_POSE`, keeps the move by which it came: repeats of a pose have that of the first of
    them.

    Args:
        joints: Shape (N, m), joint values [rad] or [m], in the order in which the robot took them; rows with a NaN are
            passed over.

    Returns:
        Shape (N, m), [rad] or [m]; 0 before the first move that is known, and in rows that are passed over.
    """
    values = np.atleast_2d(np.asarray(joints, dtype=np.float64))
    moves = np.zeros(values.shape)
    rows = np.flatnonzero(np.all(np.isfinite(values), axis=1))
    for k in range(values.shape[1]):
        moves[rows, k] = _moves_of_joint(values[rows, k].tolist())
    return moves


def common_side(moves: Array) -> Array | None:
    """Return the side from which each joint arrived, if it was the same at all rows.

    Args:
        moves: Last move of each joint before each row, shape (N, m), [rad] or [m]; 0: not known, which is a side of its
            own.

    Returns:
        The signs of the moves, shape (m,); None if they differ between rows, or no row, or no move, is known.
    """
    signs = np.sign(moves)
    is_same = len(signs) and signs[0].any() and np.all(signs == signs[0])
    return np.asarray(signs[0]) if is_same else None


def _moves_of_joint(values: list[float]) -> list[float]:
    """Return the last move before each value of one joint, in the order in which it took them."""
    rest = values[0] if values else 0.0
    move = 0.0
    moves = []
    for value in values:
        if abs(value - rest) > SAME_POSE:
            move = value - rest
            rest = value
        moves.append(move)
    return moves
