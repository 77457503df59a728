"""The table of images: its columns, its names, and that others read it."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.robot.robot import Robot
from calib.verbs.plan.plan_file import (
    distances_and_tilts,
    image_name,
    next_number,
    plan_table,
    read_poses,
    write_plan,
)
from tests.instruments.scenes import BOARD, standing
from tests.verbs.plan.test_images import planned


@pytest.fixture
def rows(tmp_path):
    path = write_plan(planned(), tmp_path / "plan.csv", first_row=4)
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_row_is_an_image_with_its_name(rows):
    assert len(rows) == 14
    assert [row["image"] for row in rows[:2]] == ["image_004.png", "image_005.png"]
    # A table of corners keeps the columns, and has many rows of an image: none of them is numbered.
    assert "row" not in rows[0]
    assert tuple(row["set"] for row in rows) == planned().sets
    assert image_name(1234) == "image_1234.png"


def test_joints_are_listed_from_the_foot_to_the_hand(rows):
    headers = list(rows[0])
    assert headers[2] == "shoulder_pan_joint [deg]"
    assert headers[7] == "wrist_3_joint [deg]"
    # The chain itself leads from the hand to the foot.
    assert planned().robot.joint_names[0] == "wrist_3_joint"
    for row, q in zip(rows, planned().joints, strict=True):
        assert float(row["wrist_3_joint [deg]"]) == pytest.approx(np.degrees(q[0]), abs=1e-9)
        assert float(row["shoulder_pan_joint [deg]"]) == pytest.approx(np.degrees(q[5]), abs=1e-9)


def test_a_chain_from_foot_to_hand_stays_as_it_is(tmp_path):
    path = write_plan(planned(standing), tmp_path / "plan.csv")
    assert path.read_text(encoding="utf-8").startswith("set,image,shoulder_pan_joint [deg]")


def test_the_board_is_expected_where_the_nominal_robot_has_it(rows):
    distances, tilts = distances_and_tilts(planned().instrument, planned())
    for row, distance, tilt in zip(rows, distances, tilts, strict=True):
        assert float(row["expected distance [mm]"]) == pytest.approx(1e3 * distance, abs=0.051)
        assert float(row["expected tilt [deg]"]) == pytest.approx(np.degrees(tilt), abs=0.051)


def test_the_poses_are_read_back(tmp_path):
    plan = planned()
    path = write_plan(plan, tmp_path / "plan.csv")
    poses = read_poses(path, plan.robot)
    np.testing.assert_array_equal(poses.joints, plan.joints)
    assert poses.sets == plan.sets
    # And by the chain the other way round, as of other instruments.
    forwards = Robot.load("ur5", base="base_link", tip="tool0")
    np.testing.assert_array_equal(read_poses(path, forwards).joints, plan.joints[:, ::-1])


def test_the_detection_of_corners_finds_the_images(tmp_path):
    matching = pytest.importorskip("calib.verbs.detect.matching")
    path = write_plan(planned(), tmp_path / "plan.csv")
    table = matching.read_joint_table(path)
    assert table.image is not None
    assert "image_003.png" in table.table.column(table.image)
    assert len(table.kept) == 1 + 6 + 2


def test_a_table_of_corners_is_read_and_its_images_counted(tmp_path):
    """As detection writes it: the plan's columns, and those of corners behind them."""
    plan = planned()
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
    assert next_number(planned().instrument, read_poses(table, arm)) == 1


def test_the_plan_as_tables_has_the_tilt():
    plan = planned()
    table = plan_table(plan)
    _, tilts = distances_and_tilts(plan.instrument, plan)
    assert [pose["tilt_rad"] for pose in table["poses"]] == pytest.approx(tilts)
    assert table["asked"]["kind"] == "pixel"
