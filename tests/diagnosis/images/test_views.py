"""Views of a board: tilts and counts by hand, and what they give to doubt."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.diagnosis.images.views import doubtful_views, spread_of_axes, views_of_fit
from calib.diagnosis.reasons import Why
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from tests.images import BOARD, HOME, arm, cell, mounts, poses, table


def fitted(q, kept=None):
    robot = arm()
    m = table(q, noise=0.1)
    if kept is not None:
        m = m.select(np.array([kept(int(c)) for c in m.corners]))
    rows, setup = rows_and_setup(robot, m, cell())
    return fit(Task(robot, cell(), setup, "frames"), rows)


def codes(f):
    return {reason.why for reason in doubtful_views(f)}


def test_tilt_is_the_angle_between_sight_and_normal():
    q = poses(6)
    T_camera_base, T_tip_board = mounts()
    T = T_camera_base @ arm().poses(q) @ T_tip_board
    middle = T[:, :3, :3] @ BOARD.corners.mean(axis=0) + T[:, :3, 3]
    sight = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    expected = np.arccos(np.abs(np.sum(sight * T[:, :3, 2], axis=1)))
    views = views_of_fit(fitted(q))
    # Views are in the order of their poses' numbers, which is that of the rows.
    np.testing.assert_allclose(views.tilt, expected, atol=0.01)
    np.testing.assert_array_equal(views.corners, len(BOARD.corners))


def test_good_views_are_not_doubted():
    assert codes(fitted(poses(12))) == set()


def test_few_corners_are_counted():
    reasons = list(doubtful_views(fitted(poses(12), kept=lambda corner: corner < 10)))
    few = next(reason for reason in reasons if reason.why is Why.FEW_CORNERS)
    assert (few.values["images"], few.values["all"]) == (12, 12)


def test_a_board_that_is_seen_head_on_is_doubted():
    # Only the last joint turns, about an axis near the line of sight: the tilt stays that at home, 18 deg.
    q = np.repeat(HOME[None], 8, axis=0)
    q[:, 6] += np.linspace(-0.5, 0.5, 8)
    assert Why.ONE_AXIS in codes(fitted(q))


@pytest.mark.parametrize(("second", "expected"), [(0.0, 0.0), (0.4, 0.4)])
def test_spread_of_axes_is_that_of_the_second_axis(second, expected):
    first = np.linspace(-1.0, 1.0, 9)
    vectors = np.zeros((18, 3))
    vectors[:9, 0] = first
    vectors[9:, 1] = second * np.sign(first) * np.sqrt(2.0)
    spread = spread_of_axes(Rotation.from_rotvec(vectors).as_matrix())
    assert spread == pytest.approx(expected * np.sqrt(8 / 9), abs=0.03)
