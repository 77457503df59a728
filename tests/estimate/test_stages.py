"""Holds, the linearised problem and the stages of an estimation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.problem import Problem
from calib.estimate.stages import Stage
from calib.model.error_model import error_model
from calib.model.families import ZERO
from calib.model.kinematics import Samples
from calib.model.parameters import FRAME, TARGET
from calib.numerics.likelihood import GaussianPriors
from calib.registration.table_rows import rows_and_setup

#: How far registration moves the target.
OFF = np.zeros((4, 4))
OFF[0, 3] = 1e-3


def prior_terms(virtual, model, **given):
    """The prior terms of a cell whose target was given where the fit starts."""
    robot, rows = (
        virtual.kinematics.robot,
        virtual.rows(np.random.default_rng(0), np.zeros(27), 3, 0.0),
    )
    cell = Cell(target=virtual.kinematics.T_tip_target[0, :3, 3], estimate_frame=True, **given)
    table = Measurements(robot.joint_names, rows.joints, rows.measured)
    _, setup = rows_and_setup(robot, table, cell)
    started = setup.placed(setup.T_frame_base, virtual.kinematics.T_tip_target + OFF)
    return PriorTerms.of(cell, model, setup, started, lenient=False)


@pytest.fixture(scope="module")
def model(ur3):
    return error_model(ur3, "dh+compliance", frame=True, rotation=True)


def test_each_family_has_a_size_and_frame_and_target_a_weak_hold(virtual, model):
    holds = prior_terms(virtual, model)
    assert holds.names == ("length", "angle", "zero", "compliance")
    assert holds.start == (3e-3, 15e-3, 15e-3, 1e-5)
    placed = model.family(FRAME, TARGET)
    np.testing.assert_array_equal(holds.flat, placed)
    np.testing.assert_array_equal(holds.precision, np.where(placed, 1.0, 0.0))
    np.testing.assert_array_equal(sum(holds.families) + placed, 1)
    assert not np.any(holds.centre)


def test_a_prior_of_its_own_takes_a_parameter_out_of_its_family(virtual, model):
    k, t = model.index("theta2"), model.index("target_x")
    single = {"theta2": 1e-4, "target_x": 2e-4}
    holds = prior_terms(virtual, model, parameter_priors=single)
    assert not holds.families[holds.names.index(ZERO)][k]
    assert holds.precision[[k, t]] == pytest.approx([1e8, 2.5e7])
    assert not holds.flat[t]
    assert holds.centre[t] == pytest.approx(-1e-3)  # where it was said to be, from where it starts
    assert np.flatnonzero(holds.centre).tolist() == [t]


def test_a_parameter_at_its_bound_stays_there(virtual, model):
    k = model.index("d1")
    holds = prior_terms(virtual, model).at_bounds({k: 2e-3})
    assert holds.centre[k] == 2e-3
    assert holds.precision[k] > 1e15
    assert not any(members[k] for members in holds.families)


def test_freedom_is_what_scalars_are_left_after_the_parameters(virtual):
    rng = np.random.default_rng(1)
    rows = virtual.rows(rng, np.zeros(27), 40, 1e-4)
    linear = Problem.first(virtual.kinematics, rows).linear(np.zeros(27))
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
        problem = Problem.first(virtual.kinematics, rows)
        stage = Stage.first(
            prior_terms(virtual, virtual.kinematics.model), np.ones((1, len(rows)), dtype=bool), 1
        )
        linear = problem.linear(np.zeros(27))
        stage = stage.sharing(linear, rows.poses, mode)
        np.testing.assert_array_equal(stage.share, stage.share[0, 0])
        shares.append(stage.share[0, 0])
    assert np.mean(shares) == pytest.approx(1.0 / (1.0 + 3.0 * rho), abs=0.06)


def first_stage(virtual, count, noise, outliers=()):
    """The linearised problem of points, some of them 5 mm off, and the stage that an estimation begins with."""
    rows = virtual.rows(np.random.default_rng(4), np.zeros(27), count, noise)
    measured = rows.measured.copy()
    measured[list(outliers)] += [5e-3, 0.0, 0.0]
    problem = Problem.first(virtual.kinematics, replace(rows, measured=measured))
    prior = prior_terms(virtual, virtual.kinematics.model)
    return problem.linear(np.zeros(27)), Stage.first(prior, np.ones((1, count), dtype=bool), 1)


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
        data = linear.data(stage.effective, stage.rho)
        noise = np.full((1, 1), np.exp(log_noise))
        likelihood = data.log_likelihood(noise, stage.priors, stage.priors.precision)
        return 0.5 * (log_noise / np.log(10.0)) ** 2 - likelihood[0]

    found = stage.by_likelihood(linear, robust=False).noise[0, 0]
    best = minimize_scalar(loss, bounds=(0.0, 6.0), method="bounded", options={"xatol": 1e-6})
    assert np.log(found) == pytest.approx(best.x, abs=1e-3)
