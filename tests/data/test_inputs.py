"""A name or a path is taken for what it is, wherever a robot, a table, a cell or a result is asked for."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import calib
import calib.example
from calib.data.inputs import cell_of, chain_of, inputs_of, robot_of
from calib.errors import ArgumentError, CalibError

URDF = calib.example.paper_urdf()
TABLE = calib.example.paper_measurements()
CELL = """base = "base"
tip = "tool0"
model = "zeros"
target_mm = [-70, 70, 22.5]
"""


@pytest.fixture(scope="module")
def cell_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("cell") / "cell.toml"
    path.write_text(CELL)
    return path


@pytest.fixture(scope="module")
def result(cell_file: Path) -> calib.Calibration:
    return calib.calibrate(str(URDF), TABLE, cell=cell_file, validate=False)


def test_names_and_paths_give_what_their_values_give(cell_file: Path, result: calib.Calibration):
    robot = calib.Robot.load(URDF, "base", "tool0")
    table = calib.Measurements.read(TABLE, robot.joint_names)
    by_values = calib.calibrate(robot, table, cell=calib.Cell.read(cell_file), validate=False)
    assert result.nominal == robot
    assert np.array_equal(result.geometry.x, by_values.geometry.x)
    evaluated = calib.evaluate(URDF, str(TABLE), cell_file)
    assert np.array_equal(
        evaluated.residual, calib.evaluate(robot, table, calib.Cell.read(cell_file)).residual
    )
    inspected = calib.inspect(URDF, cell_file, TABLE)
    assert (
        inspected.observability.rank
        == calib.inspect(robot, calib.Cell.read(cell_file), table).observability.rank
    )


def test_the_table_s_joint_columns_decide_the_tip(tmp_path: Path):
    joints = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
    header = ",".join(f"{name} [deg]" for name in joints)
    (tmp_path / "three.csv").write_text(
        f"{header},x [mm],y [mm],z [mm]\n10,20,30,100,200,300\n20,30,40,100,200,300\n"
    )
    robot, table, _ = inputs_of("ur3", tmp_path / "three.csv")
    assert robot.joint_names == joints
    assert len(table) == 2
    by_values, _, _ = inputs_of("ur3", table)
    assert by_values == robot
    assert robot_of("ur3").joint_names[:3] == joints
    assert len(robot_of("ur3").joint_names) == 6


def test_a_value_is_returned_as_it_is(ur3):
    assert robot_of(ur3, calib.Cell(base="base_link")) is ur3
    cell = calib.Cell()
    assert cell_of(cell) is cell
    assert cell_of(None).target is None


def test_the_coupled_readings_are_those_of_the_cell(ur3):
    coupling = {"elbow_joint": {"shoulder_lift_joint": -1.0}}
    cell = calib.Cell(base="base", tip="tool0", coupling=coupling)
    read = robot_of(URDF, cell)
    assert read.reading_coupling == coupling
    assert robot_of(read, cell) is read
    assert robot_of(read) is read
    assert chain_of(read).coupling == cell.coupling
    assert robot_of(URDF, chain_of(read)) == read
    with pytest.raises(CalibError, match=r"couples the readings of 'elbow_joint' differently"):
        robot_of(ur3, cell)


def test_a_table_in_the_place_of_the_robot_is_named():
    with pytest.raises(CalibError, match=r"The robot comes before the table"):
        calib.calibrate(TABLE, URDF)


def test_a_wrong_type_is_named():
    with pytest.raises(ArgumentError, match="'robot' is of the type int"):
        robot_of(3)  # type: ignore[arg-type]


def test_plans_workspaces_and_scenarios_of_a_name(cell_file: Path):
    request = calib.PlanRequest(count=12, validation=0, candidates=300)
    plan = calib.plan(URDF, cell_file, request, collisions=None)
    assert (plan.robot.base, plan.robot.tip) == ("base", "tool0")
    assert calib.workspace("ur3", count=2**12).volume > 0.0
    scenario = calib.Scenario("ur3", cell_file, sizes=None)  # type: ignore[arg-type]
    assert scenario.robot.tip == "tool0"
    assert len(calib.simulate("ur3", 3, 2).measurements) == 5


def test_results_by_their_files(result: calib.Calibration, tmp_path: Path):
    file = result.write_json(tmp_path / "result.json")
    program = calib.Program.of_joints(result.fit.measurements.joints[:2])
    here = calib.compensate(result, program, accept=True)
    assert np.array_equal(calib.compensate(file, program, accept=True).q, here.q)
    urdf = result.write_urdf(tmp_path / "corrected.urdf", accept=True)
    robots = calib.compensate(urdf, program, nominal=result.nominal, accept=True)
    np.testing.assert_allclose(robots.q, here.q, atol=1e-9)
    assert calib.compare(file, result).names == ("result.json", "b")


def test_pictures_of_results_and_robots_by_their_files(result, tmp_path, monkeypatch):
    monkeypatch.setattr("webbrowser.open", lambda _url: True)
    file = result.write_json(tmp_path / "result.json")
    for shown in (str(file), "ur3", URDF):
        page = calib.view(shown)
        assert page.exists()
        shutil.rmtree(page.parent)
    page = calib.view(result.nominal, URDF)
    shutil.rmtree(page.parent)


def test_options_of_the_command_line_stand_over_the_cell(
    cell_file: Path, result: calib.Calibration
):
    frame = calib.Measurements.read(TABLE).to_frame()
    told = {"base": "base", "tip": "tool0", "target": "-70 70 22.5 mm", "model": "zeros"}
    by_words = calib.calibrate(str(URDF), frame, **told, validate=False)
    assert np.array_equal(by_words.geometry.x, result.geometry.x)
    over_cell = calib.calibrate(URDF, TABLE, cell=cell_file, frame="estimate", validate=False)
    assert over_cell.fit.cell.estimate_frame
    assert not result.fit.cell.estimate_frame
    assert "frame_x" in over_cell.model.names
    some = calib.calibrate(URDF, TABLE, cell=cell_file, frame="x,rz", validate=False)
    assert {"frame_x", "frame_rz"} == {n for n in some.model.names if n.startswith("frame")}
    robot = calib.Robot.load(URDF, "base", "tool0")
    assert (
        calib.calibrate(robot, TABLE, base="base", model="zeros", validate=False).nominal == robot
    )
    for wrong in ({"tip": "ee_link"}, {"base": 5}):
        with pytest.raises(ArgumentError):
            calib.calibrate(robot, TABLE, **wrong, validate=False)
    for wrong in ({"frame": "somewhere"}, {"target": "70 mm"}, {"base": "nowhere"}):
        with pytest.raises(CalibError):
            calib.calibrate(URDF, TABLE, **({"base": "base"} | wrong), validate=False)
