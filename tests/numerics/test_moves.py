"""The last move of each joint: from where it rested to where it is, in the order in which the rows were measured."""

from __future__ import annotations

import numpy as np
import pytest

from calib.numerics.moves import SAME_POSE, last_moves

#: One joint that goes up, stays, stays nearly, goes down, and up again.
VALUES = np.array([0.1, 0.4, 0.4, 0.4 + 0.9 * SAME_POSE, -0.2, 0.3])
MOVES = np.array([0.0, 0.3, 0.3, 0.3, -0.6, 0.5])


def test_a_joint_that_stays_keeps_the_move_by_which_it_came():
    np.testing.assert_allclose(last_moves(VALUES[:, None])[:, 0], MOVES, atol=1e-15)


def test_joints_move_each_for_itself():
    q = np.column_stack([VALUES, -2.0 * VALUES, np.ones(6)])
    expected = np.column_stack([MOVES, -2.0 * MOVES, np.zeros(6)])
    expected[4, 1] = 2.0 * 0.6 + 2.0 * 0.9 * SAME_POSE  # twice as far is a move of its own
    expected[3, 1] = -2.0 * 0.9 * SAME_POSE
    np.testing.assert_allclose(last_moves(q), expected, atol=1e-12)


def test_rows_are_sorted_by_their_order():
    shuffled = np.array([3, 0, 5, 1, 4, 2])
    moves = last_moves(VALUES[shuffled, None], order=10.0 * shuffled)
    np.testing.assert_allclose(moves[:, 0], MOVES[shuffled], atol=1e-15)


@pytest.mark.parametrize("by_order", [False, True])
def test_rows_without_values_or_without_order_are_passed_over(by_order):
    q = np.insert(VALUES, 2, 7.0 if by_order else np.nan)
    order = np.arange(7.0)
    if by_order:
        order[2] = np.nan
    moves = last_moves(q[:, None], order)[:, 0]
    np.testing.assert_allclose(moves, np.insert(MOVES, 2, 0.0), atol=1e-15)


def test_no_rows_have_no_moves():
    assert last_moves(np.empty((0, 3))).shape == (0, 3)
