from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from calib.compensate.inverse import Matching, solve
from calib.compensate.nominal_actual import Arm
from calib.measure.ranges import column_limits
from calib.model.readback import random_joint_values
from calib.model.robot import Robot
from tests.compensate.arms import off

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


@pytest.mark.parametrize("match", ["pose", "position", "axis", "weighted"])
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


def test_a_redundant_arm_keeps_to_its_limits(panda):
    true = Arm.of(off(panda), np.eye(4))
    q = well(Arm.of(panda, np.eye(4)), 60, POSE)
    q[:, 0] = 1.0
    wanted = Arm.of(panda, np.eye(4)).poses(q)
    free = solve(true, wanted, q, POSE, None).q
    # A limit that half of the free solutions pass.
    limits = np.stack([q.min(axis=0) - 1.0, q.max(axis=0) + 1.0], axis=1)
    limits[0] = 0.0, 1.0
    found = solve(true, wanted, q, POSE, limits)
    reached = POSE.misses(found.T_base_tool, wanted).max(axis=1) < 1e-9
    assert (free[:, 0] > 1.0).sum() >= 15
    assert found.q[:, 0].max() <= 1.0 + 1e-12
    # Without its first joint the arm is one of six, which has singularities of its own.
    six = Matching("pose", 0.3).jacobian(true.motion(q)[1])[:, :, 1:]
    assert reached[np.linalg.svd(six, compute_uv=False)[:, -1] > 0.01].all()
    assert reached.mean() > 0.8
    # Those that had room stay where they would be without limits.
    inside = reached & (free[:, 0] < 1.0)
    assert inside.sum() > 1
    assert found.q[inside] == pytest.approx(free[inside], abs=1e-6)


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


def test_an_arm_that_needs_all_its_joints_says_where_they_would_be(ur3):
    true = Arm.of(off(ur3), np.eye(4))
    q = well(Arm.of(ur3, np.eye(4)), 20, POSE)
    wanted = Arm.of(ur3, np.eye(4)).poses(q)
    free = solve(true, wanted, q, POSE, None).q
    narrow = np.stack([q.min(axis=0), q.min(axis=0) + 1e-3], axis=1)
    assert solve(true, wanted, q, POSE, narrow).q == pytest.approx(free, abs=0)


def test_what_cannot_be_reached_is_as_near_as_can_be(ur3):
    arm = Arm.of(ur3, np.eye(4))
    q = np.radians([[10.0, -40.0, 30.0, -60.0, 50.0, 20.0]])
    wanted = arm.poses(q)
    wanted[0, :3, 3] *= 5.0
    matching = Matching("position", 0.01)
    found = solve(arm, wanted, q, matching, None)
    gradient = np.einsum(
        "nij,ni->nj",
        matching.jacobian(found.twists),
        matching.error(found.T_base_tool, wanted),
    )
    distance = np.linalg.norm(wanted[0, :3, 3] - found.T_base_tool[0, :3, 3])
    assert distance > 0.5
    assert np.abs(gradient).max() < 1e-3 * distance


def test_few_joints_weigh_position_against_angle(serial_urdf):
    four = Robot.from_urdf(
        serial_urdf(
            [
                ("revolute", (0, 0, 0.3), (0, 0, 0), (0, 0, 1)),
                ("revolute", (0.25, 0, 0), (0, 0, 0), (0, 0, 1)),
                ("prismatic", (0.2, 0, 0), (0, 0, 0), (0, 0, 1)),
                ("revolute", (0, 0, -0.1), (0, 0, 0), (0, 0, 1)),
            ]
        )
    )
    true, believed = Arm.of(off(four), np.eye(4)), Arm.of(four, np.eye(4))
    q = 0.5 * random_joint_values(four, 20)
    q[:, 1] += 1.0
    wanted = believed.poses(q)
    before = Matching("pose", 1.0).misses(true.poses(q), wanted)
    left = {}
    for lever in (1e-3, 10.0):
        matching = Matching("weighted", lever)
        found = solve(true, wanted, q, matching, None)
        left[lever] = matching.misses(found.T_base_tool, wanted)
        error = matching.error(found.T_base_tool, wanted)
        gradient = np.einsum("nij,ni->nj", matching.jacobian(found.twists), error)
        scale = np.linalg.norm(error, axis=1).max()
        assert np.abs(gradient).max() < 1e-4 * scale
    # Four joints cannot undo a tilt: with a short lever the position is nearly exact all the same.
    assert left[1e-3][:, 0].max() < 1e-5 < before[:, 0].min() + 1e-4
    assert left[10.0][:, 1].max() <= left[1e-3][:, 1].max()
    assert np.median(left[10.0][:, 1]) > 1e-3


def test_a_slow_row_does_not_hold_up_the_others(ur3):
    arm = Arm.of(ur3, np.eye(4))
    q = well(arm, 3, POSE)
    wanted = Arm.of(off(ur3), np.eye(4)).poses(q)
    hopeless = wanted[:1].copy()
    hopeless[0, :3, 3] += 5.0
    alone = solve(arm, wanted, q, POSE, None)
    together = solve(
        arm, np.concatenate([wanted, hopeless]), np.concatenate([q, q[:1]]), POSE, None
    )
    assert np.array_equal(together.q[:3], alone.q)
    assert POSE.misses(together.T_base_tool, np.concatenate([wanted, hopeless]))[3, 0] > 1.0
