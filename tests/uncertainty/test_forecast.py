"""Forecasts of the rms error of fresh rows, against linear fits of drawn rows, and on calibrations."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import ArgumentError, ModelError
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.uncertainty.forecast import FreshError, forecast, fresh_error

#: Errors of a row along three directions, by a generator and a number of rows.
Draw = Callable[[np.random.Generator, int], np.ndarray]

ERRORS: dict[str, Draw] = {
    "normal": lambda rng, n: rng.normal(size=(n, 3)),
    "one direction": lambda rng, n: rng.normal(size=(n, 3)) * [1.0, 0.05, 0.05],
    "heavy tails": lambda rng, n: rng.normal(size=(n, 3)) / np.sqrt(rng.gamma(4, 0.25, (n, 1))),
}


def fitted_rows(
    rng: np.random.Generator, draw: Draw, rows: int, parameters: int, fresh: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals of a linear fit, of it without each row in turn, and of fresh rows; true parameters are 0."""
    A = rng.normal(size=(rows, 3, parameters))
    y = draw(rng, rows)
    every = A.reshape(-1, parameters)
    C = np.linalg.inv(every.T @ every)
    x = C @ every.T @ y.ravel()
    fitted = y - A @ x
    # Without a row the residual is (1 - H)^-1 times that with it, of the leverage H of its scalars.
    held_out = np.linalg.solve(np.eye(3) - A @ C @ A.transpose(0, 2, 1), fitted[:, :, None])
    unseen = draw(rng, fresh) - rng.normal(size=(fresh, 3, parameters)) @ x
    return fitted, held_out[:, :, 0], unseen


def forecast_of(fitted: np.ndarray, held_out: np.ndarray) -> FreshError:
    """The forecast of rows of a pose each, none of which was flagged."""
    m = len(fitted)
    return fresh_error(held_out, fitted, np.arange(m), np.zeros(m, dtype=bool), 3 * m)


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize(
    ("rows", "parameters", "fresh"), [(40, 6, 40), (20, 20, 200), (80, 24, 10)]
)
def test_the_interval_holds_the_error_of_fresh_rows(name, rows, parameters, fresh):
    rng = np.random.default_rng(1)
    within, ratios = [], []
    for _ in range(300):
        fitted, held_out, unseen = fitted_rows(rng, ERRORS[name], rows, parameters, fresh)
        found = forecast_of(fitted, held_out).compared(np.linalg.norm(unseen, axis=1))
        within.append(found.within)
        ratios.append(found.rms / found.forecast.rms)
    # 90 %; three standard deviations of 300 draws are 5 %.
    assert 0.85 <= np.mean(within) <= 0.96
    assert np.median(ratios) == pytest.approx(1.0, abs=0.05)


def test_degrees_of_freedom_are_those_of_the_directions():
    rng = np.random.default_rng(2)
    for scale, expected in (([1.0, 1.0, 1.0], 3.0), ([1.0, 0.0, 0.0], 1.0), ([1.0, 1.0, 0.0], 2.0)):
        errors = 2e-3 * rng.normal(size=(4000, 3)) * scale
        found = forecast_of(errors, errors)
        assert found.freedom_of_row == pytest.approx(expected, rel=0.1)
        assert found.freedom == pytest.approx(4000 * found.freedom_of_row)
        assert found.rms == pytest.approx(2e-3 * np.sqrt(expected), rel=0.03)
        assert found.shared == pytest.approx(0.0, abs=1e-15)


def test_rows_of_one_pose_count_as_one():
    rng = np.random.default_rng(3)
    errors = np.repeat(rng.normal(size=(500, 3)), 4, axis=0)
    poses = np.repeat(np.arange(500), 4)
    none = np.zeros(2000, dtype=bool)
    by_pose = fresh_error(errors, errors, poses, none, 6000)
    by_row = fresh_error(errors, errors, np.arange(2000), none, 6000)
    assert by_pose.rms == by_row.rms
    assert by_pose.freedom == pytest.approx(by_row.freedom / 4.0, rel=0.06)


def test_what_the_fit_takes_up_is_shared_by_all_fresh_rows():
    rng = np.random.default_rng(4)
    fitted, held_out, _ = fitted_rows(rng, ERRORS["normal"], 100, 60, 1)
    found = forecast_of(fitted, held_out)
    # Sixty parameters of 300 scalars.
    assert found.shared == pytest.approx(0.2 / 300.0, rel=0.1)
    assert found.freedom == pytest.approx(0.8 * 100.0 * found.freedom_of_row, rel=0.05)


def test_the_interval_narrows_with_rows_to_what_the_fit_leaves_uncertain():
    found = FreshError("m", 10.0, 1e-3, 50.0, 2.5, 1e-3, 0.0, 25)
    widths = [replace(found, rows=rows) for rows in (1.0, 3.0, 10.0, 100.0, 1e6)]
    assert all(a.low < b.low < b.rms < b.high < a.high for a, b in itertools.pairwise(widths))
    endless = replace(found, rows=np.inf)
    assert endless.spread == pytest.approx(np.sqrt(0.5 * (1e-3 + 1.0 / 50.0)))
    assert widths[-1].spread == pytest.approx(endless.spread, rel=1e-4)
    # Nothing uncertain, and all rows there are: one value.
    exact = replace(endless, freedom=np.inf, shared=0.0)
    assert (exact.low, exact.high) == (1e-3, 1e-3)
    # 90 % of a normal variable is within 1.645 standard deviations.
    assert np.log(found.high / found.rms) == pytest.approx(1.644854 * found.spread)


def test_outliers_are_told_among_held_out_and_fresh_rows_alike():
    rng = np.random.default_rng(5)
    errors = 1e-3 * rng.normal(size=(60, 3))
    clean = forecast_of(errors, errors)
    wild = errors.copy()
    wild[[3, 17]] = 0.05
    flagged = np.zeros(60, dtype=bool)
    flagged[[3, 17, 30]] = True  # the last one is as good as others
    found = fresh_error(wild, wild, np.arange(60), flagged, 180)
    assert found.outliers == pytest.approx(2.0 / 60.0)
    others = np.delete(errors, [3, 17], axis=0)
    assert found.rms == pytest.approx(np.sqrt(np.mean(np.sum(others**2, axis=1))))
    assert clean.outliers == 0.0

    lengths = np.linalg.norm(1e-3 * rng.normal(size=(50, 3)), axis=1)
    fresh = found.compared([*lengths, 0.05, 0.04])
    assert (fresh.outliers, fresh.forecast.rows) == (2, 50.0)
    assert fresh.rms == pytest.approx(np.sqrt(np.mean(lengths**2)))


def test_a_pose_alone_has_one_degree_of_freedom():
    """By the tail of F(1, 1), which is Cauchy's squared, one of two rows is an outlier from 127 times the other on."""
    errors = np.array([[1e-3, 0.0, 0.0], [0.0, 0.2, 0.0]])
    found = fresh_error(errors, errors, np.arange(2), np.array([False, True]), 6)
    assert (found.freedom, found.freedom_of_row, found.outliers) == (1.0, 1.0, 0.5)
    assert found.rms == pytest.approx(1e-3)
    assert found.limit == pytest.approx(1e-3 / np.tan(0.25 * np.pi * 0.01))
    errors[1] *= 0.5
    found = fresh_error(errors, errors, np.arange(2), np.array([False, True]), 6)
    assert found.outliers == 0.0
    assert found.rms == pytest.approx(np.sqrt(0.5 * (1e-6 + 1e-2)))


def test_rows_without_errors_say_as_little_as_one():
    nothing = np.zeros((8, 3))
    found = forecast_of(nothing, nothing)
    assert (found.rms, found.freedom, found.freedom_of_row) == (0.0, 1.0, 0.125)


def test_a_table_without_outliers_has_none_in_99_of_100():
    rng = np.random.default_rng(6)
    count = 0
    for _ in range(400):
        errors = rng.normal(size=(50, 3))
        count += forecast_of(errors, errors).outliers > 0.0
    assert count <= 12


def test_fresh_rows_are_placed_in_the_distribution():
    found = FreshError("m", 10.0, 1e-3, 50.0, 2.5, 0.0, 0.0, 25)
    same = found.compared(np.full(8, 1e-3))
    assert same.forecast == replace(found, rows=8.0)
    assert (same.probability, same.within, same.above) == (0.5, True, False)
    high, low = same.forecast.high, same.forecast.low
    assert found.compared(np.full(8, high)).probability == pytest.approx(0.95)
    assert found.compared(np.full(8, low)).probability == pytest.approx(0.05)
    over, under = found.compared(np.full(8, 1.01 * high)), found.compared(np.full(8, 0.99 * low))
    assert (over.within, over.above) == (under.within, not under.above) == (False, True)
    assert found.compared(np.zeros(8)).probability == 0.0
    # If all are far off, they are no accidents.
    assert found.compared(np.ones(8)).outliers == 0
    with pytest.raises(ArgumentError):
        found.compared([])
    with pytest.raises(ModelError):
        found.compared([[1e-3]])


def test_forecast_of_a_calibration(calibrated, tmp_path):
    _, c = calibrated("points")
    found = c.forecast()
    held_out = c.part(non_geometric=True).cross_validation
    assert found.rows == found.held_out == len(held_out.residual)
    assert found.rms == pytest.approx(held_out.errors_without_outliers["m"].rms, rel=0.05)
    fresh = c.rows.validation
    errors = np.linalg.norm(c.rows.residual_calibrated[fresh][:, :3], axis=1)
    place = c.forecast(non_geometric=False).compared(errors)
    assert place.outliers == 0
    assert 1e-3 < place.probability < 0.999
    assert c.forecast(rows=5).spread > found.spread > c.forecast(rows=np.inf).spread
    assert found.table()["m"]["high"] == found.high

    path = c.write_json(tmp_path / "result.json")
    assert Calibration.read_json(path).forecast() == found

    without = replace(c, geometry=replace(c.geometry, cross_validation=None))
    assert forecast(without, non_geometric=False) is None
    with pytest.raises(ArgumentError):
        c.forecast(rows=0)
    with pytest.raises(ArgumentError):
        c.forecast(rows="20")
    with pytest.raises(ArgumentError):
        c.forecast(joints=np.zeros((0, 6)))


def test_where_nothing_was_measured_the_forecast_is_larger(calibrated):
    _, c = calibrated("points")
    q = random_joint_values(c.nominal, 40, 1)
    everywhere = c.forecast(joints=q)
    assert everywhere.rows == 40.0
    assert everywhere.rms >= c.forecast().rms
    # With parameters that are known far worse it is what the uncertainty says.
    loose = replace(c.geometry, covariance=1e4 * c.geometry.covariance)
    worse = replace(c, geometry=loose, non_geometric=None)
    std = worse.uncertainty(q).position_std
    assert worse.forecast(joints=q).rms == pytest.approx(np.sqrt(np.mean(std**2)), rel=0.1)


def test_of_stations_that_are_held_out_whole_poses_are_forecast(calibrated):
    _, c = calibrated("set-ups")
    geometry = c.geometry
    assert geometry.cross_validation.holds_out_stations
    assert not geometry.pose_validation.holds_out_stations
    assert len(geometry.pose_validation.residual) == len(geometry.cross_validation.residual)
    found = c.forecast(non_geometric=False)
    by_poses = geometry.pose_validation.errors_without_outliers["m"].rms
    assert found.rms == pytest.approx(by_poses, rel=0.05)
    assert calibrated("points")[1].geometry.pose_validation is None
