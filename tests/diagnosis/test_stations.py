"""Stations that do not agree with the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from calib.diagnosis.reasons import Why
from calib.diagnosis.stations import disagreeing_stations, prediction_square, unpredicted
from calib.result.calibrate import calibrate
from tests.judged import reasons


def test_a_station_that_the_others_do_not_predict(calibrated):
    """At one of three stations a joint slipped: each station alone looks well, but not from the others."""
    scene, good = calibrated("set-ups")
    m = good.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-4
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.cell)
    assert reasons(slipped)[Why.SETUP_UNPREDICTED]["setup"] == "1"
    assert slipped.verdict.use == "use with care"
    assert Why.SETUP_UNPREDICTED not in reasons(good)
    assert len(disagreeing_stations(good.fitted)) == 0


def test_a_station_whose_rows_are_flagged(calibrated):
    """A joint slipped further: the robust fit takes that station's rows for outliers, and the station is named."""
    scene, good = calibrated("set-ups")
    m = good.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-3
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.cell)
    assert reasons(slipped)[Why.SETUP_FLAGGED]["setup"] == "1"
    assert slipped.verdict.use != "use"
    assert Why.SETUP_FLAGGED not in reasons(good)


def compared(rng, *, changed=0.0, poses=15, parameters=24, sigma=1.0):
    """Four stations with a frame each, measured on one arm; the third with other parameters by so much.

    Each is predicted from the three others, whose parameters and noise come from their own least squares fit.
    """
    rows = 3 * poses
    A = rng.normal(size=(4, rows, parameters))
    B = rng.normal(size=(4, rows, 6))
    x = np.tile(rng.normal(size=parameters), (4, 1))
    x[2] += changed * rng.normal(size=parameters)
    y = [a @ v + b @ rng.normal(size=6) for a, b, v in zip(A, B, x, strict=True)]
    y = np.array(y) + sigma * rng.normal(size=(4, rows))
    tests = np.zeros((4, 4))
    for g in range(4):
        others = [k for k in range(4) if k != g]
        frames = np.zeros((3 * rows, 18))
        for i, k in enumerate(others):
            frames[i * rows : (i + 1) * rows, 6 * i : 6 * i + 6] = B[k]
        full = np.hstack([np.vstack(A[others]), frames])
        target = np.concatenate(y[others])
        solution = np.linalg.lstsq(full, target, rcond=None)[0]
        covariance = np.linalg.inv(full.T @ full)[:parameters, :parameters]
        freedom = len(target) - full.shape[1]
        noise = np.sum((target - full @ solution) ** 2) / freedom
        r = y[g] - A[g] @ solution[:parameters]
        tests[g] = *prediction_square(r, A[g], covariance, B[g]), noise, freedom
    return unpredicted(*tests.T), tests.T


def test_stations_that_agree_raise_no_alarms_and_the_one_that_differs_is_named_first():
    rng = np.random.default_rng(1)
    alarms = sum(bool(compared(rng, poses=8, parameters=12)[0]) for _ in range(40))
    assert alarms <= stats.binom.ppf(0.999, 40, 0.01)
    for _ in range(4):
        (number, ratio), *_ = compared(rng, changed=1.0)[0]
        assert number == 2
        assert ratio > 1.5
