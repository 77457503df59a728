"""Candidates: within ranges and conditions, the same for a seed; and towards viewpoints, enough of them and fast."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import CalibError, ModelError
from calib.instruments.camera import board_tilts
from calib.instruments.instrument import Condition
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.plan.bodies import collision_model, free_lines_of_sight
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.pose_candidates import (
    Pool,
    draw,
    draw_towards,
    planning_ranges,
    reach,
    rounded,
)
from calib.verbs.plan.sensitivity import Sensitivity
from tests.instruments.scenes import (
    BOARD,
    CAMERA,
    at_places,
    camera_of,
    in_hand,
    standing,
)

DEG = math.pi / 180.0


@pytest.fixture(scope="module")
def mixed(serial_urdf) -> Robot:
    """A turning, a sliding and an endless joint, the limits of the first two at 3."""
    kinds = ("revolute", "prismatic", "continuous")
    axes = ((0, 0, 1), (0, 1, 0), (1, 0, 0))
    joints = [(k, (0, 0, 0.2), (0, 0, 0), a) for k, a in zip(kinds, axes, strict=True)]
    return Robot.from_urdf(serial_urdf(joints))


# Ranges


def test_ranges_keep_the_margin_to_the_urdfs_limits(mixed):
    ranges = planning_ranges(mixed, {}, 5 * DEG)
    np.testing.assert_allclose(ranges[0], [-3 + 5 * DEG, 3 - 5 * DEG])
    # A sliding joint keeps 5 mm, if any.
    np.testing.assert_allclose(ranges[1], [-2.995, 2.995])
    np.testing.assert_allclose(planning_ranges(mixed, {}, 0.0)[1], [-3.0, 3.0])
    # A turn, where there are no limits.
    np.testing.assert_allclose(ranges[2], [-math.pi, math.pi])
    assert not ranges.flags.writeable


@pytest.mark.parametrize(
    ("given", "margin", "words"),
    [
        ({}, math.pi, "leaves nothing of the range of 'j1'"),
        ({"j2": (2.996, 3.0)}, 5 * DEG, "leaves nothing of the range of 'j2'"),
    ],
)
def test_ranges_of_which_nothing_is_left_are_refused(mixed, given, margin, words):
    with pytest.raises(CalibError, match=words):
        planning_ranges(mixed, given, margin)


# Drawing


def test_candidates_fill_their_ranges_and_stay_inside(mixed):
    ranges = planning_ranges(mixed, {"j2": (0.0123456, 0.3)}, 5 * DEG)
    q = draw(mixed, ranges, [], 3000, 0).q
    assert q.shape == (3000, 3)
    low, high = ranges.T
    assert (q >= low - 1e-12).all()
    assert (q <= high + 1e-12).all()
    assert (q.min(axis=0) < low + 0.01 * (high - low)).all()
    assert (q.max(axis=0) > high - 0.01 * (high - low)).all()
    # Evenly: each tenth of each range has a tenth of them.
    for k in range(3):
        counts = np.histogram(q[:, k], bins=10, range=ranges[k])[0]
        assert abs(counts - 300).max() < 15


# Conditions


def beyond(column: int, value: float):
    return lambda q: q[:, column] > value


def test_conditions_are_asked_in_order_and_count_what_they_refuse(ur3):
    tests = [
        Condition("tracker_range", beyond(0, 0.0)),
        Condition("reflector_cone", beyond(1, 1.0)),
        Condition("beam", beyond(2, -9.0)),
    ]
    pool = draw(ur3, planning_ranges(ur3, {}, 0.0), tests, 2000, 0)
    assert (pool.q[:, :2] > [0.0, 1.0]).all()
    assert len(pool.q) == 2000
    assert list(pool.refused) == ["tracker_range", "reflector_cone", "beam"]
    assert pool.refused["tracker_range"] == pytest.approx(pool.drawn / 2, rel=0.01)
    assert pool.refused["beam"] == 0
    assert 2000 <= pool.drawn - sum(pool.refused.values()) < 2000 + 4096


def test_the_workspace_has_what_passed_the_tests_of_where(ur3):
    tests = [
        Condition("region", lambda q: (q[:, 0] > 0.0) & (q[:, 1] > 0.0)),
        Condition("beam", beyond(2, 0.0)),
    ]
    ranges = planning_ranges(ur3, {}, 0.0)
    pool = draw(ur3, ranges, tests, 1000, 0)
    assert (pool.workspace[:, :2] > 0.0).all()
    assert 0.4 < np.mean(pool.workspace[:, 2] > 0.0) < 0.6
    assert (pool.q > [0, 0, 0, -9, -9, -9]).all()
    everywhere = draw(ur3, ranges, tests[1:], 1000, 0)
    assert np.mean(everywhere.workspace > 0.0) == pytest.approx(0.5, abs=0.01)
    only = draw(ur3, ranges, tests[:1], 1000, 0)
    assert np.array_equal(only.workspace, only.q)
    free = draw(ur3, ranges, [], 1000, 0)
    assert np.array_equal(free.workspace, free.q)


def test_nothing_left_names_the_reasons(ur3):
    tests = [
        Condition("region", beyond(0, 0.0)),
        Condition("collision", lambda q: np.zeros(len(q), dtype=bool)),
    ]
    with pytest.raises(ModelError, match=r"^None of (\d+) .*: \d+ by region, \d+ by collision\."):
        draw(ur3, planning_ranges(ur3, {}, 0.0), tests, 10, 0)


# Coupled readings


@pytest.mark.parametrize("factor", [1.0, -1.0, 0.37])
def test_candidates_of_coupled_readings_keep_the_joints_in_their_ranges(mixed, factor):
    robot = Robot.from_urdf(
        mixed.urdf, mixed.base, mixed.tip, coupling={"j3": {"j1": factor}, "j2": {"j1": 0.1}}
    )
    ranges = planning_ranges(robot, {"j2": (0.0123456, 0.3)}, 0.0)
    np.testing.assert_array_equal(ranges, planning_ranges(mixed, {"j2": (0.0123456, 0.3)}, 0.0))
    q = draw(robot, ranges, [], 3000, 0).q
    low, high = ranges.T
    values = q.copy()
    values[:, 1] += 0.1 * q[:, 0]
    values[:, 2] += factor * q[:, 0]
    assert (values >= low).all()
    assert (values <= high).all()
    assert (np.ptp(values, axis=0) > 0.99 * (high - low)).all()
    # The readings are what a table writes, whole steps of 0.001 deg and 0.001 mm.
    steps = q / np.array([DEG, 1e-3, DEG]) * 1000.0
    np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=1e-6)


def test_a_range_narrower_than_the_rounding_is_kept_in_its_middle(mixed):
    robot = Robot.from_urdf(mixed.urdf, mixed.base, mixed.tip, coupling={"j3": {"j1": 1.0}})
    ranges = planning_ranges(robot, {"j3": (0.1, 0.1 + 1e-7)}, 0.0)
    q = draw(robot, ranges, [], 100, 0).q
    np.testing.assert_allclose(q[:, 2] + q[:, 0], 0.1, rtol=0, atol=1.01e-3 * DEG)


# Towards viewpoints


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
