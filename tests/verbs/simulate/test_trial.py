"""A trial of a study is what a person would do."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.verbs.simulate.scenario import Scenario
from calib.verbs.simulate.trial import VERIFIED, Trials, one_trial, verification_poses

TARGET = np.array([-0.06997, 0.07020, 0.02252])


@pytest.fixture(scope="module")
def ur3():
    return Robot.load("urdf/ur3.urdf", base="base", tip="tool0")


def trials(robot, *, model="hayati", validate=False, **more):
    cell = Cell(target=TARGET, model=model)
    return Trials(Scenario(robot, cell=cell, model=model), cell, validate=validate, **more)


def test_a_trial_is_what_a_person_would_do(ur3):
    what = trials(ur3, count=30)
    trial = one_trial(what, 11)
    virtual = what.scenario.draw(11)
    made = virtual.measure(what.scenario.random_poses(30, 11), 11)
    result = calibrate(ur3, made.measurements, cell=what.cell, validate=False)
    q = verification_poses(what.scenario)
    assert q.shape == (VERIFIED, 6)
    error = np.linalg.norm(result.predict(q) - virtual.truth.points(q), axis=1)
    assert trial.rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert trial.max == pytest.approx(error.max(), rel=1e-12)
    assert trial.nominal_rms == pytest.approx(
        np.sqrt(np.mean(virtual.truth.nominal_errors(q) ** 2))
    )
    assert trial.sigma == result.noise.sigma["m"]
    assert (trial.model, trial.verdict, trial.seed) == ("hayati", "", 11)


def test_a_trial_with_a_camera_is_what_a_person_would_do(ur3):
    """The errors of the joints' zeros alone, and pictures of a board on the table."""
    robot = ur3.rebuilt(base="tool0", tip="base")
    cell = Cell(kind="pixel", model="zeros")
    scenario = Scenario(robot, cell, model="zeros", sigma={"px": 0.1})
    trial = one_trial(Trials(scenario, cell, count=10, validate=False), 3)
    assert trial.model == "zeros"
    assert trial.nominal_rms > 3e-3
    assert trial.rms < 0.2 * trial.nominal_rms
    assert 0.2 < trial.rms / trial.stated_rms < 4.0
    assert (trial.outliers, trial.false_alarms) == (0, 0)
