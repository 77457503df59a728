"""An inspection as text: DH rows, ranks and forecasts are those of the objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.dh_table import dh_table
from calib.robot.robot import Robot
from calib.verbs.inspect.inspection import Inspection, inspect as inspect_robot
from calib.verbs.inspect.text import inspection_text
from calib.verbs.plan.forecast import Forecast
from calib.verbs.plan.plan import PlanRequest, plan


@pytest.fixture(scope="module")
def inspection(ur3: Robot, table: Measurements) -> Inspection:
    return inspect_robot(ur3, Cell(model="dh"), table)


@pytest.fixture(scope="module")
def forecast(ur3: Robot) -> Forecast:
    cell = Cell(model="zeros", target=np.array([0.05, 0.07, 0.03]))
    return plan(ur3, cell, PlanRequest(8, 0, candidates=50), collisions=None).forecast


def test_the_dh_rows_are_those_of_the_robot(ur3: Robot, inspection: Inspection):
    lines = inspection_text(ur3, inspection).splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("Standard DH rows"))
    for line, row in zip(lines[start + 2 :], dh_table(ur3).rows, strict=False):
        name, *cells = line.split()
        assert name == row.joint
        expected = [1e3 * row.a, np.degrees(row.alpha), 1e3 * row.d, np.degrees(row.theta)]
        assert [float(cell) for cell in cells[:4]] == pytest.approx(expected, abs=5.01e-5)
        assert (cells[4] == "-") == (not row.near_parallel)


def test_the_joints_and_their_limits(ur3: Robot, inspection: Inspection):
    lines = inspection_text(ur3, inspection).splitlines()
    assert lines[1].split() == ["joint", "type", "axis", "limits"]
    for line, joint in zip(lines[2:], ur3.joints, strict=False):
        name, kind, *axis_and_limits = line.split()
        assert (name, kind) == (joint.name, joint.type)
        assert [float(v) for v in axis_and_limits[:3]] == pytest.approx(joint.axis)
        low, _, high, unit = axis_and_limits[3:]
        assert [float(low), float(high)] == pytest.approx(
            np.degrees([joint.lower, joint.upper]), abs=0.051
        )
        assert unit == "deg"


def test_joints_without_a_column_are_explained():
    held = Robot.load("urdf/ur3.urdf", base="base", tip="tool0", held={"elbow_joint": 0.5})
    text = inspection_text(held, inspect_robot(held, Cell(model="zeros"), None))
    assert "  'elbow_joint' is held at 28.6479 deg." in text.splitlines()


def test_parameters_and_rank(ur3: Robot, inspection: Inspection):
    text = " ".join(inspection_text(ur3, inspection).split())
    o = inspection.observability
    assert f"rank {o.rank} of {o.columns}, condition {o.condition:.1f}" in text
    assert f"({len(inspection.model.names)}, * known in combination" in text
    for name, alone in zip(inspection.model.names, o.identifiable, strict=True):
        assert (f" {name}*" in text) == (not alone)


def test_a_forecast(ur3: Robot, inspection: Inspection, forecast: Forecast):
    text = " ".join(inspection_text(ur3, inspection, forecast).split())
    values = (forecast.sigma["m"], forecast.rms, forecast.rms_low, forecast.rms_high, forecast.max)
    for value in values:
        assert f"{1e3 * value:.3f}" in text
    best = 1e3 * forecast.sigma["m"] * np.sqrt(forecast.workspace_rank / forecast.poses)
    assert f"about {best:.3f} mm rms" in text


def test_lines_are_of_100_columns(ur3: Robot, inspection: Inspection, forecast: Forecast):
    assert max(map(len, inspection_text(ur3, inspection, forecast).splitlines())) <= 100
    assumed = replace(inspection, source=None, assumed=("target",))
    assert "poses spread over the joint limits, target " in " ".join(
        inspection_text(ur3, assumed).split()
    )


def test_coupled_readings_are_told(ur3: Robot):
    coupling = {"elbow_joint": {"shoulder_lift_joint": 1.0}}
    robot = Robot.from_urdf(ur3.urdf, ur3.base, ur3.tip, coupling=coupling)
    said = " ".join(inspection_text(robot, inspect_robot(robot, Cell(model="zeros"), None)).split())
    assert "'elbow_joint' is at its reading plus that of 'shoulder_lift_joint'." in said
    assert "follows" not in said


def test_the_joints_of_all_chains_are_listed_without_dh_rows():
    tips = {"left": "arm_left_7_link", "right": "arm_right_7_link"}
    cell = Cell(estimate_frame=True, tips=tips)
    robot = Robot.load("tiago_dual", base="base_footprint", tip=tips["left"])
    both = Robot.from_urdf(
        robot.urdf, robot.base, robot.tip, branches=[("base_footprint", tips["right"])]
    )
    lines = inspection_text(both, inspect_robot(both, cell, None)).splitlines()
    assert " ".join(lines[:2]).count("base_footprint to ") == 2
    names = [line.split()[0] for line in lines if " revolute " in line or " prismatic " in line]
    arms = [f"arm_{hand}_{k}_joint" for hand in ("left", "right") for k in range(1, 8)]
    assert names == ["torso_lift_joint", *arms]
    assert not any(line.startswith("Standard DH rows") for line in lines)
    held = Robot.from_urdf(
        robot.urdf,
        robot.base,
        robot.tip,
        branches=[("base_footprint", tips["right"])],
        held={"torso_lift_joint": 0.1, "arm_right_2_joint": 0.2},
    )
    text = inspection_text(held, inspect_robot(held, cell, None))
    assert text.count("'torso_lift_joint' is held at 100 mm.") == 1
    assert "'arm_right_2_joint' is held at 11.4592 deg." in text
