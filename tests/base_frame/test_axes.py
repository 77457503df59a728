"""DH rows of measured axes: those of calib.model.dh, with the choices of the nominal rows."""

import numpy as np
import pinocchio as pin
import pytest

from calib.base_frame.axes import Line, axis_rows, between, nominal_axes
from calib.errors import UrdfError
from calib.model.robot import Robot


def rows_of(nominal) -> np.ndarray:
    return np.asarray(nominal.rows[:-1])


def disturbed(robot: Robot, seed: int, size: float = 3e-3) -> Robot:
    rng = np.random.default_rng(seed)
    placements = robot.placements.copy()
    for i in range(1, len(placements) - 1):
        placements[i] = placements[i] @ pin.exp6(size * rng.normal(size=6)).homogeneous
    return robot.with_placements(placements)


def test_of_exact_axes_they_are_those_of_the_urdf(ur3, panda):
    for robot in (ur3, panda):
        nominal = nominal_axes(robot)
        assert axis_rows(nominal.lines, nominal) == pytest.approx(rows_of(nominal), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_of_true_axes_they_are_those_of_the_true_robot_up_to_the_choices(ur3, panda, seed):
    for robot in (ur3, panda):
        true = nominal_axes(disturbed(robot, seed))
        found = axis_rows(true.lines, nominal_axes(robot))
        assert np.abs(found - rows_of(nominal_axes(robot))).max() < 0.05
        assert axis_rows(true.lines) == pytest.approx(rows_of(true), abs=1e-9)


def test_points_may_be_anywhere_on_the_axes(ur3):
    nominal = nominal_axes(disturbed(ur3, 1))
    moved = [line._replace(point=line.point + 0.3 * line.direction) for line in nominal.lines]
    assert axis_rows(moved, nominal) == pytest.approx(axis_rows(nominal.lines, nominal), abs=1e-12)


def test_chains_that_cannot_be_swept():
    with pytest.raises(
        UrdfError, match="the joints 'torso_lift_joint' slide; a base frame needs a chain"
    ):
        nominal_axes(Robot.load("tiago", tip="arm_7_link"))
    held = Robot.load("ur3", base="base", tip="tool0", held={"elbow_joint": 0.1})
    with pytest.raises(UrdfError, match="the joints 'elbow_joint' are held or follow others"):
        nominal_axes(held)
    moving = Robot.load("ur3", base="forearm_link", tip="tool0")
    assert len(nominal_axes(moving).lines) == 3
    hand = Robot.load("ur3", base="tool0", tip="base")
    with pytest.raises(UrdfError, match="joints move the base 'tool0' itself"):
        nominal_axes(hand)


X, Y, Z = np.eye(3)


@pytest.mark.parametrize(
    ("first", "second", "angle", "distance"),
    [
        (Line(0 * X, Z), Line(0.3 * X + 7 * Z, Z), 0.0, 0.3),
        (Line(0 * X, Z), Line(0.3 * X + 7 * Z, -Z), 180.0, 0.3),
        (Line(0 * X, Z), Line(0.2 * Y + 0.1 * X, X), 90.0, 0.2),
        (Line(0 * X, Z), Line(5 * Z, X), 90.0, 0.0),
    ],
)
def test_between(first: Line, second: Line, angle: float, distance: float):
    found = between(first, second)
    assert np.degrees(found[0]) == pytest.approx(angle)
    assert found[1] == pytest.approx(distance)
