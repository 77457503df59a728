"""Robots as rows state them: coupled readings, and rows that make none."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from calib.errors import ModelError
from calib.robot.dh.description import DHRobot
from calib.robot.dh.rows import DHRow, DHTable

ROWS = (DHRow("j1", d=0.3, alpha=1.0), DHRow("j2", a=0.4, direction=-1), DHRow("j3", a=0.2))


def robot_of(*rows: DHRow, convention="standard", **more) -> DHRobot:
    return DHRobot(DHTable(rows, np.eye(4), np.eye(4), convention), **more)


def test_values_of_coupled_readings():
    robot = robot_of(*ROWS, coupling={"j3": {"j2": -1.0, "j1": 0.5}})
    readings = np.array([[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]])
    np.testing.assert_allclose(robot.values(readings), [[0.1, 0.2, 0.15], [1.0, 2.0, 1.5]])
    np.testing.assert_allclose(
        robot.poses(readings), robot.table.poses([[0.1, 0.2, 0.15], [1.0, 2.0, 1.5]]), atol=1e-15
    )
    again = copy.deepcopy(robot)
    assert again.coupling == robot.coupling
    with pytest.raises(TypeError):
        robot.coupling["j3"]["j2"] = 2.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("rows", "more", "says"),
    [
        ((), {}, "no DH rows"),
        (ROWS, {"convention": "denavit"}, "'denavit' is not a convention"),
        ((DHRow("j", beta=0.1),), {}, "only 'hayati' has"),
        ((DHRow("j", direction=2),), {}, "direction 2"),
        ((DHRow("j", prismatic=True),), {}, "no limits"),
        ((DHRow("j", lower=1.0),), {}, "one limit"),
        ((DHRow("j", lower=1.0, upper=-1.0),), {}, "lower must be less"),
        ((DHRow("j", theta=np.nan),), {}, "not finite"),
        ((DHRow("j"), DHRow("j")), {}, "another row has"),
        ((DHRow(""),), {}, "has no name"),
        (ROWS, {"coupling": {"j3": {"j9": 1.0}}}, "'j9', which is not a joint"),
        (ROWS, {"coupling": {"j9": {"j3": 1.0}}}, "'j9', which is not a joint"),
        (ROWS, {"coupling": {"j3": {"j3": 1.0}}}, "the joint itself"),
        (ROWS, {"coupling": {"j3": {"j2": np.inf}}}, "not finite"),
        (ROWS, {"base": "link_2"}, "there twice"),
        (ROWS, {"tip": ""}, "is empty"),
    ],
)
def test_what_is_no_robot(rows, more, says):
    with pytest.raises(ModelError, match=says):
        robot_of(*rows, **more)
