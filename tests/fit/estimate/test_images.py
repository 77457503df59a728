"""Fits of images: the Jacobian of all unknowns of both lenses, and exact recovery of an arm, a camera and a print."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.camera.lenses import LENSES
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.task import Task
from calib.fit.registration.registration import register
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.row_weights import compare_weights
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.parameter_sets import error_model
from calib.numerics.likelihood import GaussianPriors
from calib.numerics.rigid_motion import best_motion, displacements_by
from calib.numerics.solvers import levenberg_marquardt
from tests.images import BOARD, BODY, VALUES, arm, camera, cell, poses, table


def problem(lens, board=BOARD):
    robot = arm()
    c = cell(lens, boards={"": board})
    rows, setup = rows_and_setup(robot, table(poses(5), lens=lens, board=board, noise=0.3), c)
    registered = register(robot.poses(rows.joints), setup, rows)
    model = Task(robot, c, registered, "dh").error_model()
    kinematics = Kinematics(robot, model, registered.T_frame_base, registered.T_tip_target)
    return Problem.initial(kinematics, rows)


@pytest.mark.parametrize(
    ("lens", "board"), [*((lens, BOARD) for lens in LENSES), ("pinhole", BODY)]
)
def test_jacobian_of_all_unknowns_is_that_of_differences(lens, board):
    p = problem(lens, board)
    model = p.kinematics.model
    x = 1e-3 * np.random.default_rng(7).normal(size=p.size)
    J = p.prediction_jacobian(x)
    for k in range(p.size):
        h = 1e-3 if model.units[k] == "px" else 1e-6
        step = h * np.eye(p.size)[k]
        difference = -(p.residual(x + step) - p.residual(x - step)) / (2.0 * h)
        np.testing.assert_allclose(
            J[:, :, k], difference, rtol=1e-7, atol=1e-4, err_msg=model.names[k]
        )


def test_a_fit_recovers_arm_camera_and_print():
    robot = arm()
    q = poses(14)
    rng = np.random.default_rng(1)
    model = error_model(robot, "zeros", target=False)
    x = np.zeros(len(model))
    x[1:-1] = 5e-3 * rng.normal(size=len(model) - 2)
    true_robot = model.apply(robot, x)
    values = VALUES["pinhole"] * [1.01, 1.01, 1.01, 0.99, 1, 1, 1, 1, 1]
    points = BOARD.corners * [1.002, 0.999, 1.0]
    m = table(q, robot=true_robot, values=values, points=points)
    wide = camera(sigma=np.array([20.0, 20.0, 20.0, 20.0, 0.1, 0.1, 0.01, 0.01, 0.1]))
    board = replace(BOARD, sigma_scale=0.02, sigma_warp=0.0, sigma_corner=0.0)
    c = cell(cameras={"": wide}, boards={"": board}, sigma={"px": 0.01})
    rows, setup = rows_and_setup(robot, m, c)
    fitted = fit(Task(robot, c, setup, "zeros"), rows)
    assert np.sqrt(np.mean(fitted.residual(rows) ** 2)) < 5e-3
    estimated = dict(zip(fitted.kinematics.model.names, fitted.estimate.x, strict=True))
    assert estimated["fx"] == pytest.approx(7.0, abs=0.5)
    assert estimated["board_scale_x"] - estimated["board_scale_y"] == pytest.approx(0.003, abs=2e-4)
    for name, value in zip(model.names[1:-1], x[1:-1], strict=True):
        assert estimated[name] == pytest.approx(value, abs=5e-4)


def test_a_board_that_only_held_out_images_show_is_placed_with_the_lens_as_estimated():
    """By the lens that was given, of a centre 30 px off, it would be placed, and predicted, elsewhere."""
    robot = arm()
    given = VALUES["pinhole"] + [0.0, 0.0, 30.0, -20.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    sigma = np.array([0.0, 0.0, 50.0, 50.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    exact = replace(BOARD, sigma_scale=0.0, sigma_warp=0.0, sigma_corner=0.0)
    c = cell(cameras={"": camera(values=given, sigma=sigma)}, boards={"": exact})
    m = table(poses(16))
    later = np.array([int(name[:-4]) >= 10 for name in m.images])
    m = replace(m, targets=tuple(np.where(later, "there", "here").tolist()))
    rows, setup = rows_and_setup(robot, m, c)
    here, there = rows.select(~later), rows.select(later)
    of_here = np.array([name == "here" for name in setup.targets])
    seen = setup.with_fixed(np.zeros(len(setup.groups), dtype=bool), ~of_here)
    unseen = setup.with_fixed(np.ones(len(setup.groups), dtype=bool), of_here)
    fitted = fit(Task(robot, c, seen, "frames"), here).with_held_out(unseen, there)
    assert np.abs(fitted.residual(here)).max() < 0.01
    assert np.abs(fitted.residual(there)).max() < 0.01


def test_a_fit_finds_where_the_corners_of_a_body_are():
    """As well along z as across it; what all of them share is a motion of the body, which nothing else tells."""
    rng = np.random.default_rng(2)
    off = 3e-4 * rng.standard_normal(BODY.corners.shape)
    exact = camera(sigma=np.zeros(9))
    board = replace(BODY, sigma_scale=0.0)
    c = cell(cameras={"": exact}, boards={"": board}, sigma={"px": 0.01})
    m = table(poses(14), board=board, points=board.corners + off)
    rows, setup = rows_and_setup(arm(), m, c)
    fitted = fit(Task(arm(), c, setup, "frames"), rows)
    assert np.sqrt(np.mean(fitted.residual(rows) ** 2)) < 1e-3
    estimated = dict(zip(fitted.kinematics.model.names, fitted.estimate.x, strict=True))
    count = len(BODY.corners)
    found = np.array([[estimated[f"corner_{k}_{axis}"] for axis in "xyz"] for k in range(count)])
    left = found - off
    motion = best_motion(BODY.corners, left[:, :, None])
    left -= displacements_by(motion, BODY.corners)[:, :, 0]
    assert np.sqrt(np.mean(left**2)) < 2e-6
    assert np.abs(found[:, 2]).max() > 3e-4


def test_corners_of_one_image_share_the_errors_of_the_robot():
    robot = arm()
    q = poses(30)
    rng = np.random.default_rng(3)
    jitter = q + 5e-4 * rng.normal(size=q.shape)
    m = table(jitter, noise=0.1)
    m = replace(m, joints=np.repeat(q, len(BOARD.corners), axis=0))
    rows, setup = rows_and_setup(robot, m, cell())
    fitted = fit(Task(robot, cell(), setup, "frames"), rows)
    # Of what joints do to each image, which is larger than the noise of a corner.
    assert fitted.estimate.problem.stop_shares.sum() > 0.5
    assert fitted.estimate.problem.stop_shares[0, 2] > 0.5
    linear = fitted.estimate.problem.linear(fitted.estimate.x)
    stage = fitted.estimate
    none = np.zeros((1, 1, 3))
    weights = stage.weights[None]
    priors = GaussianPriors(np.full(len(stage.x), 1.0), np.zeros(len(stage.x)))
    noise = np.array([stage.noise])
    _, shared, _ = linear.fit(weights, stage.problem.stop_shares[None], noise, priors)
    _, independent, _ = linear.fit(weights, none, noise, priors)
    assert shared[0, 0, 0] > 3.0 * independent[0, 0, 0]


def test_the_order_of_images_and_corners_does_not_matter():
    robot = arm()
    m = table(poses(8), noise=0.3)
    c = cell(boards={"": replace(BOARD, sigma_corner=0.0)})
    order = np.random.default_rng(5).permutation(len(m))
    words = {
        name: tuple(np.array(getattr(m, name))[order].tolist())
        for name in ("kinds", "images", "corners")
    }
    shuffled = replace(
        m,
        joints=m.joints[order],
        points=m.points[order],
        board_points=m.board_points[order],
        readings={name: values[order] for name, values in m.readings.items()},
        sets=(),
        targets=(),
        groups=(),
        pairs=(),
        approaches=(),
        rows=(),
        **words,
    )
    results = []
    for measurements in (m, shuffled):
        rows, setup = rows_and_setup(robot, measurements, c)
        results.append(fit(Task(robot, c, setup, "zeros"), rows))
    first, second = results
    assert first.kinematics.model.names == second.kinematics.model.names
    scale = np.where(np.array(first.kinematics.model.units) == "px", 700.0, 1.0)
    np.testing.assert_allclose(second.estimate.x / scale, first.estimate.x / scale, atol=1e-10)
    placed, again = first.estimated_setup(), second.estimated_setup()
    np.testing.assert_allclose(again.T_frame_base, placed.T_frame_base, atol=1e-11)
    np.testing.assert_allclose(again.T_tip_target, placed.T_tip_target, atol=1e-11)


def test_changes_of_images_count_in_standard_deviations_where_a_step_is_not_known():
    robot = arm()
    sizes = []

    def solver(system, x0, step_size, step_tolerance):
        sizes.append(step_size)
        return levenberg_marquardt(system, x0, step_size, step_tolerance)

    c = cell(cameras={"": replace(camera(), values=None, sigma=None)}, sigma={"px": 20.0})
    rows, setup = rows_and_setup(robot, table(poses(8), noise=20.0), c)
    fitted = fit(Task(robot, c, setup, "zeros", solver=solver), rows)
    step = steps(fitted.kinematics.model.units)
    stds = np.sqrt(np.diag(fitted.estimate.covariance))
    assert np.any(stds > 10.0 * step)
    np.testing.assert_allclose(sizes[-1], np.maximum(step, stds), rtol=0.2)


def test_other_fits_to_images_begin_where_the_first_ended():
    robot = arm()
    m = table(poses(8), noise=0.3)
    rows, setup = rows_and_setup(robot, m, cell())
    starts = []

    def solver(system, x0, step_size, step_tolerance):
        starts.append(x0.copy())
        return levenberg_marquardt(system, x0, step_size, step_tolerance)

    fitted = fit(Task(robot, cell(), setup, "zeros", solver=solver), rows)
    assert fitted.near == (fitted,)
    count = len(starts)
    compare_weights(fitted)
    np.testing.assert_array_equal(starts[count], fitted.estimate.x)
