"""A UR3 that a tracker measured in its own frame, and what its cell may state of uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell, StatedUncertainty
from calib.data.measurements import Measurements
from calib.numerics.geometry import pose_of
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.verbs.simulate.truth import draw_truth

#: Noise of a coordinate of the tables [m].
SIGMA = 5e-5

#: Pose of the base in the tracker.
T_FRAME_BASE = pose_of(np.array([1.2, -0.4, 0.3]), pin.exp3(np.array([0.1, 0.2, 1.0])))


def table_of(robot, rows=40, seed=4):
    """Measurements of a UR3 by a tracker in its own frame, and its truth."""
    truth = draw_truth(robot, "dh", {"length": 3e-4, "angle": 2e-3, "zero": 3e-3}, seed)
    q = random_joint_values(robot, rows, seed)
    points = truth.points(q) @ T_FRAME_BASE[:3, :3].T + T_FRAME_BASE[:3, 3]
    points = points + SIGMA * np.random.default_rng(seed).standard_normal(points.shape)
    return Measurements(robot.joint_names, q, points), truth


@pytest.fixture(scope="session")
def tracked(ur3) -> Calibration:
    """A UR3 in a tracker's own frame, whose noise is stated."""
    table, _ = table_of(ur3)
    cell = Cell(estimate_frame=True, sigma={"m": SIGMA}, instrument="tracker")
    return calibrate(ur3, table, cell=cell, model="dh")


@pytest.fixture(scope="session")
def points():
    """Joint values at which poses are predicted."""
    return np.random.default_rng(7).uniform(-1.5, 1.5, (12, 6))


@pytest.fixture(scope="session")
def with_statements(tracked):
    """The same result with other statements of the cell, and record."""

    def changed(record=None, **stated) -> Calibration:
        result = replace(tracked, stated_uncertainty=StatedUncertainty(**stated))
        return result if record is None else replace(result, record=record)

    return changed
