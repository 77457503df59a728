"""DH rows as JSON: a robot comes back as it was, and what is damaged is named."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from calib.errors import ModelError
from calib.robot.dh_json import robot_json, robot_of_json
from calib.robot.dh_rows import DHRobot, DHRow, DHTable

ROWS = (
    DHRow("j1", False, 0.1, 0.2, 0.3, 0.4, 0.05, -1, 0.5, -1.0, 2.0),
    DHRow("j2", True, 0.1, 0.2, 0.3, 0.4, 0.0, 1, 0.05, -0.1, 0.2),
    DHRow("j3"),
)
T = np.diag([-1.0, -1.0, 1.0, 1.0])
COUPLING = {"j1": {"j3": 0.25}, "j3": {"j1": -1.0}}


def test_a_robot_comes_back():
    robot = DHRobot(DHTable(ROWS, T, np.eye(4), "hayati"), "arm", "b", "t", COUPLING)
    content = json.loads(json.dumps(robot_json(robot)))
    again = robot_of_json(content, "x.json")
    assert again.table.rows == ROWS
    assert again.coupling == COUPLING
    assert (again.name, again.base, again.tip) == ("arm", "b", "t")
    np.testing.assert_array_equal(again.table.T_base_0, T)
    joint = content["joints"][0]
    assert (joint["factor"], joint["others"]) == (-1.0, {"j3": -0.25})  # as a controller adds them
    for key in ("others", "lower_rad", "upper_rad"):
        del joint[key]  # of an older file
    older = robot_of_json(content, "x.json")
    assert (older.table.rows[0].lower, "j1" in older.coupling) == (None, False)


@pytest.mark.parametrize(
    ("place", "value", "says"),
    [
        (("joints", 0, "driver"), "j2", "'j1' has no value of its own"),
        (("joints", 0, "factor"), 2.0, "'j1' has no value of its own"),
        (("after", "rows", 0, "d_m"), None, "another kind"),
        (("convention",), "denavit", "not a convention"),
        (("after",), None, "another kind"),
    ],
)
def test_what_is_damaged_is_named(place, value, says):
    content = copy.deepcopy(robot_json(DHRobot(DHTable(ROWS, T, T, "hayati"))))
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    with pytest.raises(ModelError, match=rf"x\.json: .*{says}"):
        robot_of_json(content, "x.json")
