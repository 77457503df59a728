"""The virtual instrument and robot, opened by their names: what they read is the virtual cell's."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import DeviceError
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.measure.devices.controllers import joints_at_rest, open_controller
from calib.verbs.measure.devices.readers import open_reader
from calib.verbs.measure.devices.reading import Context
from calib.verbs.simulate.operator import Operator
from calib.verbs.simulate.scenario_words import read_scenario


def context(robot: Robot, cell: Cell) -> Context:
    """What a session tells its devices."""
    return Context(
        joint_names=robot.joint_names,
        joint_types=robot.joint_types,
        kind=cell.kind,
        robot=robot,
        cell=cell,
    )


@pytest.mark.parametrize("kind", ["point", "pose"])
def test_it_reads_what_the_operator_of_that_seed_measures_once_a_pose(ur3, kind):
    cell = Cell(kind=kind, estimate_frame=True)
    known = context(ur3, cell)
    reader = open_reader("virtual:3", known)
    operator = Operator.of(read_scenario(ur3, cell).draw(3), 3)
    for q in random_joint_values(ur3, 3, 1):
        reader.propose(q)
        table = reader.read(1.0).measurements(known, q)
        expected = operator.measure(q).readings
        assert table.points == pytest.approx(expected.points, rel=1e-12)
        if kind == "pose":
            assert table.rotations == pytest.approx(expected.rotations, abs=1e-12)
        assert table.joints == pytest.approx(expected.joints)
        assert reader.read(0.0) is None
    reader.close()


def test_it_reads_the_corners_of_a_picture():
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    cell = Cell(kind="pixel", estimate_frame=True)
    known = context(arm, cell)
    reader = open_reader("virtual:7", known)
    virtual = read_scenario(arm, cell).draw(7)
    q = virtual.poses(1, 1)[0]
    reader.propose(q)
    table = reader.read(1.0).measurements(known, q)
    expected = Operator.of(virtual, 7).measure(q).readings
    assert table.corners == expected.corners
    assert table.reading("u") == pytest.approx(expected.reading("u"))
    assert table.board_points == pytest.approx(expected.board_points)


def test_mistakes_are_put_right_if_the_same_pose_is_proposed_again(ur3):
    cell = Cell(estimate_frame=True)
    known = context(ur3, cell)
    reader = open_reader("virtual:1,mistakes", known)
    right = read_scenario(ur3, cell).draw(1)
    off, again_off = [], []
    for q in random_joint_values(ur3, 40, 1):
        for kept in (off, again_off):
            reader.propose(q)
            table = reader.read(1.0).measurements(known, q)
            kept.append(float(np.linalg.norm(table.points[0] - right.truth.points(q)[0])))
    assert max(off) > 10e-3
    assert max(again_off) < 10e-3  # what was knocked stays


def test_the_virtual_robot_stands_where_it_is_proposed(ur3):
    robot = open_controller("virtual", context(ur3, Cell()))
    with pytest.raises(DeviceError):
        robot.joints()
    q = random_joint_values(ur3, 1, 1)[0]
    robot.propose(q)
    assert joints_at_rest(robot) == pytest.approx(q)
    robot.close()


def test_what_the_virtual_devices_refuse(ur3):
    known = context(ur3, Cell(estimate_frame=True))
    for argument in ("x", "-1", "3,errors", "1e3"):
        with pytest.raises(DeviceError, match="virtual:3"):
            open_reader(f"virtual:{argument}", known)
    with pytest.raises(DeviceError, match="session"):
        open_reader("virtual:3", Context())
    with pytest.raises(DeviceError, match="nothing"):
        open_controller("virtual:3", known)
    with pytest.raises(DeviceError, match="pose"):
        open_reader("virtual", known).read()
