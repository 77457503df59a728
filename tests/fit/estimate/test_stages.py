"""Holds, the linearised problem and the stages of an estimation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from calib.data.cell import Cell
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.stages import FEWEST_FREEDOM, Stage, Weighting, run_stages
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Samples
from calib.numerics.likelihood import GaussianPriors
from calib.robot.kernel import BLOCK
from tests.fit.estimate.priors_of import prior_terms
from tests.fits import table_of_missed_stops


def test_freedom_is_what_scalars_are_left_after_the_parameters(virtual):
    rng = np.random.default_rng(1)
    rows = virtual.rows(rng, np.zeros(27), 40, 1e-4)
    linear = Problem.initial(virtual.kinematics, rows).linear(np.zeros(27))
    nothing, free = np.zeros(27), np.full(27, 1e-6)
    weights, noise = np.stack([np.ones(40), np.full(40, 0.5)]), np.ones((2, 1))
    (held, _), (loose, half) = (
        linear.fit(weights, np.zeros((1, 2)), noise, GaussianPriors(precision, nothing))[2]
        for precision in (np.full(27, 1e20), free)
    )
    assert held == pytest.approx(120, abs=1e-3)
    assert loose == pytest.approx(120 - 21, abs=1e-3)  # six of the 27 are told by others only
    assert half == pytest.approx(60 - 21, abs=1e-3)


def repeated(virtual, rng, shared, own, poses=40, times=4):
    """Rows of which every four share a pose and a part of their error."""
    once = virtual.rows(rng, np.zeros(27), poses, 0.0)
    rows = virtual.rows(rng, np.zeros(27), poses * times, 0.0)
    noise = np.repeat(once.measured + shared * rng.normal(size=(poses, 3)), times, axis=0)
    return replace(
        rows,
        samples=Samples.at(np.repeat(once.joints, times, axis=0)),
        measured=noise + own * rng.normal(size=(poses * times, 3)),
        poses=np.repeat(np.arange(poses), times),
    )


@pytest.mark.parametrize(
    ("mode", "shared", "own", "rho"),
    [
        ("independent", 1e-4, 1e-5, 0.0),
        ("average", 0.0, 1e-4, 1.0),
        ("weighted", 1e-4, 1e-6, 1.0),
        ("weighted", 1e-4, 1e-4, 0.5),
        ("weighted", 0.0, 1e-4, 0.0),
    ],
)
def test_repeats_count_for_what_they_do_not_share(virtual, mode, shared, own, rho):
    shares = []
    for seed in range(8):
        rows = repeated(virtual, np.random.default_rng(seed), shared, own)
        problem = Problem.initial(virtual.kinematics, rows)
        stage = Stage.initial(
            prior_terms(virtual, virtual.kinematics.model), np.ones((1, len(rows)), dtype=bool), 1
        )
        linear = problem.linear(np.zeros(27))
        stage = stage.by_repeats(linear, rows.poses, mode)
        np.testing.assert_array_equal(stage.repeat_factor, stage.repeat_factor[0, 0])
        shares.append(stage.repeat_factor[0, 0])
    assert np.mean(shares) == pytest.approx(1.0 / (1.0 + 3.0 * rho), abs=0.06)


def first_stage(virtual, count, noise, outliers=()):
    """The linearised problem of points, some of them 5 mm off, and the stage that an estimation begins with."""
    rows = virtual.rows(np.random.default_rng(4), np.zeros(27), count, noise)
    measured = rows.measured.copy()
    measured[list(outliers)] += [5e-3, 0.0, 0.0]
    problem = Problem.initial(virtual.kinematics, replace(rows, measured=measured))
    prior = prior_terms(virtual, virtual.kinematics.model)
    return problem.linear(np.zeros(27)), Stage.initial(prior, np.ones((1, count), dtype=bool), 1)


def test_robust_weights_are_those_of_cauchy(virtual):
    """A row 3.4 standard deviations from what the others predict has half the weight of one without error."""
    linear, stage = first_stage(virtual, 40, 1e-4, outliers=(3, 11, 19))
    for _ in range(8):
        stage = stage.by_median(linear)
    x, covariance, _ = stage.fit(linear)
    scores = linear.scores(x, covariance, stage.effective, stage.noise)
    np.testing.assert_allclose(stage.weights, 1.0 / (1.0 + (scores / 3.4) ** 2), rtol=1e-3)
    assert np.max(stage.weights[0, [3, 11, 19]]) < 0.01
    # The noise is that of the good rows.
    assert stage.noise[0, 0] == pytest.approx(1.0, rel=0.2)


def test_the_noise_is_kept_near_the_given_one_by_a_prior_of_a_factor_of_ten(virtual):
    linear, stage = first_stage(virtual, 12, 3e-3)
    stage = replace(stage, prior=replace(stage.prior, source="given"))

    def loss(log_noise):
        data = linear.normal_equations(stage.effective, stage.stop_shares)
        noise = np.full((1, 1), np.exp(log_noise))
        likelihood = data.log_likelihood(noise, stage.priors, stage.priors.precision)
        return 0.5 * (log_noise / np.log(10.0)) ** 2 - likelihood[0]

    found = stage.by_likelihood(linear, robust=False).noise[0, 0]
    best = minimize_scalar(loss, bounds=(0.0, 6.0), method="bounded", options={"xatol": 1e-6})
    assert np.log(found) == pytest.approx(best.x, abs=1e-3)


@pytest.mark.parametrize(("count", "robust"), [(40, True), (40, False), (8, True)])
def test_outliers_lose_their_weight_where_it_is_asked_for_and_freedom_is_left(
    virtual, count, robust
):
    """Of 24 scalars 21 parameters leave too few."""
    linear, stage = first_stage(virtual, count, 1e-4, outliers=(3,))
    stage, freedom = run_stages(
        stage, lambda _: linear, np.arange(count), Weighting("independent", robust, 1.0)
    )
    enough = count == 40
    assert (freedom[0] > FEWEST_FREEDOM) == enough
    if robust and enough:
        assert stage.weights[0, 3] < 0.01
        assert np.all(np.delete(stage.weights[0], 3) > 0.3)
    else:
        np.testing.assert_array_equal(stage.weights, 1.0)


def test_a_path_settles_at_the_share_that_its_correlation_leaves(virtual):
    """Correlated by 0.9 from row to row: one of 19 rows counts; twelve rounds are the most."""
    count, phi = 2 * BLOCK, 0.9
    rows = virtual.rows(np.random.default_rng(4), np.zeros(27), count, 0.0)
    white = np.random.default_rng(5).normal(0.0, 1e-4, (count, 3))
    errors = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white, axis=0)
    problem = Problem.initial(virtual.kinematics, replace(rows, measured=rows.measured + errors))
    linear = problem.linear(np.zeros(27))
    prior = prior_terms(virtual, virtual.kinematics.model)
    stages = [Stage.initial(prior, np.ones((1, count), dtype=bool), 1)]

    def linear_at(stage):
        stages.append(stage)
        return linear

    weighting = Weighting("independent", False, 1.0, along_path=True)
    stage, _ = run_stages(stages[0], linear_at, np.arange(count), weighting)
    assert stage.row_share[0, 0] == pytest.approx(1.0 / 19.0, rel=0.25)
    np.testing.assert_array_equal(stage.effective, stage.row_share[0, 0])
    assert len(stages) < 8


def test_rows_keep_their_weight_where_most_of_them_would_lose_it(virtual):
    """Outliers of 5 mm beside noise of 0.1 mm: of 40 rows one loses its weight, and of 24 none."""
    linear, stage = first_stage(virtual, 40, 1e-4, outliers=[0])
    assert stage._row_weights(linear)[0, 0] == 0.0
    linear, stage = first_stage(virtual, 40, 1e-4, outliers=range(24))
    np.testing.assert_array_equal(stage._row_weights(linear), 1.0)


def test_targets_of_a_stop_share_what_their_body_is_off_by(make_scene):
    """Two targets, displaced alike by ten times their own noise; of rounding nothing is shared."""
    scene = make_scene(4, frames=[np.eye(4)], targets=2, length=0.0, angle=0.0)
    table = table_of_missed_stops(scene, 40, 2)
    rows, setup = rows_and_setup(scene.robot, table, Cell())
    found = fit(Task(scene.robot, Cell(), setup, "frames"), rows)
    linear = Problem.initial(found.kinematics, rows).linear(found.estimate.x)
    prior = PriorTerms.of(found.task, found.kinematics.model, found.setup)
    stage = Stage.initial(prior, np.ones((1, len(rows)), dtype=bool), 1)
    stage = replace(stage, noise=np.array([found.estimate.noise]))
    shares = stage.by_stops(linear).stop_shares[0, 0]
    assert shares.sum() == pytest.approx(1.0 / 1.01, abs=0.05)
    # Asked for after those with shares, equations without are those that a new problem has.
    of_shares = linear.normal_equations(stage.effective, stage.by_stops(linear).stop_shares)
    for factor in (1.0, 2.0):
        without = linear.normal_equations(factor * stage.effective, stage.stop_shares)
        again = Problem.initial(found.kinematics, rows).linear(found.estimate.x)
        fresh = again.normal_equations(factor * stage.effective, stage.stop_shares)
        np.testing.assert_allclose(without.H, fresh.H, rtol=1e-9, atol=1e-9 * fresh.H.max())
        assert np.max(np.abs(of_shares.H - without.H)) > 0.1 * fresh.H.max()
    exact = replace(stage, noise=1.5 * np.array([linear.smallest_noise]))
    assert not np.any(exact.by_stops(linear).stop_shares)
