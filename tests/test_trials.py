"""Trials of scripts/: virtual robots are measured, fitted and verified, and reach what was forecast and is stated."""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.result.calibrate import calibrate
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import plan
from calib.verbs.simulate.scenario import Scenario
from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from trials import VERIFIED, Task, run_trial, run_trials, verification_poses

TARGET = np.array([-0.06997, 0.07020, 0.02252])
CELL = Cell(target=TARGET, model="hayati")


def task(robot, **more):
    return Task(Scenario(robot, cell=CELL, model="hayati"), CELL, validate=False, **more)


def test_a_trial_is_what_a_person_would_do(ur3):
    what = task(ur3, count=30)
    trial = run_trial(what, 11)
    virtual = what.scenario.draw(11)
    made = virtual.measure(what.scenario.random_poses(30, 11), 11)
    result = calibrate(ur3, made.measurements, cell=what.cell, validate=False)
    q = verification_poses(what.scenario)
    assert q.shape == (VERIFIED, 6)
    error = np.linalg.norm(result.predict(q) - virtual.truth.points(q), axis=1)
    assert trial.rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert trial.nominal_rms == pytest.approx(
        np.sqrt(np.mean(virtual.truth.nominal_errors(q) ** 2))
    )
    assert trial.seed == 11


@pytest.mark.slow
def test_forty_calibrations_reach_what_was_forecast(ur3):
    poses = Scenario(ur3).random_poses(30, 7)
    found = run_trials(task(ur3, poses=poses), 40)
    assert found.forecast is not None
    # Five standard errors of a mean over 40.
    assert found.forecast.rms == pytest.approx(found.rms, abs=5.0 * found.rms_error)
    assert found.forecast.rms == pytest.approx(found.rms, rel=0.15)
    low, high = np.quantile(found.values("rms"), [0.05, 0.95])
    assert low < found.rms < high
    assert found.forecast.rms_low == pytest.approx(low, rel=0.25)
    assert found.forecast.rms_high == pytest.approx(high, rel=0.25)
    # What the fits say of themselves is so too.
    assert np.sqrt(np.mean(found.values("stated_rms") ** 2)) == pytest.approx(found.rms, rel=0.15)
    assert 0.88 < found.values("covered").mean() <= 1.0
    assert np.sqrt(np.mean(found.values("nominal_rms") ** 2)) > 20 * found.rms


@pytest.mark.slow
def test_planned_poses_beat_random_ones(ur3):
    request = PlanRequest(20, 0, candidates=2000, margin=0.0, ladder=False)
    chosen = plan(ur3, CELL, request, collisions=None).estimation
    random = run_trials(task(ur3, count=20), 8)
    planned = run_trials(task(ur3, poses=chosen), 8)
    # 0.84 for 30 of 20,000 candidates in docs/planning.md; here with fewer of both.
    assert planned.rms < 0.95 * random.rms
    # The same robots.
    np.testing.assert_array_equal(planned.values("nominal_rms"), random.values("nominal_rms"))


@pytest.mark.slow
def test_the_same_seed_makes_the_same_trials_in_any_executor(ur3):
    what = task(ur3, count=15)
    here = run_trials(what, 4, seed=3)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        there = run_trials(what, 4, seed=3, executor=executor)
    assert [t.seed for t in here.trials] == [3, 4, 5, 6]
    assert here.trials == there.trials
    other = run_trials(what, 4, seed=4)
    assert other.trials[0] == here.trials[1]


@pytest.mark.slow
def test_of_distances_the_fits_say_and_the_forecast_says_what_is_reached(ur3):
    T_anchor_base = np.eye(4)
    T_anchor_base[:3, 3] = (1.5, 0.3, 0.2)
    cell = Cell(target=TARGET, kind="distance", T_frame_base=T_anchor_base, model="dh")
    scenario = Scenario(ur3, cell=cell, model="dh")
    found = run_trials(Task(scenario, cell, count=60, validate=False), 25)
    stated = np.sqrt(np.mean(found.values("stated_rms") ** 2))
    # Where the base turned about the anchor counted, 36 times as much; with a tracker 3 m away in place of the anchor
    # at 1.5 m, the forecast was 1.2 times as much.
    assert stated == pytest.approx(found.rms, rel=0.15)
    assert 0.85 < found.values("covered").mean() < 1.0
    assert found.forecast is not None
    assert found.forecast.rms == pytest.approx(found.rms, rel=0.12)
