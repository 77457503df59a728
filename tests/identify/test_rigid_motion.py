"""What is left of moves without their best rigid motion, against least squares."""

from __future__ import annotations

import numpy as np

from calib.identify.prediction import best_motion, moved_by, without_rigid_motion


def test_what_is_left_is_the_least_that_a_rigid_motion_leaves():
    rng = np.random.default_rng(5)
    points, moves = rng.normal(1.0, 2.0, size=(15, 3)), rng.normal(size=(15, 3, 4))
    left = without_rigid_motion(points, moves)
    columns = [np.tile(e, (15, 1)) for e in np.eye(3)] + [np.cross(e, points) for e in np.eye(3)]
    motions = np.stack([c.ravel() for c in columns], axis=1)
    for k in range(4):
        move = moves[:, :, k].ravel()
        best = np.linalg.lstsq(motions, move, rcond=None)[0]
        np.testing.assert_allclose(left[:, :, k].ravel(), move - motions @ best, atol=1e-12)
        np.testing.assert_allclose(best_motion(points, moves)[:, k], best, atol=1e-12)
    np.testing.assert_allclose(without_rigid_motion(points, left), left, atol=1e-12)


def test_what_is_left_at_one_point_does_not_depend_on_the_others_that_are_asked():
    rng = np.random.default_rng(5)
    seen, asked = rng.normal(size=(20, 3)), rng.normal(size=(7, 3))
    shift, turn = rng.normal(size=3), rng.normal(size=3)
    of_seen = (shift + np.cross(turn, seen) + 1e-3 * rng.normal(size=(20, 3)))[:, :, None]
    of_asked = (shift + np.cross(turn, asked) + 0.1)[:, :, None]
    left = without_rigid_motion(asked, of_asked, (seen, of_seen))
    assert np.abs(left - 0.1).max() < 5e-3
    alone = without_rigid_motion(asked[[3]], of_asked[[3]], (seen, of_seen))
    np.testing.assert_allclose(alone, left[[3]], atol=1e-13)


def test_points_on_a_line_keep_what_no_rigid_motion_does():
    """A stretch of the line is none; a turn about it cannot be told and is left alone."""
    line = np.outer([0.0, 1.0], [0.3, 0.4, 0.0])
    stretch = (line - line.mean(axis=0))[:, :, None]
    np.testing.assert_allclose(without_rigid_motion(line, stretch), stretch, atol=1e-14)
    off = np.array([[0.0, 0.0, 1.0]])
    turned = np.cross([0.6, 0.8, 0.0], off)[:, :, None]
    np.testing.assert_allclose(
        without_rigid_motion(off, turned, (line, np.zeros((2, 3, 1)))), turned
    )


def test_a_motion_moves_points_as_a_body():
    motion = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 2.0]]).T
    moved = moved_by(motion, np.array([[0.0, 3.0, 0.0]]))
    np.testing.assert_allclose(moved[0, :, 0], [-5.0, 0.0, 0.0])
