"""Plans as files, and poses of tables: columns, names, and that others read them."""

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
from calib.verbs.plan.plan_file import (
    SCHEMA,
    distances_and_tilts,
    image_name,
    next_number,
    plan_table,
    read_poses,
    write_plan,
)
from calib.verbs.plan.route import Blocked
from tests.instruments.scenes import BOARD, standing
from tests.places import ROOT
from tests.verbs.plan import test_images

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


@pytest.fixture(scope="module")
def from_both_sides(ur3):
    request = PlanRequest(15, 3, candidates=400, ladder=False, approach="both")
    return plan(ur3, CELL, request, collisions=None)


def test_a_pose_to_come_from_has_a_row_of_its_own(from_both_sides, ur3, tmp_path):
    made = from_both_sides
    path = write_plan(made, tmp_path / "plan.csv")
    header, rows = cells(path)
    assert header[:4] == ["row", "set", "point", "approach"]
    assert [row[0] for row in rows] == [str(k) for k in range(1, 2 * 36 + 1)]
    assert [row[1] for row in rows[::2]] == ["via"] * 36
    assert {cell for row in rows[::2] for cell in (*row[2:4], *row[10:])} == {""}
    assert [row[2] for row in rows[1::2]] == [f"P{k}" for k in range(2, 74, 2)]
    assert [row[3] for row in rows[1::2]] == ["rising", "falling"] * 18
    before = np.array([row[4:10] for row in rows[::2]], dtype=float)
    np.testing.assert_allclose(before, np.degrees(made.via), atol=1e-9)

    # What is measured at the other rows is read with the moves by which the joints arrived.
    xyz = [header.index(f"{axis} [mm]") for axis in "xyz"]
    for row, place in zip(rows[1::2], made.expected[:, 0], strict=True):
        for i, value in zip(xyz, 1e3 * place, strict=True):
            row[i] = repr(float(value))
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    table = Measurements.read(path, ur3.joint_names, ur3.joint_types)
    assert (table.sets, table.unmeasured) == (made.sets, ())
    assert table.approaches == ("rising", "falling") * 18
    # Where joints stay between two rows, they keep their move; here all move.
    np.testing.assert_allclose(table.moves, made.moves, atol=1e-12)
    assert plan_table(made)["poses"][4]["via"].tolist() == made.via[4].tolist()


def test_poses_that_are_driven_through_are_not_taken(from_both_sides, planned, ur3, tmp_path):
    path = write_plan(from_both_sides, tmp_path / "plan.csv")
    poses = read_poses(path, ur3)
    np.testing.assert_allclose(poses.joints, from_both_sides.joints, rtol=1e-15)
    np.testing.assert_allclose(poses.moves, from_both_sides.moves, atol=1e-12)
    assert (poses.sets, poses.last_row) == (from_both_sides.sets, 72)
    taken = read_poses(path, ur3, taken=True)
    np.testing.assert_allclose(taken.joints, from_both_sides.estimation, rtol=1e-15)
    np.testing.assert_allclose(
        taken.moves, from_both_sides.moves[np.array(taken_sets(from_both_sides))], atol=1e-12
    )
    assert read_poses(write_plan(planned, tmp_path / "straight.csv"), ur3).moves is None


def taken_sets(plan):
    """Whether each pose of a plan is one to fit."""
    return [name == "estimate" for name in plan.sets]


def test_moves_that_a_table_states_are_read(table, arm):
    stated = read_poses(table("j1 [deg],j1.move [deg]", "1,5", "2,-5", "3,5"), arm)
    np.testing.assert_allclose(np.degrees(stated.moves[:, 0]), [5.0, -5.0, 5.0], rtol=1e-12)
    as_driven = read_poses(table("j1 [deg],j1.move [deg]", "1,0", "2,1", "3,1"), arm)
    assert as_driven.moves is None


def test_rows_are_numbered_after_the_last_one_of_the_table_measured_or_not(table, arm):
    through = table("row,set,j1 [deg],x [mm],y [mm],z [mm]", "4,estimate,1,1,2,3", "5,via,2,,,")
    assert read_poses(through, arm, taken=True).last_row == 5


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
    listed = table("point,j1 [deg]", "P1,1", ",2", "P3,3")  # the list has the points
    assert degrees(read_poses(listed, arm, taken=True)) == [1.0, 3.0]


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
    request = replace(planned.request, approach="one")
    blocked = replace(planned, blocked=(Blocked(1, 2, None),), robot=robot, request=request)
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


# Images


@pytest.fixture
def rows(tmp_path):
    path = write_plan(test_images.planned(), tmp_path / "plan.csv", first_row=4)
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_row_is_an_image_with_its_name(rows):
    assert len(rows) == 14
    assert [row["image"] for row in rows[:2]] == ["image_004.png", "image_005.png"]
    # A table of corners keeps the columns, and has many rows of an image: none of them is numbered.
    assert "row" not in rows[0]
    assert tuple(row["set"] for row in rows) == test_images.planned().sets
    assert image_name(1234) == "image_1234.png"


def test_joints_are_listed_from_the_foot_to_the_hand(rows):
    headers = list(rows[0])
    assert headers[2] == "shoulder_pan_joint [deg]"
    assert headers[7] == "wrist_3_joint [deg]"
    # The chain itself leads from the hand to the foot.
    assert test_images.planned().robot.joint_names[0] == "wrist_3_joint"
    for row, q in zip(rows, test_images.planned().joints, strict=True):
        assert float(row["wrist_3_joint [deg]"]) == pytest.approx(np.degrees(q[0]), abs=1e-9)
        assert float(row["shoulder_pan_joint [deg]"]) == pytest.approx(np.degrees(q[5]), abs=1e-9)


def test_a_chain_from_foot_to_hand_stays_as_it_is(tmp_path):
    path = write_plan(test_images.planned(standing), tmp_path / "plan.csv")
    assert path.read_text(encoding="utf-8").startswith("set,image,shoulder_pan_joint [deg]")


def test_the_board_is_expected_where_the_nominal_robot_has_it(rows):
    distances, tilts = distances_and_tilts(test_images.planned().instrument, test_images.planned())
    for row, distance, tilt in zip(rows, distances, tilts, strict=True):
        assert float(row["expected distance [mm]"]) == pytest.approx(1e3 * distance, abs=0.051)
        assert float(row["expected tilt [deg]"]) == pytest.approx(np.degrees(tilt), abs=0.051)


def test_the_poses_are_read_back(tmp_path):
    plan = test_images.planned()
    path = write_plan(plan, tmp_path / "plan.csv")
    poses = read_poses(path, plan.robot)
    np.testing.assert_array_equal(poses.joints, plan.joints)
    assert poses.sets == plan.sets
    # And by the chain the other way round, as of other instruments.
    forwards = Robot.load("ur5", base="base_link", tip="tool0")
    np.testing.assert_array_equal(read_poses(path, forwards).joints, plan.joints[:, ::-1])


def test_the_detection_of_corners_finds_the_images(tmp_path):
    matching = pytest.importorskip("calib.verbs.detect.matching")
    path = write_plan(test_images.planned(), tmp_path / "plan.csv")
    table = matching.read_joint_table(path)
    assert table.image is not None
    assert "image_003.png" in table.table.column(table.image)
    assert len(table.kept) == 1 + 6 + 2


def test_a_table_of_corners_is_read_and_its_images_counted(tmp_path):
    """As detection writes it: the plan's columns, and those of corners behind them."""
    plan = test_images.planned()
    path = write_plan(plan, tmp_path / "plan.csv", first_row=7)
    with path.open(newline="", encoding="utf-8") as stream:
        header, *rows = csv.reader(stream)
    of_corner = ["corner", "board_x [m]", "board_y [m]", "board_z [m]", "u [px]", "v [px]", "kind"]
    table = [[*header, *of_corner]]
    for row in rows:
        for k, point in enumerate(BOARD.corners[:10]):
            table.append([*row, k, *point, 100 + k, 200, "pixel"])
    corners = tmp_path / "corners.csv"
    with corners.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(table)
    measured = Measurements.read(corners, plan.robot.joint_names)
    assert len(measured) == 140
    assert len(set(measured.images)) == 14
    taken = read_poses(corners, plan.robot, taken=True)
    assert len(plan.instrument.stops(taken.joints)) == plan.sets.count("estimate")
    assert next_number(plan.instrument, taken) == 21
    assert next_number(plan.instrument, read_poses(path, plan.robot)) == 21


@pytest.mark.parametrize("lines", ["image,j1 [deg]\nleft.png,1\n", "j1 [deg]\n1\n"])
def test_images_without_numbers_begin_with_one(tmp_path, serial_urdf, lines):
    arm = Robot.from_urdf(serial_urdf([("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1))]))
    table = tmp_path / "table.csv"
    table.write_text(lines, encoding="utf-8")
    assert next_number(test_images.planned().instrument, read_poses(table, arm)) == 1


def test_the_plan_as_tables_has_the_tilt():
    plan = test_images.planned()
    table = plan_table(plan)
    _, tilts = distances_and_tilts(plan.instrument, plan)
    assert [pose["tilt_rad"] for pose in table["poses"]] == pytest.approx(tilts)
    assert table["asked"]["kind"] == "pixel"
