"""Candidates of images: enough of them, each with the board in view, and fast."""

from __future__ import annotations

import time

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import ModelError
from calib.instruments.camera import board_tilts
from calib.robot.ranges import random_joint_values
from calib.verbs.plan.bodies import collision_model, free_lines_of_sight
from calib.verbs.plan.candidates import Pool, draw_towards, planning_ranges, reach, rounded
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.sensitivity import Sensitivity
from tests.instruments.scenes import (
    BOARD,
    CAMERA,
    at_places,
    camera_of,
    in_hand,
    standing,
)

MARGIN = np.radians(5.0)


def drawn(sightline, count=40, seed=0, camera=None, further=()) -> Pool:
    camera = camera_of() if camera is None else camera
    ranges = planning_ranges(sightline.robot, {}, MARGIN)
    conditions = [*camera.sees([sightline]), *further]
    return draw_towards(camera, sightline, ranges, conditions, count, seed)


@pytest.mark.parametrize("where", [in_hand, standing])
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_forty_images_within_ten_seconds(name, where):
    sightline, camera = where(name), camera_of()
    robot = sightline.robot
    start = time.monotonic()
    pool = drawn(sightline)
    assert time.monotonic() - start < 10.0
    assert len(pool.q) == 40
    T = sightline.target_poses(pool.q)
    assert camera.in_focus(T).all()
    assert camera.is_facing(T).all()
    assert camera.in_image(T).all()
    low, high = planning_ranges(robot, {}, MARGIN).T
    assert ((pool.q >= low) & (pool.q <= high)).all()
    # The numbers that a table holds.
    np.testing.assert_array_equal(pool.q, rounded(robot, pool.q))
    # A mix of tilts and distances, and corners all over the image.
    assert np.ptp(board_tilts(camera.board, T)) > np.radians(30.0)
    assert np.ptp(camera.board_distances(T)) > 0.3
    corners = (T[:, None, :3, :3] @ BOARD.corners[:, :, None])[..., 0] + T[:, None, :3, 3]
    u, v = camera.project(corners)
    cells = set(zip((u // 320).ravel().tolist(), (v // 240).ravel().tolist(), strict=True))
    assert len(cells) >= 14


def test_the_same_seed_draws_the_same_poses():
    first, again, other = (drawn(in_hand("ur5"), 10, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.q, again.q)
    assert (first.q != other.q).any()
    assert first.drawn == again.drawn


def test_the_workspace_is_spread_over_the_ranges_wherever_the_camera_looks():
    sightline = in_hand("ur5")
    pool = drawn(sightline, 200)
    assert pool.workspace.shape == (200, 6)
    assert pool.measurable is pool.q
    low, high = planning_ranges(sightline.robot, {}, MARGIN).T
    assert np.ptp(pool.workspace, axis=0) == pytest.approx(high - low, rel=0.05)
    assert camera_of().in_image(sightline.target_poses(pool.workspace)).mean() < 0.2


def test_collisions_and_hidden_boards_are_refused():
    sightline = in_hand("ur5")
    cell = Cell(cameras={"": CAMERA}, boards={"": BOARD}, model="zeros")
    placed = at_places(cell, sightline.T_instrument_base, sightline.T_tip_target)
    sensitivity = Sensitivity.of(sightline.robot, placed)
    model = collision_model(sensitivity.instrument, sensitivity, CollisionCheck())
    lines = list(free_lines_of_sight(sensitivity, model))
    collision = lines[0]._replace(reason="collision", passes=model.free)
    pool = drawn(sightline, 60, further=[*lines, collision])
    assert model.free(pool.q).all()
    assert all(line.passes(pool.q).all() for line in lines)
    assert list(pool.refused) == ["limits", "focus", "tilt", "image", "beam", "collision"]
    assert pool.refused["beam"] > 0
    assert pool.refused["collision"] > 0
    assert pool.drawn >= 60 + sum(pool.refused.values()) - 512


@pytest.mark.slow
def test_a_board_out_of_reach():
    far = camera_of(distances=(9.0, 9.5))
    with pytest.raises(ModelError, match=r"move the board or the camera.*180 deg about x"):
        drawn(in_hand("ur5"), 1, camera=far)


# Reaching poses roughly


def test_near_poses_are_reached_within_the_ranges(ur3, panda):
    for robot in (ur3, panda):
        ranges = planning_ranges(robot, {}, 0.1)
        low, high = ranges.T
        q = np.clip(random_joint_values(robot, 60), low + 0.3, high - 0.3)
        wanted = robot.poses(q)
        start = q + np.random.default_rng(2).uniform(-0.15, 0.15, q.shape)
        reached = reach(robot, ranges, wanted, start)
        away = np.linalg.norm(robot.poses(reached)[:, :3, 3] - wanted[:, :3, 3], axis=1)
        assert np.median(away) < 1e-6
        assert np.mean(away < 1e-3) > 0.8


def test_a_redundant_arm_keeps_to_the_ranges(panda):
    ranges = planning_ranges(panda, {}, 0.1)
    q = random_joint_values(panda, 40)
    reached = reach(panda, ranges, panda.poses(q[::-1].copy()), np.clip(q, *ranges.T))
    assert (reached >= ranges[:, 0] - 1e-9).all()
    assert (reached <= ranges[:, 1] + 1e-9).all()


def test_a_pose_out_of_reach_is_approached(ur3):
    T = np.tile(np.eye(4), (1, 1, 1))
    T[0, :3, 3] = 3.0, 0.0, 0.2
    start = np.full((1, 6), 0.3)
    ranges = planning_ranges(ur3, {}, 0.1)
    before = np.linalg.norm(ur3.poses(start)[0, :3, 3] - T[0, :3, 3])
    after = np.linalg.norm(ur3.poses(reach(ur3, ranges, T, start))[0, :3, 3] - T[0, :3, 3])
    assert after < before
