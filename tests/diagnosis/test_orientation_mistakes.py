"""Mistakes that only orientations show: conventions of software, the sign and the zero of a joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.verbs.simulate.truth import draw_truth


@pytest.mark.parametrize(
    ("change", "why", "values"),
    [
        (lambda q: Rotation.from_quat(np.roll(q, 1, 1)), Why.SCALAR_ELSEWHERE, {"scalar": "first"}),
        (lambda q: Rotation.from_quat(np.roll(q, -1, 1)), Why.SCALAR_ELSEWHERE, {"scalar": "last"}),
        (lambda q: Rotation.from_quat(q).inv(), Why.ORIENTATIONS_INVERSE, {}),
    ],
)
def test_orientations_that_are_written_otherwise(ur3: Robot, change, why, values):
    truth, q = draw_truth(ur3, "dh", {}, 1), random_joint_values(ur3, 20, 1)
    T = truth.poses(q)
    table = Measurements(
        ur3.joint_names, q, T[:, :3, 3], kinds=("pose",) * 20, rotations=T[:, :3, :3]
    )
    assert find_usual_mistake(ur3, Cell(), table) is None
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    told = find_usual_mistake(
        ur3, Cell(), replace(table, rotations=change(quaternions).as_matrix())
    )
    assert told.why == why
    assert values.items() <= told.values.items()
    assert told.values["error_rad"] < 0.05 < 1.0 < told.values["given_rad"]


@pytest.mark.parametrize(
    ("change", "why", "values"),
    [
        (lambda q: q * [1, 1, 1, 1, 1, -1], Why.ORIENTATIONS_JOINT_TURNED, {}),
        (lambda q: q + np.pi * np.eye(6)[5], Why.ORIENTATIONS_JOINT_ZERO, {}),
        (
            lambda q: q - [0, 0, 0, 0, 0, np.pi / 2],
            Why.ORIENTATIONS_JOINT_ZERO,
            {"add_rad": np.pi / 2},
        ),
    ],
)
def test_the_last_joint_turns_a_target_on_its_axis_and_does_not_move_it(
    ur3: Robot, change, why, values
):
    q = random_joint_values(ur3, 20, 1)
    T = ur3.poses(q)
    table = Measurements(
        ur3.joint_names, change(q), T[:, :3, 3], kinds=("pose",) * 20, rotations=T[:, :3, :3]
    )
    told = find_usual_mistake(
        ur3, Cell(target=read_only(np.zeros(3)), estimate_target=False), table
    )
    assert (told.why, told.values["joint"]) == (why, "wrist_3_joint")
    for name, value in values.items():
        assert told.values[name] == pytest.approx(value)
    assert told.values["error_rad"] < 0.05 < 1.0 < told.values["given_rad"]
