"""DH rows in each convention; and robots as rows state them: coupled readings, and rows that make none."""

from __future__ import annotations

import copy

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import ModelError
from calib.robot.dh_rows import NEARLY_PARALLEL_RAD, DHRobot, DHRow, DHTable, dh_frames, screw


def _table(convention: str, *rows: DHRow) -> DHTable:
    return DHTable(rows, np.eye(4), np.eye(4), convention)


def test_a_row_of_each_convention_by_hand():
    row = DHRow("j", prismatic=False, theta=np.pi / 2, d=0.3, a=0.5, alpha=np.pi / 2)
    # Standard: up by d, out along the turned x by a. Modified: out along x first, then z, which alpha laid down.
    standard = _table("standard", row).poses([0.0])[0]
    np.testing.assert_allclose(standard[:3, 3], [0.0, 0.5, 0.3], atol=1e-15)
    np.testing.assert_allclose(standard[:3, 2], [1.0, 0.0, 0.0], atol=1e-15)
    modified = _table("modified", row).poses([0.0])[0]
    np.testing.assert_allclose(modified[:3, 3], [0.5, -0.3, 0.0], atol=1e-15)
    np.testing.assert_allclose(modified[:3, 2], [0.0, -1.0, 0.0], atol=1e-15)
    tilted = DHRow("j", prismatic=False, theta=0.0, d=0.0, a=0.5, alpha=0.0, beta=0.01)
    hayati = _table("hayati", tilted).poses([0.0])[0]
    np.testing.assert_allclose(hayati[:3, 2], [np.sin(0.01), 0.0, np.cos(0.01)], atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_screw_turns_about_and_moves_along_its_axis(axis):
    angles = np.array([0.3, -2.0])
    lengths = np.array([0.1, 0.2])
    for T, angle, length in zip(screw(axis, angles, lengths), angles, lengths, strict=True):
        expected = pin.exp6(np.concatenate([length * np.eye(3)[axis], angle * np.eye(3)[axis]]))
        np.testing.assert_allclose(T, expected.homogeneous, atol=1e-15)
    assert screw(axis, 0.3, 0.1).shape == (4, 4)


@pytest.mark.parametrize(
    ("alpha", "beta", "parallel"),
    [
        (0.0, 0.0, True),
        (np.pi, 0.0, True),
        (0.9 * NEARLY_PARALLEL_RAD, 0.0, True),
        (1.1 * NEARLY_PARALLEL_RAD, 0.0, False),
        (0.0, 1.1 * NEARLY_PARALLEL_RAD, False),
    ],
)
def test_rows_whose_axes_are_nearly_parallel(alpha, beta, parallel):
    row = DHRow("j", prismatic=False, theta=1.0, d=0.0, a=0.5, alpha=alpha, beta=beta)
    assert row.near_parallel == parallel


def test_a_prismatic_joint_adds_to_d():
    row = DHRow("j", prismatic=True, theta=0.4, d=0.3, a=0.5, alpha=0.2)
    longer = DHRow("j", prismatic=True, theta=0.4, d=0.4, a=0.5, alpha=0.2)
    np.testing.assert_allclose(row.matrix(0.1), longer.matrix(), atol=1e-16)
    assert row.matrix([0.1, 0.2, 0.3]).shape == (3, 4, 4)


def test_frames_of_rows_stand_before_the_rotation_about_beta():
    first = DHRow("j", prismatic=False, theta=0.1, d=0.0, a=0.5, alpha=0.0, beta=0.02)
    second = DHRow("k", prismatic=False, theta=0.2, d=0.1, a=0.3, alpha=1.0)
    frames = dh_frames(_table("hayati", first, second))
    np.testing.assert_allclose(frames[0] @ screw(1, 0.02, 0.0), first.matrix(), atol=1e-16)
    np.testing.assert_allclose(frames[1], first.matrix() @ second.matrix(), atol=1e-16)


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
