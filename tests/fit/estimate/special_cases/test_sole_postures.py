"""Poses that alone tell of a direction: which they are, that they keep their weight, and that all else stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.special_cases.sole_postures import _NOISE_OF_OTHERS, _joseph_update, _Update
from calib.fit.estimate.stages import Stage
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.cross_validation import cross_validation
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import Truth, draw_truth

ROWS, ROW, WRIST, NOISE = 36, 20, 4, 5e-5
OFF = np.array([6e-3, 0.0, -8e-3])


def joint_values(robot: Robot, seed: int = 5) -> np.ndarray:
    """Poses of which one alone moves a wrist joint."""
    q = random_joint_values(robot, ROWS, seed)
    q[:, WRIST] = 0.3
    q[ROW, WRIST] = 1.5
    return q


def measured(truth: Truth, q: np.ndarray, off: np.ndarray | float = 0.0, seed: int = 0):
    """A table of points, of which one is so far off."""
    points = truth.points(q) + NOISE * np.random.default_rng(seed).normal(size=(len(q), 3))
    points[ROW] += off
    return Measurements(truth.nominal.joint_names, q, points)


def fitted(table: Measurements, robot: Robot, cell: Cell | None = None) -> Fitted:
    cell = Cell() if cell is None else cell
    rows, setup = rows_and_setup(robot, table, cell)
    return fit(Task(robot, cell, setup, "dh"), rows)


def without(table: Measurements, row: int = ROW) -> Measurements:
    return table.select(np.arange(len(table)) != row)


@pytest.fixture(scope="module")
def truth(ur3) -> Truth:
    return draw_truth(ur3, "dh", seed=3)


def sole_rows(found: Fitted) -> list[int]:
    return np.flatnonzero(~found.estimate.problem.rows.checked).tolist()


def test_the_pose_that_alone_moves_a_joint_is_sole(ur3, truth):
    assert sole_rows(fitted(measured(truth, joint_values(ur3)), ur3)) == [ROW]


def test_poses_that_move_it_check_each_other(ur3, truth):
    """Two each tell of a direction that the other does not; four are enough."""
    q = joint_values(ur3)
    q[3, WRIST] = -1.0
    assert sole_rows(fitted(measured(truth, q), ur3)) == [3, ROW]
    q[8, WRIST], q[30, WRIST] = 0.8, -0.6
    assert sole_rows(fitted(measured(truth, q), ur3)) == []


@pytest.mark.parametrize("count", [ROWS, 12, 8])
def test_no_pose_is_sole_among_random_ones(ur3, truth, count):
    table = measured(truth, random_joint_values(ur3, ROWS, 9))
    last = table.select(np.arange(ROWS) >= ROWS - count)
    assert sole_rows(fitted(last, ur3)) == []


def test_repeats_of_a_pose_are_one_pose(ur3, truth):
    q = joint_values(ur3)
    q[3] = q[ROW]
    found = fitted(measured(truth, q), ur3)
    assert sole_rows(found) == [3, ROW]
    assert np.all(found.estimate.weights[[3, ROW]] > 0.99)


def test_a_frame_that_one_pose_sees_makes_no_sole_posture(make_scene, join):
    """What such a pose tells of its frame concerns no joint."""
    scene = make_scene(3, frames=2, noise=5e-5)
    table = join(scene.points(30, 0), scene.points(3, 1))
    cell = Cell(estimate_frame=True)
    assert sole_rows(fitted(table, scene.robot, cell)) == []


@pytest.mark.parametrize("off", [np.zeros(3), OFF])
def test_it_keeps_its_weight_and_the_others_their_fit(ur3, truth, off):
    table = measured(truth, joint_values(ur3), off)
    whole, rest = fitted(table, ur3), fitted(without(table), ur3)
    estimate = whole.estimate
    assert estimate.weights[ROW] == 1.0
    assert not estimate.outliers[ROW]
    # It is met as well as its noise, and the others as they would be without it.
    assert np.linalg.norm(whole.residual(estimate.problem.rows)[ROW]) < 2e-4
    others = rest.estimate.problem.rows
    assert np.abs(whole.residual(others) - rest.residual(others)).max() < 2e-6
    for name in ("noise", "freedom", "log_likelihood"):
        of_whole, of_rest = (getattr(one.estimate, name) for one in (whole, rest))
        assert of_whole == pytest.approx(of_rest, rel=1e-6)
    assert dict(estimate.prior_std) == pytest.approx(dict(rest.estimate.prior_std), rel=1e-4)


def test_elsewhere_the_robot_is_as_without_it(ur3, truth):
    """Also at poses that were not measured, where the joint stands as in the other rows; to more than first order."""
    table = measured(truth, joint_values(ur3), OFF)
    whole, rest = fitted(table, ur3), fitted(without(table), ur3)
    q = random_joint_values(ur3, 100, 77)
    q[:, WRIST] = 0.3
    T_target = [one.estimated_setup().T_tip_target[0] for one in (whole, rest)]
    robots = [one.kinematics.model.apply(ur3, one.estimate.x) for one in (whole, rest)]
    points = [(r.poses(q) @ T)[:, :3, 3] for r, T in zip(robots, T_target, strict=True)]
    assert np.linalg.norm(points[0] - points[1], axis=1).max() < 1e-5


def test_what_not_even_wide_priors_allow_is_an_outlier(ur3, truth):
    estimate = fitted(measured(truth, joint_values(ur3), 100.0 * OFF), ur3).estimate
    assert estimate.outliers[ROW]
    assert estimate.weights[ROW] == 0.0


def test_its_row_takes_part_in_what_is_determined(ur3, truth):
    """Without it the directions that it tells of are not determined."""
    table = measured(truth, joint_values(ur3))
    whole, rest = (fitted(one, ur3).estimate for one in (table, without(table)))
    ranks = [one.problem.observability(one.x).rank for one in (whole, rest)]
    assert ranks[0] > ranks[1]


def test_held_out_errors_are_without_it(ur3, truth):
    found = fitted(measured(truth, joint_values(ur3), OFF), ur3)
    validation = cross_validation(found, found.estimate.outliers)
    assert validation.errors["m"].n == ROWS - 1
    assert validation.errors["m"].max < 1e-3 < np.linalg.norm(validation.residual[ROW])


def test_given_weights_of_a_judge_leave_it_as_it_is(ur3, truth):
    """A fit that takes the weights of another has the same sole postures."""
    table = measured(truth, joint_values(ur3), OFF)
    judge = fitted(table, ur3)
    again = fit(judge.task, replace(judge.estimate.problem.rows, sole=None), reference=judge)
    assert sole_rows(again) == [ROW]
    np.testing.assert_allclose(again.estimate.x, judge.estimate.x, atol=1e-7)


@pytest.mark.slow
def test_covariance_by_monte_carlo(ur3):
    """Errors of predictions, where the sole posture moves the joint and where it stands, are as large as said."""
    prior_std = {"length": 0.3e-3, "angle": 1e-3}
    priors = Priors("given", **prior_std)
    cell = Cell(priors=priors, sigma={"m": NOISE})
    q = joint_values(ur3)
    squares = []
    for seed in range(200):
        one = draw_truth(ur3, "dh", prior_std, seed)
        found = fitted(measured(one, q, seed=seed), ur3, cell)
        estimate, model = found.estimate, found.kinematics.model
        samples = estimate.problem.rows.samples.select(np.array([ROW, 0, 7]))
        points = found.kinematics.points(estimate.x, samples)
        twists = found.kinematics.twists(estimate.x, samples, rotation=False)[1]
        covariance = twists @ estimate.covariance @ twists.swapaxes(1, 2)
        error = points - one.points(samples.q)
        assert len(model) == len(estimate.x)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0)
    np.testing.assert_allclose(np.mean(squares, axis=0), 1.0, atol=0.25)


def test_the_verdict_names_row_and_joint(ur3, truth):
    result = calibrate(ur3, measured(truth, joint_values(ur3)), model="dh")
    (reason,) = [r for r in result.verdict.reasons if r.code == "sole_posture"]
    assert reason.values == {"rows": [ROW + 1], "joints": [ur3.joint_names[WRIST]]}
    assert result.verdict.use == "use with care"


def test_the_update_s_derivative_is_minus_that_of_its_residual(ur3, truth):
    """Rows, constraints and priors against differences, away from where the update begins."""
    found = fitted(measured(truth, joint_values(ur3)), ur3)
    problem, p = found.estimate.problem, found.estimate.problem.size
    start = problem.linear(found.estimate.x)
    rng = np.random.default_rng(1)
    constrained = replace(start, C=rng.normal(size=(2, p)), z=np.zeros(2))
    shape = constrained.used.shape
    update = _Update(
        start=constrained,
        whiten=rng.normal(size=(*shape, shape[1])),
        reference=rng.normal(size=shape),
        prior=rng.uniform(1.0, 10.0, p),
    )

    def at(x):
        return replace(problem.linear(x), C=constrained.C, z=constrained.z)

    x = found.estimate.x + 1e-3 * rng.normal(size=p)
    derivative = update.derivative(at(x))
    for k in range(0, p, 5):
        e = 1e-4 * np.eye(p)[k]
        slope = (update.residual(at(x + e)) - update.residual(at(x - e))) / 2e-4
        scale = np.abs(derivative[:, k]).max()
        np.testing.assert_allclose(-derivative[:, k] / scale, slope / scale, atol=1e-5)
        assert np.any(slope[-p - 2 : -p])
        assert np.any(slope[-p:])


def test_the_gain_of_least_variance_adds_up_information():
    """With Kalman's gain the Joseph form is the inverse of the sum of both informations."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(5, 5))
    covariance = root @ root.T
    A = rng.normal(size=(2, 5))
    gain = covariance @ A.T @ np.linalg.inv(A @ covariance @ A.T + np.eye(2))
    expected = np.linalg.inv(np.linalg.inv(covariance) + A.T @ A)
    np.testing.assert_allclose(_joseph_update(covariance, gain, A), expected, rtol=1e-9)
    # Another gain leaves a larger variance.
    worse = _joseph_update(covariance, 0.5 * gain, A) - expected
    assert np.min(np.linalg.eigvalsh(worse)) > -1e-9
    assert np.max(np.linalg.eigvalsh(worse)) > 1e-3


def test_the_update_weighs_rows_by_their_noise(ur3, truth):
    """A row of a sole posture by its weight, the others by the stage's and at a noise of their own factor."""
    found = fitted(measured(truth, joint_values(ur3)), ur3)
    problem = found.estimate.problem
    start = problem.linear(np.zeros(problem.size))
    N, D = start.used.shape
    prior = PriorTerms.of(found.task, problem.kinematics.model, found.setup)
    stage = Stage.initial(prior, np.ones((1, N), dtype=bool), 1, weights=0.25)
    stage = replace(stage, noise=np.array([[2.0]]))
    weights = np.where(np.arange(N) == ROW, 0.64, 0.0)
    update = _Update.of(start, stage, weights, np.tile(np.eye(D), (N, 1, 1)))
    of_others = 0.5 / (2.0 * _NOISE_OF_OTHERS)
    expected = np.where(np.arange(N) == ROW, 0.8 / 2.0, of_others)
    np.testing.assert_allclose(update.whiten[:, 0, 0], expected)
    assert not np.any(update.reference[ROW])
    np.testing.assert_array_equal(update.reference[0], start.residual(start.x)[0])
