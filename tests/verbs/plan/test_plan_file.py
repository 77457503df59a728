from __future__ import annotations

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.result.calibration_file import write_table
from calib.robot.robot import Robot
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import plan
from calib.verbs.plan.plan_file import SCHEMA, plan_table, read_poses, write_plan
from calib.verbs.plan.route import Blocked
from tests.places import ROOT

CELL = Cell(target=np.array([0.05, 0.07, 0.03]), model="dh")


@pytest.fixture(scope="module")
def planned(ur3):
    """A plan of 15 poses and 3 to validate with."""
    return plan(ur3, CELL, PlanRequest(15, 3, candidates=400, ladder=True), collisions=None)


def cells(path):
    """The header and the rows of a table."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return header, rows


def fill_in(path, values):
    """Write a measurement into the first rows of a plan, one for each of the values."""
    header, rows = cells(path)
    at = [header.index(f"{axis} [mm]") for axis in "xyz"]
    for row, point in zip(rows, values, strict=False):
        for i, value in zip(at, 1e3 * point, strict=True):
            row[i] = repr(float(value))
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *rows])


def test_a_plan_is_a_table_to_fill_in(planned, ur3, tmp_path):
    path = write_plan(planned, tmp_path / "plan.csv")
    header, rows = cells(path)
    joints = [f"{name} [deg]" for name in ur3.joint_names]
    xyz = ["x [mm]", "y [mm]", "z [mm]"]
    assert header == ["row", "set", "point", *joints, *xyz, *(f"expected {a}" for a in xyz)]
    assert [row[0] for row in rows] == [str(k) for k in range(1, 19)]
    assert tuple(row[1] for row in rows) == planned.sets
    assert [row[2] for row in rows] == [f"P{k}" for k in range(1, 19)]
    assert all(row[9:12] == ["", "", ""] for row in rows)
    with pytest.raises(MeasurementError, match=r"nothing is measured yet in its 18 rows"):
        Measurements.read(path, ur3.joint_names)
    fill_in(path, planned.expected[:, 0] + 1e-5)
    table = Measurements.read(path, ur3.joint_names, ur3.joint_types)
    # What the robot is sent is what the fit reads, to the last digit.
    np.testing.assert_allclose(table.joints, planned.joints, rtol=1e-15, atol=1e-16)
    np.testing.assert_allclose(table.points, planned.expected[:, 0] + 1e-5, rtol=1e-12)
    assert (table.sets, table.ignored, table.unmeasured) == (planned.sets, (), ())


def test_several_targets_have_a_row_each(ur3, tmp_path):
    targets = {"left": np.array([0.05, 0.0, 0.03]), "right": np.array([-0.05, 0.0, 0.03])}
    made = plan(
        ur3,
        replace(CELL, target=None, targets=targets),
        PlanRequest(12, 2, candidates=300, ladder=False),
        collisions=None,
    )
    path = write_plan(made, tmp_path / "plan.csv", first_row=101)
    header, rows = cells(path)
    assert header[:4] == ["row", "set", "point", "target"]
    assert [row[3] for row in rows] == ["left", "right"] * 14
    assert [row[2] for row in rows] == [f"P{k}" for k in range(101, 129)]
    assert rows[0][4:10] == rows[1][4:10]
    assert rows[0][13:] != rows[1][13:]
    taken = read_poses(path, ur3, taken=True)
    np.testing.assert_allclose(taken.joints, made.estimation, rtol=1e-15)
    assert taken.last_row == 128


# Poses that were taken


def test_what_is_measured_counts_as_taken(planned, ur3, paper_table, tmp_path):
    path = write_plan(planned, tmp_path / "plan.csv")
    still = read_poses(path, ur3, taken=True)  # still to be driven: all of it counts
    np.testing.assert_allclose(still.joints, planned.estimation, rtol=1e-15)
    assert still.last_row == 18
    fill_in(path, planned.expected[:7, 0])
    half = read_poses(path, ur3, taken=True)
    fitted = [i for i in range(7) if planned.sets[i] == "estimate"]
    np.testing.assert_allclose(half.joints, planned.joints[fitted], rtol=1e-15)
    paper_table.write(tmp_path / "paper.csv")
    paper = read_poses(tmp_path / "paper.csv", ur3, taken=True)
    np.testing.assert_allclose(paper.joints, paper_table.joints[:30], rtol=1e-14)
    assert paper.last_row == 35


@pytest.fixture
def table(tmp_path):
    """Writes a table's lines to a file and gives its path."""

    def write(*lines):
        path = tmp_path / "taken.csv"
        path.write_text("\n".join([*lines, ""]), encoding="utf-8")
        return path

    return write


@pytest.fixture
def arm(serial_urdf):
    return Robot.from_urdf(serial_urdf([("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1))]))


def degrees(taken):
    return np.degrees(taken.joints[:, 0]).round(9).tolist()


def test_tables_of_every_kind_count(table, arm):
    bare = table("j1 [deg]", "1")
    assert degrees(read_poses(bare, arm, taken=True)) == [1.0]
    pairs = table("j1 [deg],distance [mm],pair", "1,,p", "2,500,p", "3,,q", "4,501,q")
    assert degrees(read_poses(pairs, arm, taken=True)) == [1.0, 2.0, 3.0, 4.0]
    mixed = table(
        "kind,j1 [deg],x [mm],y [mm],z [mm],group", "fixed,1,,,,A", "fixed,2,,,,A", "point,3,,,,",
        "point,4,1,2,300,",
    )  # fmt: skip
    taken = read_poses(mixed, arm, taken=True)
    assert degrees(taken) == [1.0, 2.0, 4.0]


# The forecast


def test_the_forecast_as_json(planned, tmp_path):
    path = write_table(plan_table(planned), tmp_path / "plan.json")
    table = json.loads(path.read_text(encoding="utf-8"))
    assert table["schema"] == SCHEMA == "plan 2"
    f = planned.forecast
    assert table["forecast"]["rms_m"] == f.rms
    assert table["forecast"]["parameters"][0] == {
        "name": f.names[0], "unit": f.units[0], "std": f.parameter_std[0], "identifiable": bool(f.identifiable[0]),
    }  # fmt: skip
    steps = {step["planned"]: step["rms_m"] for step in table["ladder"]}
    assert steps[15] == f.rms < table["at_random"]["rms_m"]
    assert steps[20] < f.rms
    assert table["before"] is None
    assert table["candidates"] == {"drawn": planned.drawn, "kept": 400, "refused": {}}
    assert len(table["poses"]) == 18
    assert table["poses"][3]["joints"] == planned.joints[3].tolist()
    assert table["poses"][3]["expected_xyz_m"] == planned.expected[3].tolist()
    assert table["travel"] == {"largest_joint_moves": planned.travel, "blocked": []}


def keys(value):
    """Every key of nested tables; the reasons of refusals, and units, are no keys."""
    if isinstance(value, dict):
        for name, entry in value.items():
            yield name
            yield from () if name in ("refused", "sigma") else keys(entry)
    elif isinstance(value, list):
        for entry in value:
            yield from keys(entry)


def test_the_document_has_every_key(planned):
    coupling = {"elbow_joint": {"shoulder_lift_joint": -1.0}}
    robot = Robot.from_urdf(planned.robot.urdf, "base", "tool0", coupling=coupling)
    blocked = replace(planned, blocked=(Blocked(1, 2, None),), robot=robot)
    stored = plan_table(blocked)["robot"]["coupling"]
    assert stored == [{"joint": "elbow_joint", "reading": "shoulder_lift_joint", "factor": -1.0}]
    lines = (ROOT / "docs" / "planning.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", lines.partition("## The plan as JSON")[2], re.MULTILINE)
    documented = set(re.findall(r"[A-Za-z0-9_]+", " ".join(rows))) | {"schema"}
    assert documented == set(keys(plan_table(blocked)))


# Poses alone

HEADER = (
    "set,target,shoulder_pan_joint [deg],shoulder_lift_joint [deg],elbow_joint [deg],"
    "wrist_1_joint [deg],wrist_2_joint [deg],wrist_3_joint [deg],x [mm],y [mm],z [mm]"
)


def test_targets_of_one_pose_are_one_pose_and_repeats_are_several(ur3, tmp_path):
    path = tmp_path / "table.csv"
    one, other = "1,2,3,4,5,6,9,9,9", "1,2,3,4,5,7,9,9,9"
    lines = [f"estimate,a,{one}", f"estimate,b,{one}", f"estimate,a,{one}", f"validate,b,{other}"]
    path.write_text("\n".join([HEADER, *lines, ""]))
    poses = read_poses(path, ur3)
    assert len(poses.joints) == 3
    assert poses.sets == ("estimate", "estimate", "validate")
