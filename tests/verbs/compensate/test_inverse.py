from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize

from calib.basics.units import Length
from calib.errors import ModelError
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import (
    Matching,
    _step_inside,
    by_whole_turns,
    follow,
    solve,
    start_values,
)
from calib.verbs.compensate.nominal_actual import Arm
from tests.verbs.compensate.arms import off, turned

POSE = Matching("pose", 0.01)


def condition(arm: Arm, q: np.ndarray, matching: Matching) -> np.ndarray:
    """The smallest singular value of what is matched, an angle counting as 0.3 m."""
    even = Matching(matching.name, 0.3)
    return np.linalg.svd(even.jacobian(arm.motion(q)[1]), compute_uv=False)[:, -1]


def well(
    arm: Arm, count: int, matching: Matching, seed: int = 3, least: float = 0.02
) -> np.ndarray:
    """Joint values away from singularities."""
    q = random_joint_values(arm.robot, 8 * count, seed)
    return q[condition(arm, q, matching) > least][:count]


@pytest.mark.parametrize("match", ["pose", "position", "axis"])
@pytest.mark.parametrize("name", ["ur3", "panda"])
def test_the_true_robot_arrives_near_the_nominal_joint_values(name, match, request):
    nominal = request.getfixturevalue(name)
    believed, true = Arm.of(nominal, np.eye(4)), Arm.of(off(nominal), np.eye(4))
    matching = Matching(match, 0.01)
    # Away from the limits, where a redundant arm can use all of its joints.
    q = well(believed, 100, matching) * 0.95
    wanted = believed.poses(q)
    before = matching.misses(true.poses(q), wanted)
    found = solve(true, wanted, q, matching, column_limits(nominal))
    after = matching.misses(found.T_base_tool, wanted)
    assert before[:, 0].mean() > 1e-3
    good = condition(true, q, matching) > 0.02
    assert good.sum() > 80
    assert np.nanmax(after[good]) < 1e-12
    assert found.T_base_tool == pytest.approx(true.poses(found.q), abs=1e-15)
    assert np.abs(found.q - q)[good].max() < 0.2


def test_a_redundant_arm_stays_as_near_as_it_can(panda):
    true = Arm.of(off(panda), np.eye(4))
    q = well(Arm.of(panda, np.eye(4)), 6, POSE)
    wanted = Arm.of(panda, np.eye(4)).poses(q)
    found = solve(true, wanted, q, POSE, None)
    for start, near, T in zip(q, found.q, wanted, strict=True):
        nearest = minimize(
            lambda v, start=start: float(((v - start) ** 2).sum()),
            near + 1e-3,
            jac=lambda v, start=start: 2.0 * (v - start),
            constraints={
                "type": "eq",
                "fun": lambda v, T=T: POSE.error(true.poses(v[None]), T[None])[0],
                "jac": lambda v: -POSE.jacobian(true.motion(v[None])[1])[0],
            },
            options={"ftol": 1e-16, "maxiter": 300},
        )
        assert np.linalg.norm(near - start) == pytest.approx(np.sqrt(nearest.fun), rel=1e-3)


@pytest.mark.filterwarnings(
    "ignore:Values in x were outside bounds:RuntimeWarning"
)  # SciPy's, by rounding
@pytest.mark.parametrize("match", ["pose", "axis"])
def test_joints_at_their_limits_are_held_only_as_long_as_they_must_be(panda, match):
    matching = Matching(match, 1.0)
    believed, true = Arm.of(panda, np.eye(4)), Arm.of(off(panda), np.eye(4))
    limits = column_limits(panda)
    q, rng = well(believed, 40, POSE), np.random.default_rng(3)
    for row in q:
        for joint in rng.choice(7, 2, replace=False):
            row[joint] = limits[joint, rng.integers(2)]
    wanted = believed.poses(q)
    found = solve(true, wanted, q, matching, limits)
    assert (found.q >= limits[:, 0] - 1e-11).all()
    assert (found.q <= limits[:, 1] + 1e-11).all()
    reached = np.linalg.norm(matching.error(found.T_base_tool, wanted), axis=1) < 1e-9
    compared = 0
    for k in range(12):
        best = minimize(
            lambda v, k=k: float(((v - q[k]) ** 2).sum()),
            found.q[k] if reached[k] else q[k],
            jac=lambda v, k=k: 2.0 * (v - q[k]),
            bounds=limits,
            constraints={
                "type": "eq",
                "fun": lambda v, k=k: matching.error(true.poses(v[None]), wanted[k][None])[0],
                "jac": lambda v: -matching.jacobian(true.motion(v[None])[1])[0],
            },
            options={"ftol": 1e-14, "maxiter": 200},
        )
        missed = matching.error(true.poses(best.x[None]), wanted[k][None])
        if np.linalg.norm(missed) < 1e-8 and best.fun < np.radians(10.0) ** 2:
            compared += 1
            assert reached[k]
            assert np.linalg.norm(found.q[k] - q[k]) < 1.02 * np.sqrt(best.fun) + 1e-3
    assert compared >= 6


TWIST = st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6).map(np.array)


def pose(twist: np.ndarray) -> np.ndarray:
    return pin.exp6(np.asarray(twist, dtype=float)).homogeneous


def stack(*poses: np.ndarray) -> np.ndarray:
    return np.stack(poses)


@settings(max_examples=25)
@given(TWIST, TWIST)
def test_the_axis_arrives_by_the_least_turn(first, second):
    now, wanted = stack(pose(first)), stack(pose(second))
    error = Matching("axis", 1.0).error(now, wanted)[0]
    R = now[0, :3, :3] @ pin.exp3(np.array([error[3], error[4], 0.0]))
    assert R[:, 2] == pytest.approx(wanted[0, :3, 2], abs=1e-12)
    between = np.arccos(np.clip(now[0, :3, 2] @ wanted[0, :3, 2], -1.0, 1.0))
    assert np.linalg.norm(error[3:]) == pytest.approx(between, abs=1e-7)


def test_misses_are_a_distance_and_the_angle_that_is_matched():
    now, wanted = stack(np.eye(4)), stack(pose([0, 0, 0, 0, 0, 0.3]))
    wanted[:, :3, 3] = 0.0, 0.03, 0.04
    assert Matching("pose", 1.0).misses(now, wanted)[0] == pytest.approx([0.05, 0.3])
    assert Matching("axis", 1.0).misses(now, wanted)[0] == pytest.approx([0.05, 0.0])
    assert np.isnan(Matching("position", 1.0).misses(now, wanted)[0, 1])


START = np.radians([-20.0, -80.0, 60.0, -70.0, -90.0, 10.0])


@pytest.fixture(scope="module")
def arm() -> Arm:
    robot = Robot.load("ur3", base="base", tip="tool0")
    return Arm.of(robot, turned(4, 0.1))


def path(arm: Arm, count: int) -> np.ndarray:
    """A straight line of 190 mm, orientation kept."""
    poses = np.tile(arm.poses(START[None])[0], (count, 1, 1))
    poses[:, :3, 3] += np.linspace(0.0, 1.0, count)[:, None] * [0.1, 0.15, -0.05]
    return poses


def test_a_path_is_followed_in_one_branch(arm):
    wanted = path(arm, 40)
    found = follow(arm, wanted, START, POSE)
    assert found.T_base_tool == pytest.approx(wanted, abs=1e-9)
    assert found.q[0] == pytest.approx(START, abs=1e-9)
    steps = np.abs(np.diff(found.q, axis=0)).max(axis=1)
    assert steps.max() < 3.0 * np.median(steps)


def test_poses_far_from_each_other_are_found_all_the_same(arm):
    q = np.radians(
        [[20, -60, 70, -40, 60, 0], [150, -120, -70, 30, -60, 90], [-90, -20, 90, 0, 120, -100.0]]
    )
    found = follow(arm, arm.poses(q), START, POSE)
    assert found.T_base_tool == pytest.approx(arm.poses(q), abs=1e-8)
    limits = column_limits(arm.robot)
    assert ((found.q >= limits[:, 0]) & (found.q <= limits[:, 1])).all()


def test_the_first_is_the_solution_nearest_to_the_start(arm):
    wanted = arm.poses(START[None])
    other = START + np.radians([0, 0, 0, 0, 0, -360.0])
    assert follow(arm, wanted, other, POSE).q[0] == pytest.approx(other, abs=1e-9)
    # The wrist turned over is another way to hold the same pose.
    flipped = follow(arm, wanted, START * [1, 1, 1, 1, -1, 1] + [0, 0, 0, 0, 0, np.pi], POSE).q[0]
    assert arm.poses(flipped[None]) == pytest.approx(wanted[0][None], abs=1e-8)
    assert np.abs(flipped - START).max() > 1.0
    assert follow(arm, wanted, flipped + 0.05, POSE).q[0] == pytest.approx(flipped, abs=1e-8)


def test_the_start_is_named_or_in_the_middle(arm):
    assert (
        start_values(arm.robot, {"elbow_joint": 0.3}, others=0.1).tolist()
        == [0.1] * 2 + [0.3] + [0.1] * 3
    )
    values = start_values(arm.robot, {"elbow_joint": 0.3})
    assert values[2] == 0.3
    assert values[[0, 1, 3, 4, 5]] == pytest.approx(0.0)
    assert start_values(Robot.load("panda", tip="panda_link8"), None)[3] == pytest.approx(
        -1.5708, abs=0.1
    )


def test_a_start_that_the_chain_does_not_have_is_refused(arm):
    with pytest.raises(ModelError, match=r"no joint 'elbow' to start at"):
        start_values(arm.robot, {"elbow": 0.3})
    with pytest.raises(ModelError, match="'elbow_joint' to start at is a length"):
        start_values(arm.robot, {"elbow_joint": Length(0.3)})


def test_joints_at_a_limit_are_held_if_the_step_pushes_them_through_it():
    limits = np.tile([-1.0, 1.0], (6, 1))
    q = np.array([[1.0, 1.0, -1.0, -1.0, 0.5, 3.0]])
    # Each joint alone moves its own scalar of the error.
    jacobian, undamped = np.eye(6)[None], np.zeros(1)
    error = np.array([[0.1, -0.1, 0.1, -0.1, 0.2, 0.0]])
    dq = _step_inside(jacobian, error, undamped, None, q, limits)
    assert dq[0] == pytest.approx([0.0, -0.1, 0.1, 0.0, 0.2, 0.0])
    # No joint moves farther than 0.3 rad or m in a step, and the direction stays.
    long = _step_inside(jacobian, 10.0 * error, undamped, None, q, limits)
    assert long == pytest.approx(1.5 * dq)


def test_each_row_of_a_solution_is_its_own(arm):
    """Rows that rest early, that are missed and that take longer do not mix, and starts stay as they were."""
    q = START + np.array([[0.0], [0.02], [0.3], [0.1]])
    wanted = arm.poses(q)
    wanted[2, :3, 3] += 5.0
    starts = np.tile(START, (4, 1))
    before = starts.copy()
    found = solve(arm, wanted, starts, POSE)
    np.testing.assert_array_equal(starts, before)
    for i in (0, 1, 3):
        alone = solve(arm, wanted[i : i + 1], starts[i : i + 1], POSE)
        assert found.q[i] == pytest.approx(alone.q[0], abs=1e-12)
        assert found.T_base_tool[i] == pytest.approx(wanted[i], abs=1e-9)
    poses, twists = arm.motion(found.q)
    assert found.T_base_tool == pytest.approx(poses, abs=1e-12)
    assert found.twists == pytest.approx(twists, abs=1e-12)


def test_a_joint_turnsby_whole_turns_to_the_seed_unless_a_limit_is_in_the_way(arm):
    seed = np.full(6, 3.0)
    q = np.array([[-3.0, -3.0, 3.0 - 4.0 * np.pi, 2.0, 9.0, -2.0]])
    allowed = np.tile([-7.0, 7.0], (6, 1))
    allowed[1] = -3.1, 3.1
    turned_over = by_whole_turns(arm.robot, q, seed, allowed)
    wanted = [2.0 * np.pi - 3.0, -3.0, 3.0, 2.0, 9.0 - 2.0 * np.pi, 2.0 * np.pi - 2.0]
    assert turned_over[0] == pytest.approx(wanted)
