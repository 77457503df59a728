"""The size of an arm that no row measures: which direction it is, that the fit holds it, and that nothing else suffers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import calibrate
from calib.data.cell import Cell, GroupDistance
from calib.estimate.fitting import Task, fit
from calib.estimate.problem import Problem
from calib.estimate.setup import known_distances, rows_of
from calib.model.dh import dh_table
from calib.model.error_model import error_model
from calib.model.kinematics import FRAME, TARGET, Kinematics
from calib.robot.readback import random_joint_values
from calib.robot.robot import Robot


def relative_size(robot: Robot, nominal: Robot) -> float:
    """By how much the tip's paths have grown, but for where the base and the tip are, by least squares."""
    q = random_joint_values(nominal, 200, 5)
    here, there = (one.poses(q) for one in (nominal, robot))
    ends = np.concatenate([np.tile(np.eye(3), (200, 1, 1)), here[:, :3, :3]], axis=2).reshape(-1, 6)
    path, moved = here[:, :3, 3].ravel(), (there - here)[:, :3, 3].ravel()
    path, moved = (v - ends @ np.linalg.lstsq(ends, v, rcond=None)[0] for v in (path, moved))
    return float(path @ moved / (path @ path))


def problem_of(scene, table, model="dh", cell=None):
    """The problem at the true frames and targets, the size held where it has to be."""
    cell = Cell(model=model) if cell is None else replace(cell, model=model)
    rows, setup = rows_of(scene.robot, table, cell)
    parameters = error_model(
        scene.robot,
        model,
        frame=setup.frame_unknowns,
        target=setup.unknown_targets,
        targets=setup.target_names,
        rotation=setup.rotation,
    )
    own = scene.kinematics
    kinematics = Kinematics(scene.robot, parameters, own.T_frame_base, own.T_tip_target)
    return Problem.first(kinematics, rows, known_distances(cell, setup)).with_size_held()


@pytest.fixture(scope="module")
def sockets(make_scene, join):
    """A wrong UR3 and forty rows in two sockets within its reach."""
    scene = make_scene(3, frames=2, reach=0.25, noise=5e-5, length=0.5e-3, angle=3e-3)
    return scene, join(scene.fixed(20, 0), scene.fixed(20, 1))


@pytest.mark.parametrize("model", ["dh", "hayati", "placement", "dh+gain"])
def test_growth_is_that_of_all_lengths(sockets, model):
    """The parameters move the poses between base and tip as those of a grown robot, each to its own ends."""
    scene, table = sockets
    problem = problem_of(scene, table, model)
    gauge = problem.gauge
    assert gauge.held @ gauge.growth == pytest.approx(1.0)
    share, q = 1e-4, random_joint_values(scene.robot, 40, 1)
    grown = problem.kinematics.model.apply(scene.robot, share * gauge.growth)
    moved = grown.poses(q)[:, :3, 3] - scene.robot.poses(q)[:, :3, 3]
    wanted = share * scene.robot.poses(q)[:, :3, 3]
    # But for where the base and the target stand, which is theirs to make up for.
    R = scene.robot.poses(q)[:, :3, :3]
    ends = np.concatenate([np.tile(np.eye(3), (40, 1, 1)), R], axis=2).reshape(-1, 6)
    rest = (moved - wanted).ravel()
    rest = rest - ends @ np.linalg.lstsq(ends, rest, rcond=None)[0]
    assert np.abs(rest).max() < 1e-7
    # What is measured changes by the share of the residuals, which are lengths too, as the sockets and the target follow.
    linear = problem.linear(np.zeros(problem.size))
    placed = linear.A.reshape(-1, problem.size)[:, problem.kinematics.model.family(FRAME, TARGET)]
    residual = linear.residual(linear.x).ravel()
    residual = residual - placed @ np.linalg.lstsq(placed, residual, rcond=None)[0]
    np.testing.assert_allclose((linear.A @ gauge.growth).ravel(), -residual, atol=1e-6 * np.abs(residual).max())


def test_what_is_held_are_the_lengths_of_the_dh_table(sockets):
    """l_k of a2 and a3 are a2 and a3 themselves; lengths about which base or target decide are none."""
    scene, table = sockets
    problem = problem_of(scene, table)
    growth = dict(zip(problem.kinematics.model.names, problem.gauge.growth, strict=True))
    rows = dh_table(scene.robot).rows
    for name, length in (("a2", rows[1].a), ("a3", rows[2].a), ("d5", rows[4].d)):
        assert growth[name] == pytest.approx(length, abs=1e-6)
    # Parallel axes 2 to 4: only the sum of their offsets is a length.
    parallel = sum(growth[name] for name in ("d2", "d3", "d4"))
    assert parallel == pytest.approx(sum(row.d for row in rows[1:4]), abs=1e-6)
    assert growth["d1"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("what", ["points", "distances", "pairs"])
def test_nothing_is_held_where_a_row_measures_a_length(make_scene, join, what):
    scene = make_scene(4, frames=2, reach=0.25)
    table = join(scene.fixed(10, 0), getattr(scene, what)(8, 1))
    assert problem_of(scene, table).gauge is None


def test_nothing_is_held_where_the_size_is_known_otherwise(sockets):
    """By a distance between the sockets, by a target that is known and off the axis, or by a length that stays."""
    scene, table = sockets
    plate = Cell(distances=(GroupDistance("0", "1", 0.2, 1e-5),))
    assert problem_of(scene, table, cell=plate).gauge is None
    known = Cell(targets={"t0": scene.kinematics.T_tip_target[0, :3, 3]}, estimate_target=False)
    assert problem_of(scene, table, cell=known).gauge is None
    assert problem_of(scene, table, "zeros").gauge is None
    problem = problem_of(scene, table)
    stays = problem.kinematics.model.without(["a2"])
    frozen = replace(problem.kinematics, model=stays)
    assert Problem.first(frozen, problem.rows).with_size_held().gauge is None


def test_the_held_size_is_a_row_of_the_system(sockets):
    """A change of size costs its square over the tolerance; its derivative agrees with differences."""
    scene, table = sockets
    problem = problem_of(scene, table)
    x = 1e-4 * np.random.default_rng(1).normal(size=problem.size)
    r, J = problem.constraints(x)
    np.testing.assert_allclose(r, [-problem.gauge.held @ x / 1e-6])
    step = 1e-5 * np.eye(problem.size)
    numeric = [(problem.constraints(x + e)[0] - problem.constraints(x - e)[0]) / 2e-5 for e in step]
    np.testing.assert_allclose(-J.T, numeric, rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("model", ["dh", "placement", "dh+gain"])
def test_sockets_alone_leave_the_size_as_it_is(sockets, model):
    """And say so; without the gauge the arm would be a point."""
    scene, table = sockets
    cell = Cell(model=model)
    rows, setup = rows_of(scene.robot, table, cell)
    found = fit(Task(scene.robot, cell, setup, model), rows)
    estimate = found.estimate
    corrected = found.kinematics.model.apply(scene.robot, estimate.x)
    assert abs(estimate.problem.gauge.held @ estimate.x) < 1e-6
    assert abs(relative_size(corrected, scene.robot)) < 1e-3
    lengths = {"a2", "a3", "d5"} if model != "placement" else {"elbow_joint.x"}
    combinations = estimate.problem.observability(estimate.x).unidentifiable
    assert any(lengths <= set(one.names) for one in combinations)


def test_the_size_is_as_uncertain_as_it_was(sockets):
    """The variance of g is the prior's; without the gauge's share it would be none."""
    scene, table = sockets
    cell = Cell(model="dh")
    rows, setup = rows_of(scene.robot, table, cell)
    estimate = fit(Task(scene.robot, cell, setup, "dh"), rows).estimate
    held = estimate.problem.gauge.held
    expected = np.sum(held[held != 0.0] ** 2 / estimate.problem.precision[held != 0.0])
    assert held @ estimate.covariance @ held == pytest.approx(expected, rel=1e-3)
    assert expected > 1e-10


def test_the_verdict_is_on_the_rest(sockets):
    """A robot that is right but for its size may be used; what nothing tells is said."""
    scene, table = sockets
    result = calibrate(scene.robot, table, cell=Cell(model="dh"))
    codes = [reason.code for reason in result.verdict.reasons]
    assert "no_length" in codes
    assert result.verdict.use == "use"
