"""Noise as a cell states it, in scenarios of Python as in those of the command line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, Tracker, TrackerNoise
from calib.verbs.simulate.cell_noise import USUAL_NOISE, cell_noise, further_noise
from calib.verbs.simulate.scenario import Scenario
from calib.verbs.simulate.scenario_words import read_scenario

TRACKER = Tracker(np.array([2.0, 1.0, 0.5]), noise=TrackerNoise(1e-5, 1e-6, 0.0))
STATED = Cell(sigma={"m": 5e-5, "rad": 1e-3}, tracker=TRACKER, kind="pose")


def test_the_cell_s_own_noise_comes_before_its_tracker_s_and_the_usual_one():
    assert cell_noise(STATED) == TrackerNoise(5e-5, 0.0, 0.0)
    assert cell_noise(Cell(tracker=TRACKER)) is TRACKER.noise
    assert cell_noise(Cell()) is USUAL_NOISE
    assert further_noise(STATED) == {"rad": 1e-3}


@pytest.mark.parametrize("cell", [STATED, Cell(tracker=TRACKER), Cell()])
def test_a_scenario_has_the_noise_of_the_command_line(ur3, cell):
    scenario = Scenario(ur3, cell=cell)
    assert scenario.noise == read_scenario(ur3, cell).noise
    assert scenario.sigma == further_noise(cell)


def test_what_a_scenario_states_itself_comes_before_the_cell_s(ur3):
    own = Scenario(ur3, cell=STATED, noise=TrackerNoise(), sigma={"rad": 2e-3})
    assert own.noise == TrackerNoise()
    assert own.sigma == {"rad": 2e-3}
    quiet = Scenario(ur3, cell=STATED, noise=None)
    assert quiet.noise is None
    assert not quiet.sigma


def test_a_scenario_with_another_cell_has_that_cell_s_noise_unless_one_was_stated(ur3):
    assert replace(Scenario(ur3), cell=STATED).noise == cell_noise(STATED)
    own = Scenario(ur3, noise=TrackerNoise(1e-4))
    assert replace(own, cell=STATED).noise == TrackerNoise(1e-4)


def test_the_rows_have_the_stated_noise(ur3):
    cell = Scenario(ur3, cell=Cell(sigma={"m": 2e-4})).draw(1)
    made = cell.measure(cell.scenario.random_poses(500, 1), 1)
    off = made.measurements.points - made.points
    assert (made.sigma == 2e-4).all()
    assert off.std() == pytest.approx(2e-4, rel=4 / np.sqrt(2 * off.size))
