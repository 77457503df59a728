"""Candidates of images: enough of them, each with the board in view, and fast."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
import pytest

from calib.errors import ModelError
from calib.verbs.plan.candidates import planning_ranges, rounded
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.images.bodies import ImageBodies
from calib.verbs.plan.images.candidates import Wanted, draw_images
from calib.verbs.plan.reaching import reach
from tests.verbs.plan.images.views import BOARD, in_hand, sight, standing

MARGIN = np.radians(5.0)


def drawn(robot, seen, count=40, seed=0, bodies=None):
    ranges = planning_ranges(robot, {}, MARGIN)
    return draw_images(
        robot, seen, ranges, bodies, Wanted(count, seed), partial(reach, robot, ranges)
    )


@pytest.mark.parametrize("where", [in_hand, standing])
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_forty_images_within_ten_seconds(name, where):
    robot, seen = where(name)
    start = time.monotonic()
    pool = drawn(robot, seen)
    assert time.monotonic() - start < 10.0
    assert len(pool.q) == 40
    T = seen.board_poses(robot, pool.q)
    assert seen.in_focus(T).all()
    assert seen.is_facing(T).all()
    assert seen.in_image(T).all()
    low, high = planning_ranges(robot, {}, MARGIN).T
    assert ((pool.q >= low) & (pool.q <= high)).all()
    # The numbers that a table holds.
    np.testing.assert_array_equal(pool.q, rounded(robot, pool.q))
    # A mix of tilts and distances, and corners all over the image.
    assert np.ptp(seen.tilts(T)) > np.radians(30.0)
    assert np.ptp(seen.distances(T)) > 0.3
    u, v = seen.pixels((T[:, None, :3, :3] @ BOARD.corners[:, :, None])[..., 0] + T[:, None, :3, 3])
    cells = set(zip((u // 320).ravel().tolist(), (v // 240).ravel().tolist(), strict=True))
    assert len(cells) >= 14


def test_the_same_seed_draws_the_same_poses():
    robot, seen = in_hand("ur5")
    first, again, other = (drawn(robot, seen, 10, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.q, again.q)
    assert (first.q != other.q).any()
    assert first.drawn == again.drawn


def test_the_workspace_is_spread_over_the_ranges_wherever_the_camera_looks():
    robot, seen = in_hand("ur5")
    pool = drawn(robot, seen, 200)
    assert pool.workspace.shape == (200, 6)
    low, high = planning_ranges(robot, {}, MARGIN).T
    assert np.ptp(pool.workspace, axis=0) == pytest.approx(high - low, rel=0.05)
    assert seen.in_image(seen.board_poses(robot, pool.workspace)).mean() < 0.2


def test_collisions_and_hidden_boards_are_refused():
    robot, seen = in_hand("ur5")
    bodies = ImageBodies.of(robot, seen, (), CollisionCheck())
    pool = drawn(robot, seen, 60, bodies=bodies)
    assert bodies.model.free(pool.q).all()
    assert bodies.view_free(pool.q).all()
    assert list(pool.refused) == ["limits", "focus", "tilt", "image", "beam", "collision"]
    assert pool.refused["beam"] > 0
    assert pool.refused["collision"] > 0
    assert pool.drawn >= 60 + sum(pool.refused.values()) - 512


def test_a_board_that_never_fits_the_image():
    robot, _ = in_hand("ur5")
    with pytest.raises(ModelError, match="never in the image"):
        drawn(robot, sight(nearest=0.05, farthest=0.06))


@pytest.mark.slow
def test_a_board_out_of_reach():
    robot, seen = in_hand("ur5")
    far = sight(seen.T_frame_base, seen.T_tip_board, nearest=9.0, farthest=9.5)
    with pytest.raises(ModelError, match=r"move the board or the camera.*180 deg about x"):
        drawn(robot, far, 1)
