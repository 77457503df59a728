"""The order of the rows matters if joints lag by their last move, and not if they err by as much at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.selection.row_order import order_matters
from calib.fit.selection.selection import Selection, select
from calib.numerics.moves import last_moves
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.fit.selection.models import task_of

TARGET = np.array([0.03, 0.02, 0.1])

#: What the joints are short by [rad].
LAG = 1e-3


class Arm:
    """A robot, as `task_of` takes it."""

    def __init__(self, robot: Robot):
        self.robot = robot


def table(robot: Robot, signs: str, count: int = 40) -> Measurements:
    """Points of a robot whose joints lag by the signs of their moves, or by as much with random signs."""
    rng = np.random.default_rng(3)
    q = random_joint_values(robot, count, 5)
    lag = np.sign(last_moves(q))
    if signs == "random":
        lag = rng.choice([-1.0, 1.0], q.shape)
    T = robot.poses(q - LAG * lag)
    points = T[:, :3, :3] @ TARGET + T[:, :3, 3] + 3e-5 * rng.normal(size=(count, 3))
    return Measurements(robot.joint_names, q, points)


def search(robot: Robot, m: Measurements) -> Selection:
    task, rows = task_of(Arm(robot), m, Cell(), "auto")
    return select(task, rows)


def of_lag(robot: Robot, m: Measurements) -> Fitted:
    task, rows = task_of(Arm(robot), m, Cell(), "zeros+lost_motion")
    return fit(task, rows)


def test_lost_motion_is_found_by_the_order_of_the_rows(ur3):
    found = search(ur3, table(ur3, "moves"))
    assert found.non_geometric.split("+")[1:] == ["lost_motion"]
    lags = found.chosen.kinematics.model.family("lost_motion")
    estimate = found.chosen.estimate
    std = np.sqrt(np.diag(estimate.covariance))[lags]
    assert np.all(std < 0.2 * LAG)
    assert np.all(np.abs(estimate.x[lags] - LAG) < 4.0 * std)


def test_joints_that_err_at_random_have_no_lost_motion(ur3):
    assert "lost_motion" not in search(ur3, table(ur3, "random")).non_geometric


@pytest.mark.parametrize(("signs", "matters"), [("moves", True), ("random", False)])
def test_the_measured_order_must_beat_all_others(ur3, signs, matters):
    assert order_matters(of_lag(ur3, table(ur3, signs)), ("lost_motion",)) is matters


def test_a_sorted_table_needs_its_order(ur3):
    m = table(ur3, "moves")
    by_first_joint = np.argsort(m.joints[:, 0])
    in_order = replace(m, joints=m.joints[by_first_joint], points=m.points[by_first_joint])
    for moves, matters in ((m.moves[by_first_joint], True), (None, False)):
        fitted = of_lag(ur3, replace(in_order, moves=moves))
        assert order_matters(fitted, ("lost_motion",)) is matters
