"""Stations that do not agree with the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.data.cell import Cell
from calib.diagnosis.reasons import Why
from calib.diagnosis.stations import (
    disagreeing_stations,
    flagged_station,
    prediction_square,
    unpredicted,
)
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from tests.fits import TARGETS, TRACKERS, joined
from tests.judged import arm, fit_to, reasons, table_of


def test_a_station_that_the_others_do_not_predict(calibrated):
    """At one of three stations a joint slipped: each station alone looks well, but not from the others."""
    scene, good = calibrated("set-ups")
    m = good.fit.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-4
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.fit.cell)
    assert reasons(slipped)[Why.SETUP_UNPREDICTED]["setup"] == "1"
    assert slipped.verdict.use == "use with care"
    assert Why.SETUP_UNPREDICTED not in reasons(good)
    assert len(disagreeing_stations(good.fit.geometry)) == 0


def test_of_two_stations_either_is_compared_with_the_other(calibrated):
    scene, good = calibrated("known set-ups")
    m = good.fit.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-4
    table = replace(m, joints=joints)
    slipped = calibrate(scene.robot, table, cell=good.fit.cell, model="dh", validate=False)
    found = disagreeing_stations(slipped.fit.geometry)
    assert {reason.why for reason in found} == {Why.SETUP_UNPREDICTED}
    assert {reason.values["setup"] for reason in found} <= {"0", "1"}
    assert all(reason.values["ratio"] > 1.5 for reason in found)
    assert disagreeing_stations(good.fit.geometry) == ()
    # A single one has none to be compared with.
    alone = table.select(np.array(m.groups) == "1")
    one = calibrate(scene.robot, alone, cell=Cell(estimate_frame=True), model="dh", validate=False)
    assert disagreeing_stations(one.fit.geometry) == ()


def test_errors_that_the_other_stations_cannot_know_are_expected(make_scene):
    """A joint moved before one instrument only; a slip of another joint shows all the same."""
    scene = arm(make_scene, 63)
    q = random_joint_values(scene.robot, 80, 3)
    q[:40, 3] = 0.4
    m = table_of(scene, q, np.random.default_rng(3))
    m = replace(m, groups=("first",) * 40 + ("second",) * 40)
    assert disagreeing_stations(fit_to(scene, m)) == ()
    slipped = m.joints + 5e-4 * np.outer(np.arange(80) >= 40, np.arange(6) == 1)
    found = disagreeing_stations(fit_to(scene, replace(m, joints=slipped)))
    assert {reason.why for reason in found} == {Why.SETUP_UNPREDICTED}


@pytest.mark.parametrize(("rows", "named"), [(2, []), (3, ["1"])])
def test_stations_are_compared_by_a_fit_with_ten_degrees_of_freedom(make_scene, rows, named):
    """One sees the target, which alone is estimated, a millimetre too high: with 9 degrees of freedom, and with 12."""
    scene = make_scene(
        36, frames=TRACKERS[:2], targets=TARGETS[:1], length=0.0, angle=0.0, noise=2e-5
    )
    table = joined(scene.points(rows, 0), scene.points(2, 1))
    is_other = np.array(table.groups) == "1"
    cell = Cell(model="frames", frames={str(k): TRACKERS[k] for k in range(2)})
    fitted = fit_to(
        scene, replace(table, points=table.points + [0, 0, 1e-3] * is_other[:, None]), cell
    )
    assert fitted.estimate.freedom == pytest.approx(3 * (rows + 2) - 3)
    found = disagreeing_stations(fitted)
    assert [reason.values["setup"] for reason in found] == named


@pytest.mark.parametrize(
    ("flagged", "others", "told"),
    [
        (10, 0, True),
        (4, 0, False),  # no more than a quarter of the rows
        (10, 7, False),  # nor three times as many as elsewhere
        (10, 5, True),
    ],
)
def test_a_station_is_flagged_by_its_share_of_outliers(
    calibrated, flagged: int, others: int, told: bool
):
    """Of 20 rows of one station, and of 40 of two others."""
    _, c = calibrated("set-ups")
    fitted = c.fit.geometry
    frame = fitted.estimate.problem.rows.samples.frame
    chosen = np.concatenate([np.flatnonzero(frame == k)[:20] for k in range(3)])
    rows = fitted.estimate.problem.rows.select(chosen)
    scores = np.zeros(60)
    scores[20 : 20 + flagged] = scores[40 : 40 + others] = 2.0 * fitted.estimate.flag_limit
    problem = replace(fitted.estimate.problem, rows=rows)
    estimate = replace(fitted.estimate, problem=problem, scores=scores)
    found = list(flagged_station(replace(fitted, estimate=estimate)))
    assert [reason.why for reason in found] == [Why.SETUP_FLAGGED] * told
    for reason in found:
        assert reason.values == {"flagged": flagged, "rows": 20, "setup": "1"}


@pytest.mark.slow
def test_a_station_whose_rows_are_flagged(calibrated):
    """A joint slipped further: the robust fit takes that station's rows for outliers, and the station is named."""
    scene, good = calibrated("set-ups")
    m = good.fit.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-3
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.fit.cell)
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


def test_stations_far_above_the_noise_are_named_the_surest_first():
    """F is 9, 16, 2 and 2.5; the third is sure, but below the 1.5 times that matter."""
    squares = 2.0 * 50.0 * np.array([9.0, 16.0, 2.0, 2.5])
    found = unpredicted(squares, np.full(4, 50.0), np.full(4, 2.0), np.full(4, 1e3))
    assert found == [(1, 4.0), (0, 3.0), (3, np.sqrt(2.5))]
    # The same ratios may be chance where a station has two degrees of freedom, or the others have three.
    few = unpredicted(squares / 25.0, np.full(4, 2.0), np.full(4, 2.0), np.full(4, 1e3))
    assert few == [(1, 4.0), (0, 3.0)]
    assert unpredicted(squares, np.full(4, 50.0), np.full(4, 2.0), np.full(4, 3.0)) == []


def test_the_surest_station_is_that_of_the_smallest_probability_then_of_the_largest_errors():
    def found(F: list[float], freedoms: list[float]) -> list[int]:
        tests = np.array([np.multiply(F, freedoms), freedoms, np.ones(2), np.full(2, 1e3)])
        return [number for number, _ in unpredicted(*tests)]

    assert found([16.0, 9.0], [2.0, 50.0]) == [1, 0]
    # Both probabilities are zero in floating point.
    assert found([1e4, 2e4], [50.0, 50.0]) == [1, 0]


def test_as_many_stations_as_are_compared_share_the_false_alarms():
    """F of 7 with 2 and 1000 degrees of freedom has p = 0.001: enough among nine stations, not among eleven."""
    F = stats.f.isf(1e-3, 2, 1000)

    def found(stations: int) -> int:
        squares = np.full(stations, 2.0) * np.where(np.arange(stations) == 0, F, 1.0)
        freedoms = np.full((2, stations), [[2.0], [1000.0]])
        return len(unpredicted(squares, freedoms[0], np.ones(stations), freedoms[1]))

    assert (found(9), found(11)) == (1, 0)


def test_a_station_is_compared_where_it_and_the_others_have_degrees_of_freedom():
    """Those that are not compared take no part in the false alarms either."""
    squares = np.full(4, 2.0 * 50.0 * 9.0)
    freedoms = np.array([50.0, 0.0, 50.0, 50.0])
    noises = np.array([2.0, 2.0, 0.0, 2.0])
    of_noise = np.array([1e3, 1e3, 1e3, 0.0])
    assert unpredicted(squares, freedoms, noises, of_noise) == [(0, 3.0)]
    assert unpredicted(squares, np.zeros(4), noises, of_noise) == []


def test_a_residual_is_held_against_the_uncertainty_of_its_prediction():
    """r^T W r by the inverse of I + A C A^T, and of what the nuisance cannot explain by generalised least squares."""
    rng = np.random.default_rng(3)
    r, A, B = rng.normal(size=12), rng.normal(size=(12, 4)), rng.normal(size=(12, 3))
    root = rng.normal(size=(4, 4))
    W = np.linalg.inv(np.eye(12) + A @ root @ root.T @ A.T)
    square, freedom = prediction_square(r, A, root @ root.T, np.zeros((12, 0)))
    assert (freedom, square) == (12, pytest.approx(r @ W @ r))
    left = r - B @ np.linalg.solve(B.T @ W @ B, B.T @ W @ r)
    square, freedom = prediction_square(r, A, root @ root.T, B)
    assert (freedom, square) == (9, pytest.approx(left @ W @ left))
