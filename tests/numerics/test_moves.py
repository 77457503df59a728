"""The last move of each joint: from where it rested to where it is, in the order in which the rows were measured."""

from __future__ import annotations

import numpy as np

from calib.numerics.moves import SAME_POSE, common_side, last_moves

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


def test_rows_without_values_are_passed_over():
    moves = last_moves(np.insert(VALUES, 2, np.nan)[:, None])[:, 0]
    np.testing.assert_allclose(moves, np.insert(MOVES, 2, 0.0), atol=1e-15)


def test_no_rows_have_no_moves():
    assert last_moves(np.empty((0, 3))).shape == (0, 3)


def test_one_side_is_the_same_sign_of_every_joint_in_all_rows():
    rising = np.full((4, 2), 0.1)
    np.testing.assert_array_equal(common_side(rising * [1.0, -2.0]), [1.0, -1.0])
    # A joint that never moves has no side.
    np.testing.assert_array_equal(common_side(rising * [1.0, 0.0]), [1.0, 0.0])
    assert common_side(0.0 * rising) is None
    assert common_side(rising[:0]) is None
    assert common_side(rising * [[1.0], [1.0], [-1.0], [1.0]]) is None
