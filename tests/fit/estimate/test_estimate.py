"""Estimation against known truth: exact without noise, calibrated uncertainty with it, deaf to gross rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from calib.data.cell import Cell, Priors
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.families import FAMILIES

OFF = Priors(source="off")


def fitted(virtual, cell: Cell, rows: Rows, **options) -> Fitted:
    """A fit to rows of points of one target in one frame."""
    robot = virtual.kinematics.robot
    table = Measurements(robot.joint_names, rows.joints, rows.measured)
    _, setup = rows_and_setup(robot, table, cell)
    return fit(Task(robot, cell, setup, cell.model, **options), rows)


def with_points(rows: Rows, points, sigma=None) -> Rows:
    return replace(rows, measured=points, sigma=rows.sigma if sigma is None else sigma)


def error_at(virtual, result: Fitted, x, q):
    return result.kinematics.points(result.estimate.x, q) - virtual.kinematics.points(x, q)


def rms(errors):
    return np.sqrt(np.mean(np.sum(errors**2, axis=1)))


def absolute(virtual, result: Fitted):
    """The offsets against the virtual robot's own start, wherever registration put the target."""
    x = result.estimate.x.copy()
    start = virtual.kinematics.T_tip_target[0, :3, 3]
    x[-3:] += result.kinematics.T_tip_target[0, :3, 3] - start
    return x


@pytest.mark.parametrize("solver", ["lm", "scipy"])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("rows", [15, 30])
def test_without_noise_unseen_poses_are_exact(virtual, paper_cell, solver, seed, rows):
    rng = np.random.default_rng(seed)
    x = virtual.offsets(rng, 1e-3, 5e-3)
    data = virtual.rows(rng, x, rows, 0.0)
    result = fitted(virtual, replace(paper_cell, priors=OFF), data, solver=solver)
    assert np.abs(error_at(virtual, result, x, virtual.unseen())).max() < 3e-9


@pytest.mark.parametrize("seed", range(2))
def test_without_noise_every_identifiable_combination_is_recovered(virtual, paper_cell, seed):
    """One parameter of each combination that cannot be identified is held, here and in the truth."""
    rng = np.random.default_rng(seed)
    held = ("d2", "d3", "a6", "alpha6", "d6", "theta6")
    names = virtual.kinematics.model.names
    x = virtual.offsets(rng, 1e-3, 5e-3)
    x[[names.index(name) for name in held]] = 0.0
    data = virtual.rows(rng, x, 30, 0.0)
    result = fitted(virtual, replace(paper_cell, priors=OFF, frozen=held), data)
    kept = [k for k, name in enumerate(names) if name not in held]
    assert len(kept) == 21
    assert np.abs(absolute(virtual, result) - x[kept]).max() < 1e-9


@pytest.mark.slow
def test_intervals_and_predicted_uncertainty_hold_what_they_say(virtual, paper_cell):
    """Monte Carlo: 95 % intervals of parameters and of predicted points, N = 30, offsets and noise drawn each time."""
    rng = np.random.default_rng(11)
    q = virtual.unseen()[:50]
    inside, inside_points, squares, noise = [], [], [], []
    for _ in range(120):
        x = virtual.offsets(rng, 2e-4, 3e-3)
        result = fitted(virtual, paper_cell, virtual.rows(rng, x, 30, 1e-4))
        e = result.estimate
        reach = stdtrit(e.freedom, 0.975)
        inside.append(
            np.abs(absolute(virtual, result) - x) < reach * np.sqrt(np.diag(e.covariance))
        )
        _, jacobian = result.kinematics.twists(e.x, q, rotation=False)
        spread = np.einsum("nij,jk,nik->ni", jacobian, e.covariance, jacobian)
        errors = error_at(virtual, result, x, q)
        inside_points.append(np.abs(errors) < reach * np.sqrt(spread))
        squares.append(np.sum(errors**2) / np.sum(spread))
        noise.append(e.noise[0])
    assert 0.92 < np.mean(inside) < 0.97
    assert 0.92 < np.mean(inside_points) < 0.97
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.12)
    assert np.mean(noise) == pytest.approx(1.0, abs=0.03)


def test_prior_sizes_that_the_rows_told_count_as_if_they_were_given(virtual, paper_cell):
    """Although they are a fraction of typical ones: an arm whose points are measured is as good as its rows say."""
    rng = np.random.default_rng(0)
    data = virtual.rows(rng, virtual.offsets(rng, 1e-4, 5e-4), 15, 1e-4)
    told = fitted(virtual, paper_cell, data).estimate
    assert all(std < 0.5 * FAMILIES[name].typical for name, std in told.prior_std.items())
    priors = Priors("given", **told.prior_std)
    given = fitted(virtual, replace(paper_cell, priors=priors), data).estimate
    np.testing.assert_allclose(
        np.diagonal(told.covariance), np.diagonal(given.covariance), rtol=1e-4
    )


@pytest.mark.slow
def test_error_on_unseen_poses_is_near_the_bound(virtual, paper_cell):
    """Against Cramer and Rao for the 21 identifiable parameters: no estimator without priors is better."""
    rng = np.random.default_rng(12)
    q, ratios = virtual.unseen(), []
    for _ in range(40):
        x = virtual.offsets(rng, 1e-3, 5e-3)
        data = virtual.rows(rng, x, 60, 1e-4)
        result = fitted(virtual, paper_cell, data)
        _, seen = virtual.kinematics.twists(x, data.joints, rotation=False)
        _, unseen = virtual.kinematics.twists(x, q, rotation=False)
        covariance = 1e-8 * np.linalg.pinv(
            seen.reshape(-1, 27).T @ seen.reshape(-1, 27), rcond=1e-7, hermitian=True
        )
        bound = np.mean(np.einsum("nij,jk,nik->n", unseen, covariance, unseen))
        ratios.append(np.mean(np.sum(error_at(virtual, result, x, q) ** 2, axis=1)) / bound)
    assert np.sqrt(np.mean(ratios)) < 1.05


@pytest.mark.parametrize("rows", [40, 100])
@pytest.mark.parametrize("seed", range(2))
def test_a_fifth_of_gross_rows_is_flagged_and_does_no_harm(virtual, paper_cell, rows, seed):
    rng = np.random.default_rng(seed)
    x = virtual.offsets(rng, 1e-3, 5e-3)
    data = virtual.rows(rng, x, rows, 1e-4)
    gross = np.arange(rows) < rows // 5
    thrown = rng.normal(size=(gross.sum(), 3))
    thrown *= rng.uniform(5e-3, 50e-3, (gross.sum(), 1)) / np.linalg.norm(
        thrown, axis=1, keepdims=True
    )
    points = data.measured.copy()
    points[gross] += thrown
    spoilt = fitted(virtual, paper_cell, with_points(data, points))
    clean = fitted(virtual, paper_cell, data.select(~gross))
    q = virtual.unseen()
    assert np.all(spoilt.estimate.outliers[gross])
    assert spoilt.estimate.outliers[~gross].sum() <= 1
    assert rms(error_at(virtual, spoilt, x, q)) < 1.2 * rms(error_at(virtual, clean, x, q))


@pytest.mark.slow
def test_sizes_of_errors_and_noise_are_found(virtual, paper_cell):
    rng = np.random.default_rng(15)
    found = []
    for _ in range(40):
        x = virtual.offsets(rng, 4e-4, 2e-3)
        e = fitted(virtual, paper_cell, virtual.rows(rng, x, 60, 5e-5)).estimate
        found.append(
            [e.prior_std["length"], e.prior_std["angle"], e.prior_std["zero"], e.noise[0] * 1e-4]
        )
    np.testing.assert_allclose(
        np.sqrt(np.mean(np.square(found), axis=0)), [4e-4, 2e-3, 2e-3, 5e-5], rtol=0.1
    )


@pytest.mark.parametrize("model", ["dh", "hayati", "placement"])
def test_with_an_unknown_frame_too(virtual, model):
    rng = np.random.default_rng(19)
    x = virtual.offsets(rng, 1e-3, 3e-3)
    data = virtual.rows(rng, x, 80, 2e-5)
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T[:3, 3] = [2.0, -1.0, 0.4]
    moved = with_points(data, data.measured @ T[:3, :3].T + T[:3, 3])
    result = fitted(virtual, Cell(estimate_frame=True, model=model), moved)
    q = virtual.unseen()
    truth = virtual.kinematics.points(x, q) @ T[:3, :3].T + T[:3, 3]
    assert rms(result.kinematics.points(result.estimate.x, q) - truth) < 5e-5


@pytest.mark.parametrize(("solver", "noise"), [("lm", 0.0), ("scipy", 1e-7)])
def test_noise_below_any_instruments_does_not_take_every_row_for_an_outlier(
    virtual, paper_cell, solver, noise
):
    for seed in range(1):
        rng = np.random.default_rng(seed)
        x = virtual.offsets(rng, 1e-3, 5e-3)
        data = virtual.rows(rng, x, 15, noise)
        for priors in (OFF, Priors()):
            result = fitted(virtual, replace(paper_cell, priors=priors), data, solver=solver)
            assert result.estimate.problem.weights.sum() > 7
            assert rms(error_at(virtual, result, x, virtual.unseen())) < 1e-5 + 20 * noise
