"""The whitened system of a problem, against differences and against its own definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.estimate.problem import Problem
from calib.fit.registration.setup import KnownDistance
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from tests.fit.estimate.differences import differences, problem_of


def test_system_is_weighted_residual_over_sigma_with_a_row_for_each_prior(virtual):
    rng = np.random.default_rng(1)
    precision = np.zeros(27)
    precision[[2, 5]] = [4.0e6, 1.0e4]
    problem, x = problem_of(virtual, rng, precision)
    r, J = problem.system(x)
    assert r.shape == (38,)
    assert J.shape == (38, 27)
    rows = problem.rows
    measured_minus_predicted = rows.measured - virtual.kinematics.points(x, rows.joints)
    by_hand = (
        measured_minus_predicted * (np.sqrt(problem.weights) / (1.3 * rows.sigma["m"]))[:, None]
    )
    np.testing.assert_allclose(r[:36], by_hand.T.ravel())
    from_mean = x - problem.prior_mean
    np.testing.assert_allclose(r[36:], [-2e3 * from_mean[2], -1e2 * from_mean[5]])


def test_jacobian_of_the_system_against_differences(virtual):
    rng = np.random.default_rng(2)
    problem, x = problem_of(virtual, rng, rng.uniform(0, 1e5, 27))
    _, J = problem.system(x)
    numeric = differences(lambda v: problem.system(v)[0], x, 1e-3)
    scale = np.linalg.norm(J, axis=0)
    assert np.max(np.abs(J - numeric) / scale) < 1e-7


def scene_problem(scene, table, distances=()):
    """Robot, every frame and every target unknown."""
    cell = Cell(estimate_frame=True)
    rows, setup = rows_and_setup(scene.robot, table, cell)
    model = error_model(
        scene.robot,
        "dh+gain",
        frame=setup.frame_unknowns,
        target=setup.unknown_targets,
        targets=setup.target_names,
        rotation=setup.rotation,
    )
    kinematics = Kinematics(
        scene.robot, model, scene.kinematics.T_frame_base, scene.kinematics.T_tip_target
    )
    return Problem.initial(kinematics, rows, distances)


def test_without_stops_of_several_targets_nothing_is_shared(make_scene):
    """Shares stay where a problem gets other rows, of which no stop may have several targets."""
    scene = make_scene(6)
    alone = scene_problem(scene, scene.points(8))
    assert alone.stops is None
    shared = replace(alone, stop_shares=np.full((1, 3), 0.3))
    x = np.full(alone.size, 1e-4)
    for found, expected in zip(shared.system(x), alone.system(x), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_jacobian_of_a_mixed_system_with_known_distances_against_differences(make_scene, join):
    scene = make_scene(6, frames=3, targets=2, reach=1.0)
    table = join(
        scene.points(5, 0), scene.poses(4, 1, 1), scene.distances(4, 2), scene.pairs(3, 0, 1)
    )
    known = (KnownDistance(0, 1, 1.2, 1e-4), KnownDistance(2, 0, 0.7, 5e-5))
    problem = scene_problem(scene, table, known)
    p = problem.size
    rng = np.random.default_rng(7)
    problem = replace(
        problem,
        weights=rng.uniform(0, 1, len(problem.rows)),
        prior_precision=rng.uniform(0, 1e5, p),
        prior_mean=1e-3 * rng.normal(size=p),
    )
    x = 3e-3 * rng.normal(size=p)
    r, J = problem.system(x)
    assert len(r) == problem.rows.count + p + 2
    numeric = differences(lambda v: problem.system(v)[0], x, 1e-3)
    assert np.max(np.abs(J - numeric) / np.linalg.norm(J, axis=0)) < 1e-7


def test_a_known_distance_is_that_between_the_frames_origins_in_the_base(make_scene, join):
    scene = make_scene(8, frames=2, reach=0.5)
    table = join(scene.points(4, 0), scene.points(4, 1))
    places = [np.linalg.inv(T)[:3, 3] for T in scene.kinematics.T_frame_base]
    length = np.linalg.norm(places[0] - places[1])
    problem = scene_problem(scene, table, (KnownDistance(0, 1, length + 2e-4, 1e-4),))
    r, J = problem.constraints(np.zeros(problem.size))
    assert r == pytest.approx([2.0])
    # The robot and the target have no part in it.
    model = problem.kinematics.model
    assert not np.any(J[:, ~model.family("(frame)")])
    numeric = differences(lambda v: problem.constraints(v)[0], np.zeros(problem.size), 1e-3)
    np.testing.assert_allclose(-J * 1e-4, numeric * 1e-4, atol=1e-7)


def test_the_smallest_noise_is_rounding_of_what_is_measured(virtual):
    """Ten nanometres, in units of the sigma of the typical row."""
    rows = virtual.rows(np.random.default_rng(4), np.zeros(27), 3, 0.0)
    rows = replace(rows, sigma={"m": np.array([1e-5, 1e-4, 1e-3])})
    assert Problem.initial(virtual.kinematics, rows).smallest_noise == pytest.approx((1e-4,))
