"""The size of an arm that no row measures: which direction it is, and that the fit holds it at no other cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, GroupDistance
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.special_cases.arm_size import _with_setup_growth, find_size_gauge
from calib.fit.estimate.task import Task
from calib.fit.registration.setup import known_distances
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.dh_table import dh_table
from calib.model.error_model import FRAME, TARGET
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.fits import place


def relative_size(robot: Robot, nominal: Robot) -> float:
    """By what share the root of the sum of squared lengths between the joints has grown."""
    before, after = (np.sum(one.placements[1:-1, :3, 3] ** 2) for one in (nominal, robot))
    return float(np.sqrt(after / before) - 1.0)


def problem_of(scene, table, model="dh", cell=None):
    """The problem at the true frames and targets, the size held where it has to be."""
    cell = Cell(model=model) if cell is None else replace(cell, model=model)
    rows, setup = rows_and_setup(scene.robot, table, cell)
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
    return Problem.initial(kinematics, rows, known_distances(cell, setup)).with_size_held()


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
    # What is measured changes by the share of the residuals, which are lengths too; sockets and target follow.
    linear = problem.linear(np.zeros(problem.size))
    placed = linear.A.reshape(-1, problem.size)[:, problem.kinematics.model.family(FRAME, TARGET)]
    residual = linear.residual(linear.x).ravel()
    residual = residual - placed @ np.linalg.lstsq(placed, residual, rcond=None)[0]
    np.testing.assert_allclose(
        (linear.A @ gauge.growth).ravel(), -residual, atol=1e-6 * np.abs(residual).max()
    )


@pytest.mark.parametrize(("share", "is_seen"), [(0.6, False), (1.6, True)])
def test_rows_see_growth_by_more_than_a_thousandth_of_the_reach(sockets, share, is_seen):
    """Rows without residuals, and growth that changes them by a part that neither frame nor target takes."""
    scene, table = sockets
    problem = problem_of(scene, table)
    gauge, rows = problem.gauge, problem.rows
    A = problem.linear(np.zeros(problem.size)).A.copy()
    of_setup = problem.kinematics.model.family(FRAME, TARGET)
    lengths = np.where(of_setup, 0.0, gauge.growth)
    placed = A.reshape(-1, problem.size)[:, of_setup]
    change = np.random.default_rng(2).normal(size=len(placed))
    change -= placed @ np.linalg.lstsq(placed, change, rcond=None)[0]
    unseen = A.reshape(-1, problem.size) @ gauge.growth
    tips = scene.robot.poses(random_joint_values(scene.robot, 500, 3))[:, :3, 3]
    reach = np.sqrt(np.mean(np.sum((tips - tips.mean(axis=0)) ** 2, axis=1)))
    change *= share * 1e-3 * reach / 1e-4 / np.sqrt(np.mean(change**2))  # in units of sigma
    A += np.outer(change - unseen, lengths / (lengths @ lengths)).reshape(A.shape)
    found = find_size_gauge(problem.kinematics, rows, A, np.zeros(A.shape[:2]))
    assert (found is None) == is_seen


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
    assert Problem.initial(frozen, problem.rows).with_size_held().gauge is None


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


def test_the_held_size_is_in_the_system_at_the_start_too(sockets):
    """The gauge is found from the problem without it, whose linearisation at zero offsets must not be kept."""
    scene, table = sockets
    problem = problem_of(scene, table)
    linear = problem.linear(np.zeros(problem.size))
    assert len(linear.C) == len(problem.distances) + 1
    np.testing.assert_array_equal(linear.held, linear.C[-1])
    assert np.abs(linear.held).max() > 0.0


@pytest.mark.parametrize("model", ["dh", "placement", "dh+gain"])
def test_sockets_alone_leave_the_size_as_it_is(sockets, model):
    """And say so; without the gauge the arm would be a point."""
    scene, table = sockets
    cell = Cell(model=model)
    rows, setup = rows_and_setup(scene.robot, table, cell)
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
    rows, setup = rows_and_setup(scene.robot, table, cell)
    estimate = fit(Task(scene.robot, cell, setup, "dh"), rows).estimate
    held = estimate.problem.gauge.held
    expected = np.sum(held[held != 0.0] ** 2 / estimate.problem.prior_precision[held != 0.0])
    assert held @ estimate.covariance @ held == pytest.approx(expected, rel=1e-3)
    assert expected > 1e-10


def test_the_verdict_is_on_the_rest(sockets):
    """A robot that is right but for its size may be used; what nothing tells is said."""
    scene, table = sockets
    result = calibrate(scene.robot, table, cell=Cell(model="dh"))
    codes = [reason.code for reason in result.verdict.reasons]
    assert "no_length" in codes
    assert result.verdict.use == "use"


#: Arms with three sockets within reach and a fourth that the fit does not see; of two hands one holds the sockets.
ARMS = {
    "ur5": ("base_link", "tool0"),
    "panda": ("panda_link0", "panda_link8"),
    "ur10": ("base_link", "tool0"),
    "baxter": ("left_gripper_base_link", "right_gripper_base_link"),
}
SPOTS = np.array([[0.35, 0.1, 0.3], [-0.3, 0.25, 0.4], [0.1, -0.35, 0.5], [0.3, 0.3, 0.45]])
IN_THE_HAND = np.array(
    [[0.0, 0.0, 0.15], [0.04, 0.0, 0.15], [0.0, 0.04, 0.17], [0.03, -0.03, 0.16]]
)


def held_out(robot: Robot, table, cell: Cell):
    """The error at the socket that only validation rows see, and the relative size of the corrected arm."""
    sets = tuple("validate" if group == "3" else "estimate" for group in table.groups)
    result = calibrate(robot, replace(table, sets=sets), cell=cell)
    errors = result.errors["non_geometric" if result.non_geometric else "calibrated"]["validation"]
    return errors["m"].rms, relative_size(result.robot, robot), result


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("seed", range(2))
def test_without_a_known_distance_as_good_as_with_one(make_scene, join, arm, seed):
    """But for the size, which stays within a thousandth: at sockets that were not seen errors are as small."""
    robot = Robot.load(arm, *ARMS[arm])
    spots = IN_THE_HAND if arm == "baxter" else SPOTS
    frames = [place(-spot) for spot in spots]
    targets = [place([0.02, 0.03, 0.05])]
    errors = {"length": 0.3e-3, "angle": 3e-3, "noise": 5e-5}
    scene = make_scene(seed, robot=robot, frames=frames, targets=targets, **errors)
    table = join(*(scene.fixed(25, k) for k in range(4)))
    plate = GroupDistance("0", "1", float(np.linalg.norm(spots[0] - spots[1])), 2e-5)
    known, _, _ = held_out(robot, table, Cell(distances=(plate,)))
    alone, size, result = held_out(robot, table, Cell())
    assert alone < 1.1 * known
    assert abs(size) < 1e-3
    if arm == "baxter":
        # With the hands elsewhere up to three fifths of the nominal error remain: no contact between them sees that.
        assert result.verdict.reasons[0].code == "hands_alone"
        assert result.verdict.use == "use with care"
    else:
        assert result.verdict.use == "use"


def test_frames_and_targets_grow_so_that_predictions_stay():
    rng = np.random.default_rng(5)
    derivative = rng.normal(size=(6, 3, 4))
    used = rng.uniform(size=(6, 3)) < 0.8
    of_setup = np.array([False, False, True, True])
    # What the robot's parameters change, the setup's can undo where it is measured.
    derivative[:, :, 0] = derivative[:, :, 2] - 2.0 * derivative[:, :, 3]
    derivative[~used, 0] += 5.0
    growth = np.array([0.3, 0.0, 0.0, 0.0])
    grown = _with_setup_growth(growth, derivative, used, of_setup)
    np.testing.assert_allclose(grown, [0.3, 0.0, -0.3, 0.6])
    assert growth.tolist() == [0.3, 0.0, 0.0, 0.0]
