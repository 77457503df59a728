"""What further unknowns take beside those of a fit: the base, the instrument's scale, what held-out blocks say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.diagnosis.further_unknowns import (
    _residuals_without_blocks,
    estimate_jointly,
    gain_on_blocks,
    instrument_scale,
    motion_of_base,
)
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.parameters import FRAME
from calib.robot.ranges import random_joint_values
from tests.judged import arm, table_of


def fitted(scene, table, cell=None):
    """A fit of the cell's model, DH if it names none."""
    cell = Cell(model="dh") if cell is None else cell
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return fit(Task(scene.robot, cell, setup, cell.model), rows)


@pytest.fixture(scope="module")
def clean(make_scene):
    """A wrong UR3 and forty points of it in its base frame."""
    scene = arm(make_scene, 7)
    q = random_joint_values(scene.robot, 40, 7)
    return scene, table_of(scene, q, np.random.default_rng(7))


def moved(table, by=(0.0, 0.0, 0.0), about=(0.0, 0.0, 0.0)):
    """The points in a frame in which the base stands elsewhere [m], turned [rad]."""
    R = Rotation.from_rotvec(about).as_matrix()
    return replace(table, points=table.points @ R.T + np.array(by))


def test_unknowns_beside_are_those_of_a_fit_that_has_them(clean):
    """Six motions of the base beside a fit in a known frame: what a fit with an unknown frame finds."""
    scene, table = clean
    table = moved(table, (3e-3, -2e-3, 0.0), (4e-3, -3e-3, 0.0))
    free = fitted(scene, table, Cell(model="dh", estimate_frame=True))
    known = fitted(scene, table)
    rows = known.estimate.problem.rows
    T = known.kinematics.poses(known.estimate.x, rows.samples)
    columns = np.zeros((len(rows), 6, 6))
    columns[:, :3, :3], columns[:, 3:, 3:] = np.eye(3), np.eye(3)
    columns[:, :3, 3:] = np.cross(np.eye(3), T[:, :3, 3][:, :, None], axis=1)
    beside = estimate_jointly(known, rows.derivative(T, columns))
    found = free.estimated_setup().T_frame_base[0]
    np.testing.assert_allclose(beside.b[:3], found[:3, 3], atol=2e-5)
    np.testing.assert_allclose(
        beside.b[3:], Rotation.from_matrix(found[:3, :3]).as_rotvec(), atol=5e-5
    )
    std = np.sqrt(np.diag(free.estimate.covariance)[free.kinematics.model.family(FRAME)])
    np.testing.assert_allclose(beside.std, std, rtol=0.15)
    assert beside.prior_std["zero"] == pytest.approx(free.estimate.prior_std["zero"], rel=0.1)
    # The priors have the same part in each parameter.
    of_robot = ~free.kinematics.model.family(FRAME)
    estimate = free.estimate
    determined = 1.0 - np.diag(estimate.covariance) * estimate.problem.prior_precision
    np.testing.assert_allclose(beside.determined, determined[of_robot], atol=0.05)
    assert np.min(determined) < 0.2
    assert np.max(determined) > 0.95


@pytest.mark.parametrize(
    ("by", "about"),
    [((4e-3, 3e-3, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (4e-3, -3e-3, 0.0))],
)
def test_a_base_that_has_moved_across_its_first_axis(clean, by, about):
    scene, table = clean
    motion = motion_of_base(fitted(scene, moved(table, by, about)))
    height = scene.robot.placements[0][2, 3]
    # The first joint's origin, above that of the base, moves with it.
    origin = np.linalg.norm(np.array(by) + np.cross(about, [0.0, 0.0, height]))
    assert motion.p < 1e-12
    assert motion.moved == pytest.approx(origin, abs=1e-4)
    assert motion.turned == pytest.approx(np.linalg.norm(about), abs=2e-4)
    if not np.any(about):
        assert motion.effect == pytest.approx(np.linalg.norm(by), abs=1e-4)
    # What the arm itself is off by stays.
    still = motion_of_base(fitted(scene, table))
    assert motion.effect_of_arm == pytest.approx(still.effect_of_arm, rel=0.1)


def test_a_base_that_stands_where_it_should_has_not_moved(clean):
    """The first joint's own offset and zero are its own, where the others' are as large."""
    scene, table = clean
    motion = motion_of_base(fitted(scene, table))
    assert (motion.p > 0.003, motion.effect) == (True, 0.0)


def test_a_base_that_stands_lower_than_any_joints_offset(clean):
    scene, table = clean
    motion = motion_of_base(fitted(scene, moved(table, (0.0, 0.0, 12e-3))))
    assert motion.moved == pytest.approx(12e-3, abs=1e-3)


def test_an_unknown_frame_has_no_base_to_be_moved(clean):
    scene, table = clean
    assert motion_of_base(fitted(scene, table, Cell(model="dh", estimate_frame=True))) is None


@pytest.mark.parametrize("share", [0.004, -0.004])
def test_the_scale_of_an_instrument(clean, share):
    scene, table = clean
    scale = instrument_scale(fitted(scene, replace(table, points=(1.0 + share) * table.points)))
    assert scale.share == pytest.approx(share, abs=3.0 * scale.std)
    assert scale.std < 1.5e-3
    assert scale.hidden == pytest.approx(abs(scale.share) + 2.0 * scale.std)
    assert scale.p < 0.05
    reach = np.sqrt(np.mean(np.sum(table.points**2, axis=1)))
    assert scale.reach == pytest.approx(reach, rel=0.01)


@pytest.mark.slow
def test_a_known_distance_between_sockets_tells_the_scale(calibrated):
    """Sockets measure nothing: only the distance grows, and the error that it then has is found."""
    scene, result = calibrated("sockets")
    scale = instrument_scale(result.fit.geometry)
    assert not scale.measured
    assert abs(scale.share) < 3.0 * scale.std
    wrong = tuple(replace(one, length=1.01 * one.length) for one in result.fit.cell.distances)
    cell = replace(result.fit.cell, distances=wrong)
    rows, setup = rows_and_setup(scene.robot, result.fit.measurements, cell)
    task = replace(result.fit.geometry.task, cell=cell, setup=setup)
    from calib.fit.registration.known_distances import known_distances

    found = fit(replace(task, distances=known_distances(cell, setup)), rows)
    assert instrument_scale(found).share == pytest.approx(0.01, abs=3.0 * scale.std)


def test_what_predicts_held_out_blocks_and_what_does_not(clean):
    """A drift of 0.4 mm over the table, and a column of noise."""
    scene, table = clean
    order = np.linspace(0.0, 1.0, len(table))[:, None]
    drifting = fitted(scene, replace(table, points=table.points + 4e-4 * order))
    weights, columns = np.ones(len(table)), order[:, :, None] * np.eye(3)
    assert gain_on_blocks(drifting, columns, weights) > 0.4
    assert gain_on_blocks(fitted(scene, table), columns, weights) < 0.05
    noise = np.random.default_rng(1).normal(size=(len(table), 3, 2))
    assert gain_on_blocks(drifting, noise, weights) < 0.05


def test_zeros_of_joints_cannot_take_a_scale(clean):
    """Where no length of the arm is estimated, what all lengths grow by has nothing to hide in."""
    scene, table = clean
    assert instrument_scale(fitted(scene, table, Cell(model="zeros"))) is None


def test_residuals_without_a_block_are_those_of_a_fit_to_the_others_with_the_same_priors(clean):
    """Normal equations by hand; a prior of its own holds the target, 1 mm beside where the rows put it."""
    scene, table = clean
    given = scene.kinematics.T_tip_target[0, :3, 3] + [1e-3, 0.0, 0.0]
    cell = Cell(model="zeros", target=given, parameter_priors={"target_x": 1e-5})
    found = fitted(scene, table, cell)
    problem = found.estimate.problem
    linear = problem.linear(found.estimate.x)
    masks = np.arange(len(table))[None] < 8
    weights = np.linspace(0.2, 1.0, len(table))
    residuals = _residuals_without_blocks(found, linear, weights, masks)[0]
    noise = found.estimate.noise[0]
    # In units of the noise, without the block.
    root = np.sqrt(np.where(masks[0], 0.0, weights))[:, None] / noise
    A = (root[:, :, None] * linear.A).reshape(-1, problem.size)
    y = (root * linear.residual(np.zeros(problem.size))).ravel()
    H = A.T @ A + np.diag(problem.prior_precision)
    x = np.linalg.solve(H, A.T @ y + problem.prior_precision * problem.prior_mean)
    np.testing.assert_allclose(residuals, linear.residual(x) / noise, atol=1e-6)
    assert np.any(problem.prior_mean)
