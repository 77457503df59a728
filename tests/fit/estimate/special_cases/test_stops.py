"""Stops with several targets: the dense covariance, brute-force likelihood, Monte Carlo, and poses of the body."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from calib.data.cell import Cell
from calib.diagnosis.reasons import Why
from calib.diagnosis.residual_patterns import residual_patterns
from calib.fit.estimate import problem as problem_module
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.special_cases import stops as stops_module
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.cross_validation import fold_posterior_means
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.numerics.likelihood import GaussianPriors
from calib.result.fitted_model import parameter_estimates
from calib.robot.ranges import random_joint_values
from calib.verbs.calibrate.uncertainty import _fit_sample
from tests.fits import joined, place
from tests.places import ROOT

sys.path.append(str(ROOT / "scripts"))
from stops_study import Hand, compare_fits, point_fit_errors

from calib.fit.estimate.special_cases.stops import (
    displacements_by_joints,
    of_unit_size,
    twists_of_bodies,
    twists_of_joints,
)
from calib.model.kinematics import Samples
from calib.robot.robot import Robot

HAND = [place([0.08, 0.0, 0.05]), place([-0.07, 0.03, 0.08]), place([0.0, -0.09, 0.06])]
HAND += [place([0.02, 0.06, 0.14], [0.3, 0.1, -0.2])]


def at(scene, q, target, *, pose=False, frame=0):
    """A table of one target at some joint values."""
    samples = scene.samples(len(q), frame, target, q)
    T = scene.kinematics.poses(scene.x, samples)
    columns = {"points": T[:, :3, 3] + 1e-4 * scene.rng.normal(size=(len(q), 3))}
    columns |= {"rotations": T[:, :3, :3]} if pose else {}
    return scene._table(samples, "pose" if pose else "point", **columns)


def problem_of(scene, table):
    """The problem of a table, with the nominal robot where the scene's frames and targets are."""
    rows, setup = rows_and_setup(scene.robot, table, Cell())
    frames, targets = ([int(name[-1:]) for name in one] for one in (setup.groups, setup.targets))
    places = dict.fromkeys(setup.groups if len(frames) > 1 else ("",), ())
    model = error_model(scene.robot, "dh", frame=places, targets=setup.target_names, target=False)
    T_frame_base, T_tip_target = scene.kinematics.T_frame_base, scene.kinematics.T_tip_target
    kinematics = Kinematics(scene.robot, model, T_frame_base[frames], T_tip_target[targets])
    return Problem.initial(kinematics, rows)


@pytest.fixture
def mixed(make_scene):
    """Points of up to four targets, poses of two and single ones, with a sigma of each row."""
    scene = make_scene(3, frames=2, targets=HAND)
    q = random_joint_values(scene.robot, 12, 4)
    tables = [at(scene, q[k:], k) for k in range(4)]
    tables += [at(scene, q[9:], t, pose=True, frame=1) for t in (0, 3)]
    table = joined(*tables)
    rng = np.random.default_rng(5)
    table = table.select(rng.permutation(len(table)) > 0)  # all but one
    sigma = rng.uniform(0.5e-4, 2e-4, len(table))
    return problem_of(scene, replace(table, sigma={"m": sigma, "rad": 10.0 * sigma}))


def dense(problem, weights, rho):
    """K and what it belongs to, of the scalars that count: (row, column) of each, by the definition."""
    rows, stops = problem.rows, problem.stops
    row, column = np.nonzero(rows.used & (weights > 0.0)[:, None])
    number = rows.channels.index[row, column]
    J, stop = np.zeros((len(row), stops.J.shape[2])), -1 - row
    where = {r: k for k, r in enumerate(stops.rows.tolist())}
    for i, (r, d) in enumerate(zip(row.tolist(), column.tolist(), strict=True)):
        if r in where:
            J[i], stop[i] = stops.J[where[r], d], stops.stops[where[r]]
    K = np.diag(1.0 / weights[row])
    for c, (t, w, g) in enumerate(rho):
        here = (number == c) & (stop >= 0)
        K[here, here] *= 1.0 - t - w - g
        alike = (stop[:, None] == stop) & here[:, None] & here
        shared = t * J[:, :3] @ J[:, :3].T + w * J[:, 3:6] @ J[:, 3:6].T + g * J[:, 6:] @ J[:, 6:].T
        K += np.where(alike, shared, 0.0)
    return K, row, column, number


def shares_by(linear, x, covariance, weights, rho):
    """The shares that the residuals of fits at x have."""
    return linear.stops.estimate_shares(linear.columns, x - linear.x, covariance, weights, rho)


RHO = np.array([[0.5, 0.25, 0.1], [0.1, 0.5, 0.2], [0.0, 0.3, 0.4]])


def test_a_stop_is_where_several_targets_of_one_kind_are_seen_from_one_frame(make_scene):
    scene = make_scene(1, frames=2, targets=HAND)
    q = random_joint_values(scene.robot, 5, 2)
    table = joined(
        at(scene, q[:2], 0),
        at(scene, q[:1], 1),  # with the first row, a stop
        at(scene, q[1:2], 1, frame=1),  # another frame
        at(scene, np.repeat(q[2:3], 2, axis=0), 2),  # repeats of one target
        at(scene, q[3:4], 2),
        at(scene, q[3:4], 3, pose=True),  # another kind
        scene._table(scene.samples(1, 0, 3, q[3:4]), "fixed"),
    )
    problem = problem_of(scene, table)
    assert sorted(problem.stops.rows.tolist()) == [0, 2]
    assert problem_of(scene, table.select(np.arange(len(table)) != 2)).stops is None
    assert problem.stops.select(np.arange(len(table)) > 2) is None
    assert problem.stops.select(np.arange(len(table)) != 1).rows.tolist() == [0, 1]


def test_joints_move_the_targets_on_one_link_as_a_body(mixed):
    stops = mixed.stops
    assert stops.by_joints.shape[2:] == (6, 6)
    for c in range(2):
        for number in np.unique(stops.stops):
            own = stops.stops == number
            J = (stops.J[own] * (stops.channel[own] == c)[:, :, None]).reshape(-1, stops.J.shape[2])
            by_body = J[:, :6] @ stops.by_joints[c, number] @ J[:, :6].T
            np.testing.assert_allclose(by_body, J[:, 6:] @ J[:, 6:].T, atol=1e-9)
    # Another target of a stop that the joints move apart is on another link.
    apart = stops.J.copy()
    apart[0, :, 6] *= 1.1
    by_joints = displacements_by_joints(apart, stops.stops, stops.channel)
    directions = stops.J.shape[2]
    assert by_joints.shape[2:] == (directions, directions)
    np.testing.assert_array_equal(by_joints[0, 0], np.diag([0.0] * 6 + [1.0] * (directions - 6)))


def test_the_body_moves_as_one_and_its_effect_has_mean_square_one(mixed):
    stops, rows = mixed.stops, mixed.rows
    T = mixed.kinematics.poses(np.zeros(mixed.size), rows.samples)
    for number in np.unique(stops.stops):
        own = stops.rows[stops.stops == number]
        centre = T[own, :3, 3].mean(axis=0)
        for k in range(6):
            v, w = 1e-6 * np.eye(6)[k, :3], 1e-6 * np.eye(6)[k, 3:]
            moved = T.copy()
            moved[own, :3, 3] += v + np.cross(w, T[own, :3, 3] - centre)
            turn = place([0.0, 0.0, 0.0], w)[:3, :3]
            moved[own, :3, :3] = turn @ T[own, :3, :3]
            found = ((rows.residual(T) - rows.residual(moved)) / rows.scales)[own] / 1e-6
            expected = stops.J[stops.stops == number][:, :, k]
            for c in range(3):
                here = rows.channels.index[own] == c
                a, b = found[here], expected[here]
                if len(b) and np.any(np.abs(b) > 1e-9):
                    np.testing.assert_allclose(b / np.abs(b).max(), a / np.abs(a).max(), atol=1e-4)
    for c in range(3):
        own = stops.channel == c
        squares = [
            np.sum(stops.J[own][:, part] ** 2) / np.sum(own)
            for part in (slice(3), slice(3, 6), slice(6, None))
        ]
        assert squares == pytest.approx([0.0, 1.0, 1.0] if c == 2 else [1.0, 1.0, 1.0])


@pytest.mark.parametrize("part", [7, 10_000])
def test_normal_equations_and_likelihood_by_the_dense_covariance(mixed, monkeypatch, part):
    monkeypatch.setattr(stops_module, "_PART", part)
    rng, p = np.random.default_rng(6), mixed.size
    linear = mixed.linear(np.zeros(p))
    weights = np.where(rng.uniform(size=(2, len(mixed.rows))) < 0.2, 0.0, 1.0)
    rho, noise = np.stack([RHO, 0.5 * RHO]), np.array([[1.0, 2.0, 3.0], [1.5, 1.0, 0.5]])
    data, alone = linear.normal_equations(weights, rho), linear.normal_equations(weights, 0.0 * rho)
    priors = GaussianPriors(np.full((2, p), 1e4), np.zeros(p))
    told = data.log_likelihood(noise, priors, priors.precision)
    for b in range(2):
        K, row, column, number = dense(mixed, weights[b], rho[b])
        A, y = linear.A[row, column], linear.residual(np.zeros(p))[row, column]
        for c in range(3):
            own = number == c
            inverse = np.linalg.inv(K[np.ix_(own, own)])
            H = A[own].T @ inverse @ A[own]
            np.testing.assert_allclose(data.H[b, c], H, rtol=1e-6, atol=1e-8 * np.abs(H).max())
            np.testing.assert_allclose(data.g[b, c], A[own].T @ inverse @ y[own], rtol=1e-6)
            assert data.yy[b, c] == pytest.approx(y[own] @ inverse @ y[own])
        V = K * np.outer(noise[b][number], noise[b][number]) + A @ A.T / 1e4
        expected = -0.5 * (np.linalg.slogdet(V)[1] + y @ np.linalg.solve(V, y))
        assert told[b] == pytest.approx(expected, rel=1e-8)
    assert not np.allclose(alone.H, data.H, rtol=0.1)


@pytest.mark.parametrize("tall", [1, 10_000])
def test_the_system_that_solvers_see_is_whitened_alike(mixed, monkeypatch, tall):
    monkeypatch.setattr(problem_module, "_TALL", tall)
    rng = np.random.default_rng(7)
    weights = rng.choice([0.0, 0.3, 1.0], len(mixed.rows))
    noise = np.array([1.0, 2.0, 3.0])
    problem = replace(mixed, weights=weights, noise=noise, stop_shares=RHO)
    x = 1e-4 * rng.normal(size=mixed.size)
    r, J = problem.system(x)
    K, row, column, number = dense(mixed, weights, RHO)
    inverse = np.linalg.inv(K * np.outer(noise[number], noise[number]))
    linear = problem.linear(x)
    A, y = linear.A[row, column], linear.residual(x)[row, column]
    np.testing.assert_allclose(J.T @ J, A.T @ inverse @ A, rtol=1e-6, atol=1e-8 * np.sum(J**2))
    np.testing.assert_allclose(-J.T @ r, A.T @ inverse @ y, rtol=1e-5, atol=1e-6)
    assert r @ r == pytest.approx(y @ inverse @ y)
    data = linear.normal_equations(weights[None], RHO)
    H = np.sum(data.H[0] / noise[:, None, None] ** 2, axis=0)
    np.testing.assert_allclose(J.T @ J, H, rtol=1e-6, atol=1e-8 * np.sum(J**2))


def test_repeats_of_a_target_count_as_their_mean(make_scene):
    scene = make_scene(8, frames=1, targets=HAND)
    q = random_joint_values(scene.robot, 10, 9)
    once = joined(*(at(scene, q, t) for t in range(4)))
    twice = joined(once, at(scene, q, 1))
    single, double = (problem_of(scene, table) for table in (once, twice))
    x, rho = np.zeros(single.size), RHO[:1]
    # The first is measured twice by rows that are equal, and count for a half each.
    measured = np.concatenate([single.rows.measured, single.rows.measured[10:20]])
    double = replace(double, rows=replace(double.rows, measured=measured))
    weights = np.ones(50)
    weights[10:20] = weights[40:] = 0.5
    one = single.linear(x).normal_equations(np.ones((1, 40)), rho)
    two = double.linear(x).normal_equations(weights[None], rho)
    np.testing.assert_allclose(two.H, one.H, rtol=1e-9, atol=1e-9 * np.abs(one.H).max())
    np.testing.assert_allclose(two.g, one.g, rtol=1e-9, atol=1e-9 * np.abs(one.g).max())
    assert two.yy == pytest.approx(one.yy)
    assert two.log_det == pytest.approx(one.log_det)
    # Repeats that share nothing: their mean is one measurement of twice the weight.
    alone, stops, expected = (
        double.linear(x).normal_equations(np.ones((1, 50)), rho),
        single.stops,
        0.0,
    )
    G = (
        stops.J
        * np.sqrt(np.repeat(RHO[0], [3, 3, 6]))
        * np.sqrt(1.0 + (stops.rows // 10 == 1))[:, None, None]
    )
    for number in np.unique(stops.stops):
        of_stop = G[stops.stops == number].reshape(-1, 12)
        K = (1.0 - np.sum(rho)) * np.eye(12) + of_stop @ of_stop.T
        expected += np.linalg.slogdet(K)[1]
    assert alone.log_det[0] == pytest.approx(expected)


def test_a_stop_that_is_drawn_twice_counts_twice(mixed):
    linear, x = mixed.linear(np.zeros(mixed.size)), np.zeros(mixed.size)
    once = linear.normal_equations(np.ones((1, len(mixed.rows))), RHO)
    count = np.full(len(mixed.rows), 2)
    drawn = replace(mixed, stops=mixed.stops.drawn(count), _last=[]).linear(x)
    twice = drawn.normal_equations(np.full((1, len(mixed.rows)), 2.0), RHO)
    np.testing.assert_allclose(twice.H, 2.0 * once.H)
    np.testing.assert_allclose(twice.yy, 2.0 * once.yy)
    assert not np.any(mixed.stops.drawn(0 * count).J)


def at_all_targets(scene, q):
    """Positions of the four targets at joint values, shape (4, N, 3) [m]."""
    return np.stack(
        [scene.kinematics.points(scene.x, scene.samples(len(q), 0, t, q)) for t in range(4)]
    )


def displaced(scene, q, rng, own, shift, turn, play=0.0):
    """A table of all targets at some stops whose bodies are off by a shift [m], a turn and play of the joints [rad].

    Besides, the rms of a coordinate by a turn of 1 rad about each axis [m], and by errors of 1 rad of all joints [m].
    """
    points = at_all_targets(scene, q)
    lever = points - points.mean(axis=0)
    v, w = shift * rng.normal(size=(len(q), 3)), turn * rng.normal(size=(len(q), 3))
    steps = play * rng.normal(size=q.shape)
    slopes = np.stack([at_all_targets(scene, q + 1e-6 * one) - points for one in np.eye(6)]) / 1e-6
    by_joints = np.einsum("jtnk,nj->tnk", slopes, steps)
    points = points + v + np.cross(w, lever) + by_joints + own * rng.normal(size=points.shape)
    samples = [scene.samples(len(q), 0, t, q) for t in range(4)]
    tables = [
        scene._table(one, "point", points=values)
        for one, values in zip(samples, points, strict=True)
    ]
    of_turn = np.sqrt(2.0 / 3.0 * np.mean(np.sum(lever**2, axis=2)))
    return joined(*tables), of_turn, np.sqrt(np.sum(np.mean(slopes**2, axis=(1, 2, 3))))


@pytest.mark.parametrize(
    ("own", "shift", "turn", "play"),
    [
        pytest.param(1e-4, 0.0, 0.0, 0.0, marks=pytest.mark.slow),
        pytest.param(1e-4, 2e-4, 0.0, 0.0, marks=pytest.mark.slow),
        (5e-5, 1e-4, 2e-3, 0.0),
        pytest.param(1e-5, 2e-4, 2e-4, 0.0, marks=pytest.mark.slow),
        pytest.param(5e-5, 0.0, 0.0, 2e-4, marks=pytest.mark.slow),
        (5e-5, 1e-4, 1e-3, 2e-4),
    ],
)
def test_shares_against_monte_carlo_truth(make_scene, own, shift, turn, play):
    found = []
    for seed in range(12):
        scene = make_scene(20 + seed, frames=[np.eye(4)], targets=HAND, length=0.0, angle=0.0)
        q = random_joint_values(scene.robot, 25, seed)
        rng = np.random.default_rng(seed)
        table, lever, reach = displaced(scene, q, rng, own, shift, turn, play)
        problem = problem_of(scene, table)
        linear, one = problem.linear(np.zeros(problem.size)), np.ones((1, 100))
        rho, priors = (
            np.zeros((1, 1, 3)),
            GaussianPriors(np.zeros(problem.size), np.zeros(problem.size)),
        )
        for _ in range(8):
            x, covariance, _ = linear.fit(one, rho, np.ones((1, 1)), priors)
            # The noise that goes with them.
            left = linear.normal_equations(one, rho)
            noise = left.residual_square(x) / (left.count - np.trace(left.H[0, 0] @ covariance[0]))
            rho = shares_by(linear, x, covariance * noise[0, 0], one, rho)
        found.append([*rho[0, 0], np.sqrt(noise[0, 0]) * 1e-4])
    parts = np.array([shift, lever * turn, reach * play]) ** 2
    total = own**2 + np.sum(parts)
    # Some of what joints do looks like a translation.
    tolerance = 0.1 if play else 0.06
    assert np.mean(found, axis=0)[:3] == pytest.approx(parts / total, abs=tolerance)
    assert np.mean(found, axis=0)[3] == pytest.approx(np.sqrt(total), rel=0.08)


def test_shares_maximise_the_restricted_likelihood(make_scene):
    scene = make_scene(40, frames=[np.eye(4)], targets=HAND, length=0.0, angle=0.0)
    q = random_joint_values(scene.robot, 9, 41)
    table, *_ = displaced(scene, q, np.random.default_rng(42), 5e-5, 1e-4, 1.5e-3, 6e-4)
    problem = problem_of(scene, table)
    linear, one, p = problem.linear(np.zeros(problem.size)), np.ones((1, 36)), problem.size
    priors = GaussianPriors(np.full((1, p), 1e5), np.zeros(p))

    def fall(values):
        """Of the restricted likelihood, at noise and shares."""
        noise, *shares = values
        rho = np.array(shares).reshape(1, 3)
        told = linear.normal_equations(one, rho).log_likelihood(
            np.array([[noise]]), priors, priors.precision
        )
        return -float(told[0])

    bounds = [(0.1, 10.0), (0.0, 0.8), (0.0, 0.8), (0.0, 0.8)]
    options = {"maxiter": 4000, "maxfev": 4000}
    best = minimize(
        fall, [1.0, 0.3, 0.2, 0.2], bounds=bounds, method="Nelder-Mead", tol=1e-9, options=options
    ).x
    rho = np.zeros((1, 1, 3))
    for _ in range(30):
        x, covariance, _ = linear.fit(one, rho, np.array([[best[0]]]), priors)
        rho = shares_by(linear, x, covariance, one, rho)
    assert np.sum(best[1:]) < 0.95
    assert rho[0, 0] == pytest.approx(best[1:], abs=2e-3)


def test_too_few_stops_share_nothing(make_scene):
    scene = make_scene(43, frames=[np.eye(4)], targets=HAND, length=0.0, angle=0.0)
    for stops, told in ((1, False), (2, True)):
        q = random_joint_values(scene.robot, stops, 44)
        table, *_ = displaced(scene, q, np.random.default_rng(45), 1e-6, 1e-3, 0.0)
        problem = problem_of(scene, table)
        linear, nothing = problem.linear(np.zeros(problem.size)), np.zeros((1, problem.size))
        covariance, one = np.zeros((1, problem.size, problem.size)), np.ones((1, 4 * stops))
        rho = shares_by(linear, nothing, covariance, one, np.zeros((1, 1, 3)))
        assert bool(np.any(rho > 0.9)) == told
        assert bool(np.any(rho)) == told


@pytest.fixture(scope="module")
def hand(ur3):
    """A fit to four markers of a hand whose stops are missed by three times the cameras' noise."""
    hand = Hand.draw(ur3, 25, 3.0, 11)
    rows, setup = rows_and_setup(ur3, hand.point_table(), Cell(estimate_frame=True))
    return hand, fit(Task(ur3, Cell(estimate_frame=True), setup, "dh"), rows)


def test_a_fit_finds_what_its_stops_share(hand):
    _, fitted = hand
    estimate = fitted.estimate
    assert np.sum(estimate.problem.stop_shares) == pytest.approx(0.9, abs=0.06)
    assert estimate.noise[0] * 1e-4 == pytest.approx(np.sqrt(10.0) * 5e-5, rel=0.2)
    # The least of what the solver sees is the linear fit with these shares.
    residual, jacobian = estimate.problem.system(estimate.x)
    size = np.linalg.norm(jacobian, axis=0)
    assert np.max(np.abs(jacobian.T @ residual) / size) < 1e-3 * np.linalg.norm(residual)
    data_gradients = [
        one.data_gradient
        for one in parameter_estimates(fitted, estimate.problem.observability(estimate.x))
    ]
    held = estimate.problem.prior_precision * (estimate.x - estimate.problem.prior_mean)
    np.testing.assert_allclose(data_gradients, held, atol=1e-3 * np.abs(held).max())


def test_rows_are_judged_one_by_one(hand):
    """By the scores that independent rows would have, at the fit of rows that are not."""
    _, fitted = hand
    estimate, problem = fitted.estimate, fitted.estimate.problem
    linear, noise = problem.linear(estimate.x), np.array([estimate.noise])
    priors = GaussianPriors(problem.prior_precision, problem.prior_mean)
    _, alone, _ = linear.fit(problem.weights[None], 0.0 * problem.stop_shares, noise, priors)
    assert np.min(np.diag(alone[0]) / np.diag(estimate.covariance)) < 0.5
    scores = linear.scores(estimate.x[None], alone, problem.weights[None], noise)[0]
    np.testing.assert_allclose(estimate.scores, scores, rtol=1e-6)


def test_folds_are_fitted_with_what_stops_share(hand):
    _, fitted = hand
    estimate, problem = fitted.estimate, fitted.estimate.problem
    linear, mask = problem.linear(estimate.x), problem.rows.blocks < 5
    (x,) = fold_posterior_means(fitted, linear, mask[None])
    noise, priors = (
        np.array([estimate.noise]),
        GaussianPriors(problem.prior_precision, problem.prior_mean),
    )
    rest = linear.select(~mask)
    found = rest.fit(problem.weights[None, ~mask], problem.stop_shares, noise, priors)[0][0]
    alone = rest.fit(problem.weights[None, ~mask], 0.0 * problem.stop_shares, noise, priors)[0][0]
    std = np.sqrt(np.diag(estimate.covariance))
    np.testing.assert_allclose(x, found, atol=1e-6 * std.min())
    assert np.max(np.abs(x - alone) / std) > 0.1


def test_stops_are_drawn_whole(hand):
    """As many again of each stop, and without priors: the least stays where it was."""
    _, fitted = hand
    estimate = fitted.estimate
    problem = replace(estimate.problem, prior_precision=1e-6 * estimate.problem.prior_precision)
    some = replace(fitted, estimate=replace(estimate, problem=problem))
    drawn = np.zeros(len(estimate.x) + len(problem.distances))
    once, twice = (_fit_sample(some, (np.full(len(problem.rows), k), drawn))[0] for k in (1, 2))
    moved = problem.residual(twice) - problem.residual(once)
    assert np.max(np.abs(moved)) < 1e-3 * np.min(problem.scales)


def test_what_stops_share_is_no_pattern(ur3):
    cell, found = Cell(estimate_frame=True), []
    for seed in range(5):
        rows, setup = rows_and_setup(ur3, Hand.draw(ur3, 30, 3.0, seed).point_table(), cell)
        fitted = fit(Task(ur3, cell, setup, "dh"), rows)
        numbers, moves = np.arange(len(rows)), np.zeros(rows.joints.shape)
        found += [one.why for one in residual_patterns(fitted, numbers, moves)]
    # Of poses of the hand as many: joints that do not repeat displace it more along some directions.
    assert found.count(Why.JOINT_PATTERN) + found.count(Why.DRIFT) <= 1


@pytest.mark.slow
def test_markers_tell_more_than_poses_of_their_body(ur3):
    runs = [compare_fits(ur3, 25, 3.0, seed) for seed in range(30)]
    by_points = np.sqrt(np.mean([run.by_points**2 for run in runs]))
    by_poses = np.sqrt(np.mean([run.by_poses**2 for run in runs]))
    stated = np.sqrt(np.mean([run.stated**2 for run in runs]))
    # Joints that do not repeat displace the hand more along some directions, which poses of it do not know.
    assert by_points < 0.75 * by_poses
    assert stated == pytest.approx(by_points, rel=0.08)
    assert np.mean([sum(run.shares) for run in runs]) == pytest.approx(0.9, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("own", "shift", "turn"), [(1e-4, 0.0, 0.0), (3e-5, 1e-4, 1e-3)])
def test_the_covariance_against_monte_carlo(make_scene, own, shift, turn):
    squares, cell = [], Cell()
    for seed in range(60):
        scene = make_scene(seed, frames=[np.eye(4)], targets=HAND, length=4e-4, angle=3e-3)
        q = random_joint_values(scene.robot, 25, seed)
        table, *_ = displaced(scene, q, np.random.default_rng(seed), own, shift, turn)
        rows, setup = rows_and_setup(scene.robot, table, cell)
        fitted = fit(Task(scene.robot, cell, setup, "dh"), rows)
        samples = scene.samples(100, 0, 2, random_joint_values(scene.robot, 100, 5))
        poses, J = fitted.kinematics.twists(fitted.estimate.x, samples, rotation=False)
        off = poses[:, :3, 3] - scene.kinematics.points(scene.x, samples)
        spread = np.einsum("nij,jk,nik->ni", J, fitted.estimate.covariance, J)
        squares.append([np.sum(off**2), np.sum(spread)])
    of_errors, stated = np.sqrt(np.mean(squares, axis=0))
    assert stated == pytest.approx(of_errors, rel=0.1)


def test_points_of_a_body_turn_about_their_weighted_centroid():
    points = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [4.0, 0.0, 0.0], [5.0, 5.0, 5.0]])
    stops = np.array([3, 3, 3, 8])
    twists = twists_of_bodies(points, points, stops, np.array([1.0, 1.0, 2.0, 1.0]))
    centroid = np.array([2.25, 0.5, 0.0])
    np.testing.assert_array_equal(twists[:, :3, :3], np.tile(np.eye(3), (4, 1, 1)))
    np.testing.assert_array_equal(twists[:, 3:, :3], 0.0)
    np.testing.assert_array_equal(twists[:, 3:, 3:], np.tile(np.eye(3), (4, 1, 1)))
    turn = np.array([0.1, -0.2, 0.3])
    for k in range(3):
        moved = twists[k, :3, 3:] @ turn
        np.testing.assert_allclose(moved, np.cross(turn, points[k] - centroid))
    # The only point of its body stays where it is.
    np.testing.assert_array_equal(twists[3, :3, 3:], 0.0)


def test_corners_of_a_board_turn_its_origin_about_their_centroid():
    corners = np.array([[1.0, 0.0, 0.5], [3.0, 2.0, 0.5]])
    origins = np.array([[5.0, 5.0, 5.0], [5.0, 5.0, 5.0]])
    twists = twists_of_bodies(origins, corners, np.array([0, 0]), np.ones(2))
    turn = np.array([0.1, -0.2, 0.3])
    for k in range(2):
        moved = twists[k, :3, 3:] @ turn
        np.testing.assert_allclose(moved, np.cross(turn, origins[k] - [2.0, 1.0, 0.5]))


def test_each_channel_has_a_scale_of_its_own():
    rng = np.random.default_rng(1)
    J = rng.normal(size=(40, 2, 6))
    channel = np.tile(np.array([0, 1], dtype=np.int8), (40, 1))
    channel[30:, 1] = -1
    J[:, 1, :3] = 0.0  # no translation moves an angle
    counts = rng.uniform(0.5, 1.0, 40)
    scaled = of_unit_size(J, channel, counts)
    np.testing.assert_array_equal(scaled[30:, 1], 0.0)
    for column, part, expected in (
        (0, slice(0, 3), 1.0),
        (0, slice(3, 6), 1.0),
        (1, slice(0, 3), 0.0),
        (1, slice(3, 6), 1.0),
    ):
        measured = channel[:, column] >= 0
        squares = np.sum(scaled[measured, column, part] ** 2, axis=1)
        assert np.average(squares, weights=counts[measured]) == pytest.approx(expected)
    np.testing.assert_allclose(scaled[0, 0, :3] / scaled[5, 0, :3], J[0, 0, :3] / J[5, 0, :3])


def kinematics_of(robot):
    """A robot seen from two frames, with two targets, under a model that is not used."""
    frames = np.array([place([1.0, 2.0, 0.5], [0.3, -0.2, 1.0]), np.eye(4)])
    targets = np.array([np.eye(4), place([0.05, 0.1, 0.2], [0.1, 0.2, 0.3])])
    model = error_model(robot, "dh", frame={"a": (), "b": ()}, target=False, targets=("one", "two"))
    return Kinematics(robot, model, frames, targets)


def differences(kinematics, q, frame, target):
    """Twists of targets by joint values, shape (K, 6, m), by differences."""
    x = np.zeros(len(kinematics.model))
    T = kinematics.poses(x, Samples(q, frame, target))
    columns = []
    for step in 1e-6 * np.eye(q.shape[1]):
        change = (kinematics.poses(x, Samples(q + step, frame, target)) - T) / 1e-6
        turn = change[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2)
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        columns.append(np.hstack([change[:, :3, 3], spin]))
    return np.stack(columns, axis=2)


@pytest.fixture
def sliding(serial_urdf):
    """Three joints of which the second slides."""
    joints = [
        ("revolute", (0, 0, 0.3), (0, 0, 0), (0, 0, 1)),
        ("prismatic", (0.1, 0, 0.2), (0.3, 0, 0), (0, 1, 0)),
        ("revolute", (0, 0.2, 0.1), (0, 1.0, 0), (1, 0, 0)),
    ]
    return Robot.from_urdf(serial_urdf(joints))


def test_twists_of_joints_are_those_of_differences(ur3, sliding):
    frame, target = np.array([0, 1, 1, 0]), np.array([0, 0, 1, 1])
    for robot, turning in ((ur3, range(6)), (sliding, (0, 2))):
        kinematics = kinematics_of(robot)
        q = np.random.default_rng(5).uniform(-1, 1, (4, len(robot.joint_names)))
        twists = twists_of_joints(kinematics, Samples(q, frame, target))
        expected = differences(kinematics, q, frame, target)[:, :, list(turning)]
        np.testing.assert_allclose(twists, expected, atol=1e-5)


# Stops that are off as a whole

FREE_CELL = Cell(estimate_frame=True)


@pytest.mark.parametrize("part", [7, 10_000])
def test_displacements_of_bodies_are_independent_and_lose_nothing(mixed, monkeypatch, part):
    """M reduces the scalars of a channel: M K M^T = I, and M keeps what K^-1 tells of the body."""
    monkeypatch.setattr(stops_module, "_PART", part)
    weights = np.random.default_rng(8).uniform(0.2, 1.0, len(mixed.rows))
    weights[mixed.stops.rows[0]] = 0.0
    noise = np.array([1.0, 2.0, 3.0])
    K, row, column, number = dense(mixed, weights, RHO)
    where = {r: k for k, r in enumerate(mixed.stops.rows.tolist())}
    of_stops = np.array([r in where for r in row.tolist()])
    units = np.zeros((len(row), mixed.rows.width, len(mixed.rows)))
    units[np.arange(len(row)), column, row] = 1.0
    M = mixed.stops.displacements(units, weights, noise, RHO)  # (S, 18, scalars)
    for s, stop in enumerate(np.unique(mixed.stops.stops)):
        for c in range(3):
            own = of_stops & (number == c)
            own[own] = [mixed.stops.stops[where[r]] == stop for r in row[own].tolist()]
            reduced = M[s, 6 * c : 6 * c + 6][:, own] * noise[c]
            reduced = reduced[np.any(reduced != 0.0, axis=1)]
            if not np.any(own):
                assert not len(reduced)
                continue
            K_own = K[np.ix_(own, own)]
            np.testing.assert_allclose(reduced @ K_own @ reduced.T, np.eye(len(reduced)), atol=1e-8)
            J = np.array(
                [
                    mixed.stops.J[where[r], d, :6]
                    for r, d in zip(row[own].tolist(), column[own].tolist(), strict=True)
                ]
            )
            told = J.T @ np.linalg.solve(K_own, J)
            np.testing.assert_allclose(
                (reduced @ J).T @ (reduced @ J), told, atol=1e-6 * np.abs(told).max()
            )


def fit_of(hand, points, stops=None):
    """A fit to markers of a hand at some of its stops, with the rows that are flagged, (stops, markers)."""
    chosen = np.ones(len(points), dtype=bool) if stops is None else stops
    some = replace(hand, q=hand.q[chosen], points=points[chosen])
    rows, setup = rows_and_setup(hand.true.robot, some.point_table(), FREE_CELL)
    found = fit(Task(hand.true.robot, FREE_CELL, setup, "dh"), rows)
    return found, found.estimate.outliers.reshape(-1, points.shape[1])


#: Four and a half standard deviations of what the robot misses, too little for a single marker to be flagged.
SHIFT = 4.5 * 3.0 * 5e-5


@pytest.fixture(scope="module")
def missing_hand(ur3):
    return Hand.draw(ur3, 40, 3.0, 206)


def test_a_stop_that_is_off_is_thrown_out_as_a_whole(missing_hand):
    points = missing_hand.points.copy()
    points[6] += SHIFT * np.array([0.6, -0.64, 0.48])
    found, flagged = fit_of(missing_hand, points)
    expected = np.zeros((40, 4), dtype=bool)
    expected[6] = True
    np.testing.assert_array_equal(flagged, expected)
    np.testing.assert_array_equal(found.estimate.weights.reshape(40, 4)[6], 0.0)
    without, _ = fit_of(missing_hand, points, np.arange(40) != 6)
    errors = [point_fit_errors(missing_hand, fitted) for fitted in (found, without)]
    np.testing.assert_allclose(*errors, atol=5e-6)


def test_no_stop_is_thrown_out_of_good_ones(missing_hand):
    assert not np.any(fit_of(missing_hand, missing_hand.points)[1])


def with_stops_off(hand, distances):
    """The points of a hand whose first stops are off by distances [m], each in a direction of its own."""
    count = len(distances)
    points, shift = hand.points.copy(), np.random.default_rng(1).normal(size=(count, 1, 3))
    shift /= np.linalg.norm(shift, axis=2, keepdims=True)
    points[:count] += distances[:, None, None] * shift
    return points


def test_many_stops_that_are_off_are_none(missing_hand):
    _, flagged = fit_of(missing_hand, with_stops_off(missing_hand, np.full(12, SHIFT)))
    assert not np.any(np.all(flagged, axis=1))


def test_six_of_forty_stops_are_not_too_many(missing_hand):
    """They are just the share of which no more are thrown out: the last one is found once the others are."""
    points = with_stops_off(missing_hand, np.linspace(2.0, 1.0, 6) * SHIFT)
    _, flagged = fit_of(missing_hand, points)
    np.testing.assert_array_equal(np.flatnonzero(np.all(flagged, axis=1)), np.arange(6))
