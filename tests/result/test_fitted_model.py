"""How sure predictions are: against fits to other noise, and against robots drawn from the covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.fitted_model import parameter_estimates
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.parts import with_part

TARGET = np.array([0.05, -0.06, 0.04])
ANCHOR = np.array([0.9, 0.2, 0.1])


def points_of(robot: Robot, q: np.ndarray) -> np.ndarray:
    poses = robot.poses(q)
    return np.asarray(poses[:, :3, :3] @ TARGET + poses[:, :3, 3])


def by_lengths(ur3: Robot, truth: Robot, rng: np.random.Generator, model: str) -> Calibration:
    """A draw wire, from an anchor whose place is not known."""
    q = random_joint_values(ur3, 60, 1)
    lengths = np.linalg.norm(points_of(truth, q) - ANCHOR, axis=1)
    table = Measurements(
        ur3.joint_names,
        q,
        np.full((60, 3), np.nan),
        kinds=("distance",) * 60,
        distances=lengths + 1e-4 * rng.normal(size=60),
    )
    return calibrate(ur3, table, cell=Cell(model=model, target=TARGET), validate=False)


@pytest.mark.slow
def test_of_points_it_is_what_fits_to_other_noise_scatter_by(ur3: Robot):
    """The same poses measured 40 times."""
    q, where = random_joint_values(ur3, 30, 1), random_joint_values(ur3, 40, 9)
    points, rng, found = points_of(ur3, q), np.random.default_rng(2), []
    for _ in range(40):
        table = Measurements(ur3.joint_names, q, points + 1e-4 * rng.normal(size=points.shape))
        found.append(calibrate(ur3, table, cell=Cell(model="frames"), validate=False))
    scatter = np.var([one.predict(where) for one in found], axis=0, ddof=1).sum(axis=1)
    std = found[0].position_std(where)
    assert np.sqrt(np.mean(std**2)) == pytest.approx(np.sqrt(np.mean(scatter)), rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "size"), [("frames", 0.0), ("zeros", 1e-3)])
def test_of_lengths_it_is_the_error_as_one_body(ur3: Robot, model: str, size: float):
    """Where the base stands no length tells: moved onto the truth by the measured poses, errors are as large as told.

    In the base they are not: what the first joint's zero is known to is its prior's word, whatever that is.
    """
    q, where = random_joint_values(ur3, 60, 1), random_joint_values(ur3, 40, 9)
    errors = error_model(ur3, "zeros", target=False)
    rng, as_one_body, in_base = np.random.default_rng(6), [], []
    for _ in range(25):
        truth = errors.apply(ur3, size * rng.normal(size=len(errors)))
        found = by_lengths(ur3, truth, rng, model)
        wanted, there = points_of(truth, where), found.predict(where)
        here, true = found.predict(q), points_of(truth, q)
        middle, centre = here.mean(axis=0), true.mean(axis=0)
        turn, _ = Rotation.align_vectors(true - centre, here - middle)
        moved = turn.apply(there - middle) + centre
        told = np.mean(found.position_std(where) ** 2)
        as_one_body.append(np.mean(np.sum((moved - wanted) ** 2, axis=1)) / told)
        in_base.append(np.mean(np.sum((there - wanted) ** 2, axis=1)) / told)
    assert np.sqrt(np.mean(as_one_body)) == pytest.approx(1.0, abs=0.25)
    assert size == 0.0 or np.sqrt(np.mean(in_base)) > 2.0


def test_each_target_counts_from_where_it_was_given(calibrated):
    scene, c = calibrated("targets")
    given = {"t0": scene.kinematics.T_tip_target[0, :3, 3] + [1e-3, 0.0, 0.0]}
    found = calibrate(
        scene.robot,
        c.fit.measurements,
        cell=replace(c.fit.cell, targets=given, model="dh"),
        validate=False,
    )
    for axis in range(3):
        known = found.parameter(f"target_{'xyz'[axis]}[t0]")
        free = found.parameter(f"target_{'xyz'[axis]}[t1]")
        assert known.nominal == given["t0"][axis]
        assert free.nominal is None
        for p, t in ((known, 0), (free, 1)):
            assert p.value == pytest.approx(found.setup.T_tip_target[t, axis, 3], abs=1e-12)


def test_a_turned_target_has_its_interval_and_prior_along_the_tips_axes(make_scene):
    """Value, prior and interval of ``target_x`` are of one axis, the one that the target is given in."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.05, 0.04, 0.16]
    given = T[:3, 3] + [1e-3, 1e-3, 0.0]
    scene = make_scene(
        100, frames=[np.eye(4)], targets=[T], length=0, angle=0, noise=1e-4, noise_angle=1e-4
    )
    cell = Cell(model="zeros", target=given, parameter_priors={"target_x": 1e-7})
    found = calibrate(scene.robot, scene.poses(40), cell=cell, validate=False)
    assert found.parameter("target_x").delta == pytest.approx(0.0, abs=3e-7)
    assert found.parameter("target_x").std == pytest.approx(1e-7, rel=0.01)
    assert abs(found.parameter("target_y").delta) > 5e-4
    assert found.parameter("target_y").std > 1e-5


def test_without_a_prior_a_parameter_has_no_standard_deviation_of_it(calibrated):
    _, c = calibrated("points")
    fitted, precision = c.fit.geometry, c.fit.geometry.estimate.problem.prior_precision.copy()
    precision[:2] = [4.0, 0.0]
    problem = replace(fitted.estimate.problem, prior_precision=precision)
    changed = replace(fitted, estimate=replace(fitted.estimate, problem=problem))
    estimates = parameter_estimates(changed, c.trust.observability)
    np.testing.assert_array_equal([one.prior_std for one in estimates[:2]], [0.5, np.nan])


def test_the_error_at_a_new_point_has_what_the_model_lacks(calibrated):
    """Elsewhere the variance of the prediction takes the place of that at the measured poses."""
    _, c = calibrated("points")
    exact = with_part(c, "geometry", scale=None)
    here, elsewhere = exact.new_point
    held_out = c.cross_validation.errors_without_outliers["m"].rms
    assert here == held_out
    added = c.geometry.expected_elsewhere**2 - c.geometry.noise_measured**2
    assert elsewhere**2 == pytest.approx(held_out**2 + added)
    alone = with_part(exact, "geometry", cross_validation=None)
    assert alone.new_point == (c.geometry.noise_measured, c.geometry.expected_elsewhere)


def test_the_error_at_a_new_point_has_the_largest_scale_error(calibrated):
    _, c = calibrated("points")
    scale, by_scale = c.geometry.scale, c.geometry.by_scale
    assert by_scale[0] == pytest.approx(c.geometry.scale_measured * scale.bound / scale.size)
    points = c.predict(random_joint_values(c.nominal, 300, 3))
    reach = np.sqrt(np.mean(np.sum(points**2, axis=1)))
    assert by_scale[1] == pytest.approx(scale.bound * reach, rel=0.3)
    without = with_part(c, "geometry", scale=None).new_point
    assert c.new_point == pytest.approx(tuple(np.hypot(without, by_scale)))
    rows = c.fit.measurements
    certified = replace(c.fit.cell, scale_certified=True)
    sure = calibrate(c.nominal, rows, cell=certified, validate=False)
    assert sure.geometry.by_scale == (0.0, 0.0)
