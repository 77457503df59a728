"""Frames and targets that were stated, and are elsewhere: against fits with the place where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell, StatedUncertainty
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from tests.tracked import T_FRAME_BASE, table_of

#: Displacement [m], and turn [rad].
STEP = 1e-4

STATED = {
    "frame": StatedUncertainty(frame=1e-4, frame_angle=1e-4),
    "target": StatedUncertainty(target=1e-4),
}


def fitted(ur3: Robot, place: str, off: np.ndarray) -> Calibration:
    """The fit with the frame or the target off along and about the axes, (6,); priors and weights are held."""
    table, truth = table_of(ur3, 40)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = pin.exp3(off[3:]), off[:3]
    frame, target = T_FRAME_BASE.copy(), truth.T_tip_target[0, :3, 3].copy()
    if place == "frame":
        frame[:3, :3] = moved[:3, :3] @ frame[:3, :3]
        frame[:3, 3] += off[:3]
    else:
        target += off[:3]
    cell = Cell(T_frame_base=frame, uncertainty=STATED[place], scale_certified=True)
    cell = cell.with_target(target, estimate=False)
    cell = replace(cell, priors=cell.priors.with_source("given"))
    return calibrate(ur3, table, cell=cell, model="dh", robust=False, validate=False)


@pytest.mark.parametrize(
    ("place", "direction"), [("frame", 0), ("frame", 2), ("frame", 4), ("target", 1)]
)
def test_parameters_make_up_for_a_place_that_is_off_and_residuals_have_the_rest(
    ur3: Robot, place: str, direction: int
):
    step = np.zeros(6)
    step[direction] = STEP
    here, there = fitted(ur3, place, np.zeros(6)), fitted(ur3, place, step)
    (stated,) = here.geometry.stated_places
    assert (stated.is_frame, stated.index) == (place == "frame", 0)
    # The base or the target itself is then off from where it is stated by as much, the other way.
    change = (here.geometry.x - there.geometry.x) / STEP
    largest = np.abs(change).max()
    assert stated.absorbed[:, direction] == pytest.approx(change, abs=0.02 * largest)
    left = (here.rows.residual_calibrated - there.rows.residual_calibrated) / STEP
    assert stated.on_rows[:, direction] == pytest.approx([np.mean(left**2), 0.0], rel=0.01)
