"""The table of corners to touch: two steps a corner, read back by the csv module and as poses."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from calib.robot.robot import Robot
from calib.verbs.plan.touch_file import hand_last, in_table_units, write_touch
from tests.verbs.plan.test_touch import robot, touched

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


def rows_of(path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_each_corner_is_stood_above_then_touched(tmp_path):
    plan = touched()
    rows = rows_of(write_touch(plan, tmp_path / "touch.csv"))
    assert [row["corner"] for row in rows] == [str(c) for c in plan.corners for _ in range(2)]
    assert [row["step"] for row in rows] == ["above", "touch"] * 5
    for k, (above, touch) in enumerate(zip(rows[::2], rows[1::2], strict=True)):
        for row, q in ((above, plan.above[k]), (touch, plan.touching[k])):
            written = [float(row[f"{name} [deg]"]) for name in JOINTS]
            np.testing.assert_allclose(written, np.degrees(q[::-1]), atol=5.1e-5)
            place = [float(row[f"{axis} [mm]"]) for axis in "xyz"]
            np.testing.assert_allclose(place, 1e3 * plan.places[k], atol=5.1e-4)
        error = float(touch["expected error 95 % [mm]"])
        assert error == pytest.approx(1e3 * plan.expected[k], abs=5.1e-4)


def test_corners_that_cannot_be_touched_are_left_out(tmp_path):
    free = np.array([True, False, True, True, False])
    plan = replace(touched(), free=free)
    rows = rows_of(write_touch(plan, tmp_path / "touch.csv"))
    assert [row["corner"] for row in rows[::2]] == ["0", "34", "28"]


def test_joints_are_listed_from_the_foot_to_the_hand(ur3):
    assert hand_last(robot()) == [5, 4, 3, 2, 1, 0]
    assert hand_last(ur3) == [0, 1, 2, 3, 4, 5]


def test_sliding_joints_are_in_millimetres(serial_urdf):
    kinds = [
        ("revolute", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
        ("prismatic", (0, 0, 0.2), (0, 0, 0), (0, 0, 1)),
    ]
    arm = Robot.from_urdf(serial_urdf(kinds))
    assert in_table_units(arm, np.array([np.pi, 0.25])) == pytest.approx([180.0, 250.0])
