"""Touching a board: where the true robot arrives with the joint values, its error, and what is refused."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.example import paper_urdf
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.collision import CollisionCheck, CollisionModel
from calib.verbs.plan.touch import ABOVE, Pointer, TouchPlan, at_lever, bounds, plan_touch
from tests.verbs.compensate.arms import off
from tests.verbs.plan.images.test_plan import (
    EXACT as IMAGE_BOARD,
    cell as image_cell,
    images_of,
    planned,
)
from tests.verbs.plan.images.views import in_hand

BOARD = Board(pattern="chessboard", columns=8, rows=6, square=0.025)

#: The camera beside the flange, and the pointer, along z.
POINTER = Pointer(np.array([[1.0, 0, 0, 0], [0, 1, 0, -0.05], [0, 0, 1, 0.12], [0, 0, 0, 1]]))


def pose(position, turn) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = position
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return T


#: The board lies on the table: its z points down.
T_BASE_BOARD = pose((0.20, 0.15, 0.01), (np.pi, 0.02, 0.01))
T_CAMERA_FLANGE = pose((0.01, 0.05, -0.08), (0.02, -0.01, 0.3))
NOISE = {"m": 5e-5, "rad": 2e-4}


@cache
def robot() -> Robot:
    """A UR3 whose hand looks at its foot."""
    return Robot.load(paper_urdf(), base="tool0", tip="base")


@cache
def true_robot(seed: int) -> Robot:
    return off(robot(), seed, size=0.5)


@cache
def result(seed: int = 0) -> Calibration:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, (60, 6))
    T = T_CAMERA_FLANGE @ true_robot(seed).poses(q) @ T_BASE_BOARD
    noise = Rotation.from_rotvec(rng.normal(size=(60, 3)) * NOISE["rad"]).as_matrix()
    measured = Measurements(
        joint_names=robot().joint_names,
        joints=q,
        points=T[:, :3, 3] + rng.normal(size=(60, 3)) * NOISE["m"],
        rotations=noise @ T[:, :3, :3],
        kinds=("pose",) * 60,
    )
    cell = Cell(
        kind="pose", estimate_frame=True, model="placement", sigma=NOISE, base="tool0", tip="base"
    )
    return calibrate(robot(), measured, cell=cell)


@cache
def touched(seed: int = 0) -> TouchPlan:
    return plan_touch(result(seed), BOARD, POINTER)


def misses(plan: TouchPlan, seed: int, q: np.ndarray) -> np.ndarray:
    """The true corners as seen from the pointer."""
    corners = BOARD.corners[plan.corners]
    in_board = np.linalg.inv(POINTER.T_link_pointer) @ true_robot(seed).poses(q) @ T_BASE_BOARD
    return np.einsum("nij,nj->ni", in_board[:, :3, :3], corners) + in_board[:, :3, 3]


@pytest.mark.slow
def test_the_true_robot_comes_near_the_corners():
    plan = touched()
    assert plan.corners.tolist() == [0, 6, 34, 28, 17]
    assert plan.reached.all()
    missed = np.linalg.norm(misses(plan, 0, plan.touching), axis=1)
    assert missed.max() < 2e-3
    assert (plan.expected > 1e-4).all()
    assert (plan.expected < 3e-3).all()


@pytest.mark.slow
def test_the_pointer_first_stands_above_the_corner():
    plan = touched()
    # From the pointer's tip the corner is straight ahead, but for what the calibration does not know.
    ahead = misses(plan, 0, plan.above)
    np.testing.assert_allclose(ahead, np.tile([0.0, 0.0, ABOVE], (5, 1)), atol=2e-3)
    # And straight along the board's normal: its z axis is that of the pointer.
    T = POINTER.T_link_pointer
    axis = true_robot(0).poses(plan.touching)[:, :3, :3] @ T_BASE_BOARD[:3, 2]
    np.testing.assert_allclose(axis, np.tile(T[:3, 2], (5, 1)), atol=5e-3)
    assert np.abs(plan.above - plan.touching).max() < 0.6
    # In one branch of the arm for all corners.
    assert np.abs(np.diff(plan.touching, axis=0)).max() < 1.5


def test_joint_values_are_within_the_limits_and_the_corners_where_they_were_calibrated():
    plan = touched()
    low, high = column_limits(robot()).T
    for q in (plan.touching, plan.above):
        assert ((q >= low) & (q <= high)).all()
    true = (T_BASE_BOARD @ np.c_[BOARD.corners[plan.corners], np.ones(5)].T).T[:, :3]
    np.testing.assert_allclose(plan.places, true, atol=2e-3)


@pytest.mark.slow
def test_errors_stay_below_what_is_expected():
    below = []
    for seed in range(8):
        plan = touched(seed)
        below += (
            np.linalg.norm(misses(plan, seed, plan.touching), axis=1) < plan.expected
        ).tolist()
    assert np.mean(below) > 0.85


@pytest.mark.slow
def test_collisions_are_looked_for_at_both_poses(monkeypatch):
    check = CollisionCheck(floor=False)
    plan = plan_touch(result(), BOARD, POINTER, np.array([3]), collisions=check)
    assert plan.corners.tolist() == [3]
    assert plan.usable.tolist() == [True]
    # In collision above the corner alone.
    monkeypatch.setattr(CollisionModel, "free", lambda _, q: np.arange(len(q)) % 2 == 0)
    colliding = plan_touch(result(), BOARD, POINTER, np.array([3]), collisions=check)
    assert colliding.reached.tolist() == [True]
    assert colliding.usable.tolist() == [False]


def test_a_board_out_of_reach():
    away = Pointer(np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3.0], [0, 0, 0, 1]]))
    plan = plan_touch(result(), BOARD, away, np.array([0, 3]))
    assert not plan.reached.any()
    assert not plan.usable.any()
    assert np.isnan(plan.expected).all()
    assert np.isnan(plan.touching).all()


def test_a_pointer_on_another_link_of_the_hand():
    model = result()
    fixed = Pointer(POINTER.T_link_pointer, "tool0")
    same = plan_touch(model, BOARD, fixed, np.array([0]))
    np.testing.assert_allclose(same.touching[0], touched().touching[0], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pointer", "corners", "words"),
    [
        (Pointer(np.eye(4), "forearm_link"), None, "moves against 'tool0'"),
        (Pointer(np.eye(4), "nose"), None, "no link 'nose'"),
        (POINTER, np.array([3, 35]), "no corner"),
    ],
)
def test_what_cannot_be_touched_with_is_refused(pointer, corners, words):
    with pytest.raises(ModelError, match=words):
        plan_touch(result(), BOARD, pointer, corners)


def test_a_board_in_the_hand_is_refused(default_result):
    with pytest.raises(ModelError, match="in its own hand"):
        plan_touch(default_result, BOARD, POINTER)


# Covariance


def test_the_covariance_of_a_point_beside_a_pose():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * [1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2]
    lever = np.array([[0.1, -0.2, 0.3]])
    drawn = rng.normal(size=(400_000, 6)) @ root.T
    moved = drawn[:, :3] + np.cross(drawn[:, 3:], lever)
    expected = np.cov(moved.T)
    np.testing.assert_allclose(
        at_lever((root @ root.T)[None], lever)[0], expected, rtol=0.02, atol=0.01 * expected.max()
    )


@pytest.mark.parametrize("sizes", [(1.0, 1.0, 1.0), (1.0, 0.4, 0.1), (1.0, 0.0, 0.0)])
def test_the_bound_holds_for_its_share_of_draws(sizes):
    draws = np.random.default_rng(5).normal(size=(200_000, 3)) * sizes
    limit = bounds(np.diag(np.square(sizes))[None])[0]
    assert np.mean(np.linalg.norm(draws, axis=1) < limit) == pytest.approx(0.95, abs=0.01)


# Images


@pytest.mark.slow
def test_corners_are_touched_after_a_calibration_by_images():
    plan = planned(in_hand, PlanRequest(30, 0, candidates=300, ladder=False))
    below = []
    for seed in range(3):
        table, true, _, T_tip_board = images_of(plan, seed)
        fit = image_cell(base=plan.robot.base, tip=plan.robot.tip)
        calibrated = calibrate(plan.robot, table, cell=fit, validate=False)
        touch = plan_touch(calibrated, IMAGE_BOARD, POINTER)
        assert touch.reached.all()
        in_pointer = (
            np.linalg.inv(POINTER.T_link_pointer) @ true.poses(touch.touching) @ T_tip_board
        )
        corners = np.c_[IMAGE_BOARD.corners[touch.corners], np.ones(len(touch.corners))]
        missed = np.linalg.norm(np.einsum("nij,nj->ni", in_pointer, corners)[:, :3], axis=1)
        below += (missed < touch.expected).tolist()
        assert touch.expected.max() < 5e-3
    assert np.mean(below) > 0.8
