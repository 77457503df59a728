"""Joint values that are late: tables of an arm on its way along a path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.diagnosis.late_joints import late_joints
from calib.diagnosis.reasons import Why
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from tests.judged import arm, fit_to, table_of

ROWS = 60


def path(t: np.ndarray) -> np.ndarray:
    """Joint values of a UR3 that swings, shape (N, 6), at times of which the rows are one apart."""
    slow = 0.1 + 0.02 * np.arange(6)
    middle = np.array([0.0, -1.0, 1.0, 0.0, 1.0, 0.0])
    return middle + np.sin(slow * t[:, None] + np.arange(6))


@pytest.fixture(scope="module")
def scene(make_scene):
    return arm(make_scene, 7)


def found_in(scene, read, reached=None):
    """The delays in a table of joint values that are not those that the arm reached."""
    reached = path(np.arange(ROWS)) if reached is None else reached
    table = replace(table_of(scene, reached, np.random.default_rng(7)), joints=read, moves=None)
    return list(late_joints(fit_to(scene, table), read, np.arange(ROWS)))


@pytest.mark.parametrize("late", [0.05, -0.05])
def test_one_share_of_the_way_to_the_next_row_is_found(scene, late):
    (reason,) = found_in(scene, path(np.arange(ROWS) - late))
    assert reason.why is Why.JOINTS_LATE
    assert reason.values["of_step"] == pytest.approx(late, rel=0.15)
    assert reason.values["falls"] > 0.5
    (more,) = found_in(scene, path(np.arange(ROWS) - 2.0 * late))
    assert more.values["over_arm"] == pytest.approx(2.0 * reason.values["over_arm"], rel=0.2)


def test_joint_values_of_the_same_time_are_not_late(scene):
    assert found_in(scene, path(np.arange(ROWS))) == []


def test_joints_that_lag_each_by_its_own_share_are_not_late(scene):
    shares = 0.05 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    on_time, late = path(np.arange(ROWS)), path(np.arange(ROWS) - 1.0)
    assert found_in(scene, on_time + shares * (late - on_time)) == []


def test_poses_in_any_order_are_no_path(scene):
    """Each of them lacks a share of the way from the last one."""
    q = random_joint_values(scene.robot, ROWS, 7)
    assert found_in(scene, q, q - 0.01 * np.diff(q, axis=0, prepend=q[:1])) == []


@pytest.mark.parametrize(("late", "use"), [(0.02, "use with care"), (0.4, "do not use")])
def test_rows_between_the_fitted_ones_count_as_way(scene, late, use):
    """Each third row is for validation; a delay that does as much as all that is wrong with the arm is wrong input."""
    table = table_of(scene, path(np.arange(ROWS)), np.random.default_rng(7))
    sets = tuple("validate" if k % 3 == 1 else "estimate" for k in range(ROWS))
    read = path(np.arange(ROWS) - late)
    given = Measurements(table.joint_names, read, points=table.points, sets=sets)
    verdict = calibrate(scene.robot, given, model="dh").verdict
    assert (verdict.use, verdict.reasons[0].why) == (use, Why.JOINTS_LATE)
    assert verdict.reasons[0].values["of_step"] == pytest.approx(late, rel=0.15)
