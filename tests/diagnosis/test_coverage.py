"""What a result rests on: rows outside of the measured poses, corners of workspaces, and views of boards."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import robot_of_cell
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import (
    Views,
    doubtful_views,
    extrapolation,
    hardly_moved,
    outside,
    partial_coverage,
    sole_postures,
    spread_of,
    spread_of_axes,
)
from calib.diagnosis.reasons import Why
from calib.example import paper_measurements
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.ranges import random_joint_values, spread_poses
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.verbs.simulate.truth import draw_truth
from tests.hard_cases import made
from tests.images import BOARD, BODY, HOME, arm, cell, mounts, poses, table

TYPES = ("revolute",) * 6


def drawn(robot: Robot, count: int, seed: int) -> np.ndarray:
    """Joint values all over the limits."""
    return np.random.default_rng(seed).uniform(*limits(robot).T, (count, len(robot.joint_names)))


def limits(robot: Robot) -> np.ndarray:
    return np.array([(max(j.lower, -np.pi), min(j.upper, np.pi)) for j in robot.joints])


def tips(robot: Robot, q: np.ndarray) -> np.ndarray:
    return robot.poses(q)[:, :3, 3]


def spread(robot: Robot, q: np.ndarray) -> float:
    return spread_of(tips(robot, q), tips(robot, drawn(robot, 2000, 0)))


@pytest.fixture(scope="module")
def paper_joints(ur3):
    table = Measurements.read(paper_measurements(), ur3.joint_names, ur3.joint_types)
    return table.joints_for(ur3.joint_names)


def test_the_paper_s_last_rows_lie_outside(ur3, paper_joints):
    """Rows 34 and 35 ask for joint values far from those of rows 1 to 30."""
    found = outside(paper_joints[:30], paper_joints[30:], ur3.joint_names, TYPES)
    numbers = np.arange(31, 36)
    rows = [int(numbers[row.index]) for row in found]
    assert {34, 35} <= set(rows)
    for row in found:
        asked = paper_joints[30 + row.index]
        for b in row.beyond:
            j = ur3.joint_names.index(b.joint)
            low, high = paper_joints[:30, j].min(), paper_joints[:30, j].max()
            assert b.by == pytest.approx(max(low - asked[j], asked[j] - high))
            assert b.by > 0.05 * (high - low)


def test_a_margin_of_a_twentieth_is_allowed():
    measured = np.array([[0.0, 0.0], [1.0, 2.0]])
    asked = np.array([[1.049, 2.09], [1.051, -0.09], [0.5, 2.11], [-0.2, -0.3]])
    found = outside(measured, asked, ("a", "b"), ("revolute", "prismatic"))
    assert [row.index for row in found] == [1, 2, 3]
    assert found[0].beyond[0].by == pytest.approx(0.051)
    # The worst in shares of its range comes first.
    assert [b.joint for b in found[2].beyond] == ["a", "b"]


def test_continuous_joints_are_measured_on_a_circle():
    measured = np.radians([[170.0], [-175.0], [150.0], [-160.0]])
    asked = np.radians([[185.0], [-180.0], [540.0], [140.0], [-100.0], [260.0]])
    found = outside(measured, asked, ("a",), ("continuous",))
    assert [row.index for row in found] == [3, 4, 5]
    np.testing.assert_allclose([np.degrees(r.beyond[0].by) for r in found], [10, 60, 60])
    # The same values of a joint with limits are far apart.
    assert [row.index for row in outside(measured, asked[:3], ("a",), ("revolute",))] == [2]


def test_the_paper_s_poses_are_no_corner(ur3, paper_joints):
    assert 0.38 < spread(ur3, paper_joints[:30]) < 0.5


def test_a_joint_hardly_moved_below_a_third_of_a_radian_or_five_centimetres():
    """Three joints slide, the fourth turns: spans in metres and radians."""
    result = made("prismatic")
    rows = result.fit.geometry.estimate.problem.rows

    def still(*spans: float) -> list[bool]:
        q = np.linspace(0.0, 1.0, len(rows))[:, None] * spans
        moved = replace(rows, samples=replace(rows.samples, q=q))
        return hardly_moved(result.nominal, moved).tolist()

    assert still(0.045, 0.055, 0.3, 0.3) == [True, False, False, True]
    assert still(0.3, 0.3, 0.045, 0.4) == [False, False, True, False]


def test_joints_that_used_little_of_their_ranges_are_named_the_narrowest_first(ur3):
    """Of the UR3 a range is a whole turn: here a fifth and an eighth of one, all of the others."""
    ways = np.where(np.arange(6) == 1, 0.2, np.where(np.arange(6) == 4, 0.125, 1.0))
    q = ways * np.linspace(-np.pi, np.pi, 20)[:, None]
    q[:, 0] = np.random.default_rng(1).permutation(q[:, 0])
    rows, setup = rows_and_setup(ur3, Measurements(ur3.joint_names, q, tips(ur3, q)), Cell())
    (reason,) = partial_coverage(fit(Task(ur3, Cell(), setup, "frames"), rows))
    assert reason.values["joints"] == [ur3.joint_names[4], ur3.joint_names[1]]
    assert reason.values["shares"] == pytest.approx([0.125, 0.2])
    assert reason.values["lows"] == pytest.approx([-0.125 * np.pi, -0.2 * np.pi])
    assert reason.values["highs"] == pytest.approx([0.125 * np.pi, 0.2 * np.pi])
    assert reason.values["slides"] == [False, False]


# Views of boards


def fitted(q, kept=None, board=BOARD):
    robot = arm()
    m = table(q, board=board, noise=0.1)
    if kept is not None:
        m = m.select(np.array([kept(int(c)) for c in m.corners]))
    c = cell(boards={"": board})
    rows, setup = rows_and_setup(robot, m, c)
    return fit(Task(robot, c, setup, "frames"), rows)


def codes(f):
    return {reason.why for reason in doubtful_views(f)}


def test_tilt_is_the_angle_between_sight_and_normal():
    q = poses(6)
    T_camera_base, T_tip_board = mounts()
    T = T_camera_base @ arm().poses(q) @ T_tip_board
    middle = T[:, :3, :3] @ BOARD.corners.mean(axis=0) + T[:, :3, 3]
    sight = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    expected = np.arccos(np.abs(np.sum(sight * T[:, :3, 2], axis=1)))
    views = Views.of(fitted(q))
    # Views are in the order of their poses' numbers, which is that of the rows.
    np.testing.assert_allclose(views.tilt, expected, atol=0.01)
    np.testing.assert_array_equal(views.corners, len(BOARD.corners))


def test_a_body_is_never_seen_head_on():
    np.testing.assert_allclose(Views.of(fitted(poses(4), board=BODY)).tilt, 0.5 * np.pi)


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


# Extrapolated errors: those of noise are as the covariance says, those that a model lacks are larger


def extrapolated(scene: Any, table: Measurements) -> float:
    cell = Cell(model="dh")
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return extrapolation(fit(Task(scene.robot, cell, setup, "dh"), rows))


def test_noise_is_extrapolated_as_the_covariance_says(make_scene):
    """Of one table by chance within a few tenths; on the mean of several it is 1, but for being no less than that."""
    factors = []
    for seed in range(8):
        scene = make_scene(seed, length=3e-4, angle=3e-3, noise=1e-4, frames=[np.eye(4)])
        factors.append(extrapolated(scene, scene.points(40)))
    assert min(factors) >= 1.0
    # Errors of rows that are themselves in a fit would be below their noise, and all factors 1.
    assert max(factors) > 1.2
    assert np.mean(factors) < 1.35


def test_what_a_model_lacks_does_not_average_out(make_scene):
    """Errors of gears that the geometry cannot have: of many rows the covariance knows next to nothing of them."""
    scene = make_scene(
        1,
        model="dh+gain",
        length=3e-4,
        angle=3e-3,
        noise=2e-5,
        frames=[np.eye(4)],
        other={"gain": 1e-3},
    )
    table = scene.points(400)
    few, many = (extrapolated(scene, table.select(np.arange(400) < n)) for n in (40, 400))
    assert many > max(2.0 * few, 5.0)


# Poses that alone determine a direction

ROWS, ROW, WRIST = 36, 20, 4


def one_moves(robot: Robot, seed: int = 5) -> np.ndarray:
    """Poses of which one alone moves a wrist joint."""
    q = random_joint_values(robot, ROWS, seed)
    q[:, WRIST] = 0.3
    q[ROW, WRIST] = 1.5
    return q


def points_at(robot: Robot, q: np.ndarray, off: float = 0.0) -> Measurements:
    points = draw_truth(robot, "dh", seed=3).points(q)
    points = points + 5e-5 * np.random.default_rng(0).normal(size=points.shape)
    points[ROW] += off
    return Measurements(robot.joint_names, q, points)


def named(table: Measurements, robot: Robot, given: Cell | None = None) -> list[dict[str, Any]]:
    """Values of the reasons, of rows that are numbered from 101."""
    given = Cell() if given is None else given
    rows, setup = rows_and_setup(robot, table, given)
    found = fit(Task(robot, given, setup, "dh"), rows)
    reasons = list(sole_postures(found, np.arange(101, 101 + len(rows))))
    assert all(reason.why is Why.SOLE_POSTURE for reason in reasons)
    return [dict(reason.values) for reason in reasons]


@pytest.mark.parametrize("off", [0.0, 10e-3])
def test_the_pose_that_alone_moves_a_joint_is_named(ur3, off: float):
    """Right or wrong, which no other row can tell."""
    expected = [{"rows": [101 + ROW], "joints": [ur3.joint_names[WRIST]]}]
    assert named(points_at(ur3, one_moves(ur3), off), ur3) == expected


def test_the_picture_of_the_pose_is_named_if_there_is_one(ur3):
    table, given = points_at(ur3, one_moves(ur3)), Cell()
    rows, setup = rows_and_setup(ur3, table, given)
    found = fit(Task(ur3, given, setup, "dh"), rows)
    images = [f"{k}.png" for k in range(len(rows))]
    (reason,) = sole_postures(found, np.arange(len(rows)), images)
    assert reason.values["pictures"] == [f"{ROW}.png"]


def test_it_keeps_its_weight_if_it_is_right(ur3):
    table = points_at(ur3, one_moves(ur3))
    rows, setup = rows_and_setup(ur3, table, Cell())
    assert fit(Task(ur3, Cell(), setup, "dh"), rows).estimate.weights[ROW] == 1.0


def test_two_poses_that_move_it_leave_a_direction_to_each_and_four_do_not(ur3):
    q = one_moves(ur3)
    q[3, WRIST] = -1.0
    assert [values["rows"] for values in named(points_at(ur3, q), ur3)] == [[104, 101 + ROW]]
    q[8, WRIST], q[30, WRIST] = 0.8, -0.6
    assert named(points_at(ur3, q), ur3) == []


def test_repeats_of_a_pose_are_one_pose(ur3):
    q = one_moves(ur3)
    q[3] = q[ROW]
    assert [values["rows"] for values in named(points_at(ur3, q), ur3)] == [[104]]


@pytest.mark.parametrize("count", [ROWS, 24, 12, 8])
def test_no_pose_is_named_among_random_ones(ur3, count: int):
    table = points_at(ur3, random_joint_values(ur3, ROWS, 9))
    assert named(table.select(np.arange(ROWS) >= ROWS - count), ur3) == []


def test_a_frame_that_one_pose_sees_concerns_no_joint(make_scene, join):
    scene = make_scene(3, frames=2, noise=5e-5)
    seen = join(scene.points(30, 0), scene.points(3, 1))
    assert named(seen, scene.robot, Cell(estimate_frame=True)) == []


@pytest.mark.parametrize("mount", ["known", "estimate"])
def test_hands_that_see_each_other_are_judged_by_the_way_of_each(mount):
    """The left hand hardly moves: not the pose of one hand in the other counts, in which the right one moves much."""
    place = np.eye(4)
    place[0, 3] = 1.0
    cell = Cell(
        bases={"held": "panda_link8"},
        tips={"right": "right/panda_link8"},
        robots={"right": FurtherRobot("panda", T_root_base=place, estimated=mount == "estimate")},
        estimate_frame=True,
    )
    robot = robot_of_cell(read_urdf("panda"), cell)
    q = random_joint_values(robot, 20, 1)
    rng = np.random.default_rng(2)
    is_left = np.array([not name.startswith("right/") for name in robot.joint_names])
    q[:, is_left] = q[0, is_left] + 0.02 * rng.standard_normal((20, 7))
    points = robot.poses(q)[:, :3, 3] + 1e-4 * rng.standard_normal((20, 3))
    measured = Measurements(
        robot.joint_names, q, points, groups=("held",) * 20, targets=("right",) * 20
    )
    rows, setup = rows_and_setup(robot, measured, cell)
    (reason,) = partial_coverage(fit(Task(robot, cell, setup, "frames"), rows))
    left = robot.rebuilt(None, "panda_link0", "panda_link8")
    columns = [robot.joint_names.index(name) for name in left.joint_names]
    possible = left.poses(spread_poses(robot)[:, columns])[:, :3, 3]
    expected = spread_of(left.poses(q[:, columns])[:, :3, 3], possible)
    assert reason.values["spread"] == pytest.approx(expected)
    assert expected < 0.1
