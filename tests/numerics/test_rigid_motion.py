"""Rigid motions are fitted to displacements of points, and taken off them."""

from __future__ import annotations

import numpy as np
import pytest

from calib.numerics.rigid_motion import best_motion, displacements_by, without_rigid_motion

#: Velocity of the origin, then turn.
MOTION = np.array([1e-3, -2e-3, 3e-3, 4e-3, 5e-3, -6e-3])[:, None]


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(3).uniform(-0.5, 0.5, (20, 3)) + np.array([0.4, 0.0, 0.3])


def test_a_motion_displaces_points_by_v_plus_w_cross_p(points):
    v, w = MOTION[:3, 0], MOTION[3:, 0]
    expected = v + np.cross(w, points)
    np.testing.assert_allclose(displacements_by(MOTION, points)[:, :, 0], expected, atol=1e-15)


def test_the_motion_of_displaced_points_is_found(points):
    motions = np.hstack([MOTION, 2.0 * MOTION])
    np.testing.assert_allclose(
        best_motion(points, displacements_by(motions, points)), motions, atol=1e-12
    )


def test_a_turn_about_the_line_through_all_points_is_none():
    line = np.array([[0.1, 0.0, 0.0], [0.5, 0.0, 0.0], [0.9, 0.0, 0.0]])
    motion = best_motion(line, displacements_by(MOTION, line))
    assert motion[3, 0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(motion[4:, 0], MOTION[4:, 0], atol=1e-12)


def test_other_displacements_remain(points):
    rng = np.random.default_rng(4)
    displacements = rng.normal(size=(20, 3, 2))
    remaining = without_rigid_motion(points, displacements)
    moved = displacements + displacements_by(MOTION, points)
    np.testing.assert_allclose(without_rigid_motion(points, moved), remaining, atol=1e-12)
    # No rigid motion explains any of them.
    np.testing.assert_allclose(best_motion(points, remaining), 0.0, atol=1e-12)


def test_the_motion_may_be_that_of_other_points(points):
    few = points[:5]
    reference = (few, displacements_by(MOTION, few))
    displacements = np.zeros((20, 3, 1))
    found = without_rigid_motion(points, displacements, reference)
    np.testing.assert_allclose(found, -displacements_by(MOTION, points), atol=1e-12)
