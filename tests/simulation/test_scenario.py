"""Scenarios: what a cell is to be like, and cells with errors of their own out of it."""

import numpy as np
import pytest

from calib.data.cell import Cell, Tracker, TrackerNoise
from calib.errors import CalibError
from calib.robot.readback import column_ranges
from calib.simulation.scenario import DEFAULT_TRACKER, Scenario

TRACKER = Tracker(np.array([2.0, 1.0, 0.5]), noise=TrackerNoise(1e-5, 1e-6, 0.0))


def test_each_seed_makes_another_robot_and_the_same_seed_the_same(ur3):
    scenario = Scenario(ur3)
    cells = [scenario.draw(seed) for seed in (1, 1, 2)]
    assert (cells[0].truth.x == cells[1].truth.x).all()
    assert not np.allclose(cells[0].truth.x, cells[2].truth.x)
    assert cells[0].truth.nominal is ur3


def test_the_tracker_stands_where_the_cell_says_or_at_its_frame_or_3_m_away(ur3):
    def of(cell: Cell):
        return Scenario(ur3, cell).tracker

    assert (of(Cell()) == DEFAULT_TRACKER).all()
    assert (of(Cell(tracker=TRACKER)) == TRACKER.position).all()
    assert of(Cell(estimate_frame=True)) is None
    assert of(Cell(T_frame_base=np.eye(4))) is None
    assert of(Cell(frames={"a": np.eye(4)})) is None


def test_random_poses_lie_inside_the_limits_or_the_cell_s_ranges(ur3):
    low, high = column_ranges(ur3).T
    scenario = Scenario(ur3)
    q = scenario.random_poses(500, 1)
    assert (q >= low).all()
    assert (q <= high).all()
    assert (np.ptp(q, axis=0) > 0.95 * (high - low)).all()
    assert (scenario.random_poses(20, 1) == q[:20]).all()
    assert not np.allclose(scenario.random_poses(20, 1, validation=True), q[:20])
    q = Scenario(ur3, Cell(ranges={"elbow_joint": (0.1, 0.2)})).random_poses(100, 1)
    assert ((q[:, 2] >= 0.1) & (q[:, 2] <= 0.2)).all()
    with pytest.raises(CalibError, match="'elbow'"):
        Scenario(ur3, Cell(ranges={"elbow": (0.1, 0.2)})).random_poses(3, 1)
