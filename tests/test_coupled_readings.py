"""Coupled joint readings all the way: planned, simulated, calibrated, stored, evaluated and compensated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.data.cell import Cell, TrackerNoise
from calib.data.measurements import Measurements
from calib.errors import CalibError, ModelError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.result.calibration_file import read_result
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.robot_program import Program
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import plan
from calib.verbs.simulate.scenario import Scenario, Simulated, simulate
from tests.parts import of_an_earlier_version

ELBOW, LIFT, WRIST_1, WRIST_2 = (
    "elbow_joint",
    "shoulder_lift_joint",
    "wrist_1_joint",
    "wrist_2_joint",
)

#: A palletiser's forearm, and a wrist with gears.
COUPLING = {ELBOW: {LIFT: -1.0}, WRIST_2: {WRIST_1: 0.025}}

CELL = Cell(
    base="base", tip="tool0", target=np.array([0.05, 0.02, 0.1]), model="dh", coupling=COUPLING
)
NOISE = TrackerNoise(2e-5, 0.0, 0.0)


@pytest.fixture(scope="module")
def coupled() -> Robot:
    return Robot.load(calib.example.paper_urdf(), "base", "tool0", coupling=COUPLING)


@pytest.fixture(scope="module")
def simulated(coupled: Robot) -> Simulated:
    scenario = Scenario(coupled, cell=CELL, model="dh", noise=NOISE)
    return simulate(scenario, 35, 10, seed=3)


@pytest.fixture(scope="module")
def table(simulated: Simulated) -> Measurements:
    return simulated.measurements


@pytest.fixture(scope="module")
def result(coupled: Robot, table: Measurements) -> Calibration:
    return calibrate(coupled, table, cell=CELL)


def test_the_truth_of_a_simulation_is_at_the_joint_values(ur3: Robot, simulated: Simulated):
    """Poses by the uncoupled true robot at the angles that the readings mean, sum by sum."""
    true, q = simulated.truth.robot, simulated.measurements.joints
    values = q.copy()
    values[:, 2] -= q[:, 1]
    values[:, 4] += 0.025 * q[:, 3]
    uncoupled = ur3.rebuilt(true.urdf)
    T = uncoupled.poses(values) @ simulated.truth.T_tip_target[0]
    np.testing.assert_allclose(T[:, :3, 3], simulated.points, rtol=0, atol=1e-12)
    low, high = column_limits(ur3).T
    assert ((values >= low) & (values <= high)).all()
    # The readings are not within: no box holds them.
    assert (q[:, 2] > high[2]).any()


def test_a_calibration_finds_the_truth(result: Calibration, simulated: Simulated):
    assert result.verdict is not None
    assert result.verdict.use != "do not use"
    q = random_joint_values(result.nominal, 200, 4)
    true = simulated.truth.robot.poses(q) @ simulated.truth.T_tip_target[0]
    nominal = result.nominal.poses(q) @ simulated.truth.T_tip_target[0]
    before = np.linalg.norm((nominal - true)[:, :3, 3], axis=1)
    after = np.linalg.norm(result.predict(q) - true[:, :3, 3], axis=1)
    assert before.mean() > 1e-3
    assert after.mean() < 1e-4
    # Nothing but the URDF and its coupling is needed for that.
    np.testing.assert_allclose(
        result.robot.poses(q) @ result.setup.T_tip_target[0],
        result.predict_poses(q, non_geometric=False),
        rtol=0,
        atol=1e-12,
    )


def test_without_the_coupling_the_verdict_is_against_it(ur3: Robot):
    cell = Cell(target=CELL.target)
    one = Robot.load(calib.example.paper_urdf(), "base", "tool0", coupling={ELBOW: COUPLING[ELBOW]})
    scenario = Scenario(one, cell=cell, model="dh", noise=NOISE)
    table = scenario.draw(3).measure(scenario.random_poses(20, 3), 3).measurements
    verdict = calibrate(ur3, table, cell=cell).verdict
    assert verdict is not None
    assert verdict.use == "do not use"
    reason = verdict.reasons[0]
    assert reason.code == "readings_coupled"
    assert (reason.values["joint"], reason.values["reading"]) == (ELBOW, LIFT)
    assert reason.values["factor"] == -1.0


def test_a_result_keeps_the_coupling(result: Calibration, coupled: Robot, tmp_path: Path):
    read = read_result(result.write_json(tmp_path / "result.json"))
    assert read.nominal == coupled
    assert read.robot.reading_coupling == COUPLING
    q = random_joint_values(coupled, 20, 5)
    np.testing.assert_array_equal(read.predict(q), result.predict(q))


def test_a_file_of_an_earlier_version_has_no_coupling(ur3: Robot, tmp_path: Path):
    table = calib.Measurements.read(calib.example.paper_measurements(), ur3.joint_names)
    made = calibrate(ur3, table, model="zeros", validate=False)
    path = made.write_json(tmp_path / "result.json")
    stored = of_an_earlier_version(json.loads(path.read_text(encoding="utf-8")))
    assert stored["robot"].pop("coupling") == []
    path.write_text(json.dumps(stored), encoding="utf-8")
    assert read_result(path).nominal == ur3


def test_a_robot_with_another_coupling_is_refused(
    result: Calibration, ur3: Robot, coupled: Robot, table: Measurements
):
    with pytest.raises(ModelError, match=r"coupled by \{\}, those of the robot that it"):
        result.corrected(ur3)
    with pytest.raises(ModelError, match="are coupled by"):
        compensate(result, Program.of_joints(table.joints[:2]), nominal=ur3)
    with pytest.raises(ModelError, match="are coupled by"):
        compensate(coupled, Program.of_joints(table.joints[:2]), nominal=ur3)
    with pytest.raises(CalibError, match="The cell couples the readings of 'elbow_joint'"):
        calibrate(ur3, table, cell=CELL)
    # One that is read has that of the result.
    made = compensate(
        result, Program.of_joints(table.joints[:2]), nominal=calib.example.paper_urdf()
    )
    assert made.nominal.reading_coupling == COUPLING


@pytest.mark.parametrize("model", ["dh", "dh+gain+eccentricity"])
def test_commands_bring_the_true_robot_to_its_targets(coupled: Robot, model: str):
    scenario = Scenario(coupled, cell=CELL, model=model, noise=None)
    cell = scenario.draw(5)
    table = cell.measure(scenario.random_poses(40, 5), 5).measurements
    found = calibrate(coupled, table, cell=CELL, model=model, validate=False)
    q = random_joint_values(coupled, 60, 6)
    commands = compensate(found, Program.of_joints(q), tool="target")
    reached = commands.reached
    assert reached.mean() > 0.7
    wanted = commands.T_wanted[reached, :3, 3]
    arrived = cell.truth.points(commands.q[reached])
    without = cell.truth.points(q[reached])
    assert np.linalg.norm(without - wanted, axis=1).mean() > 1e-3
    assert np.linalg.norm(arrived - wanted, axis=1).max() < 1e-6
    low, high = column_limits(coupled).T
    values = coupled.input_values(commands.q[reached])
    assert ((values >= low - 1e-9) & (values <= high + 1e-9)).all()
    # A command that would take a joint beyond its limit names the joint, at its value and not at its reading.
    beyond = [r for r in commands.reasons if r is not None and r.code == "beyond limit"]
    for reason in beyond:
        column = coupled.joint_names.index(reason.joint)
        assert reason.values[1] in (low[column], high[column])


def test_positions_keep_a_redundant_arm_within_the_limits_of_its_joints(coupled: Robot):
    """Six joints for three numbers: the search works on joint values, whose limits are a box."""
    q = random_joint_values(coupled, 40, 8)
    points = coupled.poses(q)[:, :3, 3]
    low, high = column_limits(coupled).T
    for program in (Program.of_points(points, q), Program.of_points(points[:8])):
        commands = compensate(coupled, program, nominal=coupled)
        assert commands.reached.all()
        arrived = coupled.poses(commands.q)[:, :3, 3]
        np.testing.assert_allclose(arrived, points[: len(arrived)], rtol=0, atol=1e-8)
        values = coupled.input_values(commands.q)
        assert ((values >= low - 1e-9) & (values <= high + 1e-9)).all()


def test_a_plan_s_readings_keep_the_joints_within_limits_and_ranges(coupled: Robot, ur3: Robot):
    cell = Cell(target=CELL.target, model="zeros", ranges={ELBOW: (-1.0, 0.5)})
    made = plan(coupled, cell, PlanRequest(10, 3, candidates=200, margin=0.0), collisions=None)
    degrees = np.degrees(made.joints)
    np.testing.assert_allclose(degrees, np.round(degrees, 3), rtol=0, atol=1e-9)
    values = coupled.input_values(made.joints)
    low, high = column_limits(ur3).T
    assert ((values >= low) & (values <= high)).all()
    assert ((values[:, 2] >= -1.0) & (values[:, 2] <= 0.5)).all()
    assert np.ptp(values[:, 2]) > 0.5
    assert (np.abs(made.joints[:, 2]) > 1.0).any()
