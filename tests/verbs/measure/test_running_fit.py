"""The running fit: what it predicts of a stop, against finite differences and drawn noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.error_model import FRAME, TARGET
from calib.model.kinematics import Samples
from calib.robot.robot import Robot
from calib.verbs.measure.running_fit import RunningFit
from calib.verbs.simulate.virtual_session import known_cell
from tests.verbs.measure.sessions import (
    ANGLE,
    LENGTH,
    fit_of,
    good_readings,
    points_cell,
    readings_at,
    rms_of,
    virtual_cell,
)


@pytest.fixture(scope="module")
def virtual(ur3):
    return virtual_cell(ur3, points_cell("placement"))


@pytest.fixture(scope="module")
def tables(virtual) -> list[Measurements]:
    return good_readings(virtual, 60)


@pytest.fixture(scope="module")
def fit(virtual, tables) -> RunningFit:
    return fit_of(virtual, tables[:25])


@pytest.fixture(scope="module")
def pictures():
    arm = Robot.load("ur5", base="tool0", tip="base_link")
    cell = Cell(kind="pixel", model="zeros", sigma={"px": 0.3})
    return virtual_cell(arm, cell, 7)


def places_by(fit: RunningFit, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Position of the target at joint values (n, m) with parameters x, (n, 3)."""
    return np.asarray(fit.fitted.kinematics.poses(x, Samples.at(q))[:, :3, 3])


def noise_of(fit: RunningFit) -> float:
    """The noise of the fit, and four degrees of freedom of the stated one; not less than that of the fit."""
    estimate = fit.fitted.estimate
    square = estimate.freedom * estimate.sigma["m"] ** 2 + 4.0 * LENGTH**2
    return max(float(np.sqrt(square / (estimate.freedom + 4.0))), estimate.sigma["m"])


def test_a_stop_is_compared_with_what_is_predicted(fit, tables):
    estimate = fit.fitted.estimate
    for table in tables[25:30]:
        prediction = fit.predict(table)
        assert prediction is not None
        off = table.points[0] - places_by(fit, estimate.x, table.joints)[0]
        noise = noise_of(fit)
        assert prediction.y == pytest.approx(off / noise, rel=1e-9)
        assert prediction.residual == {"m": pytest.approx(np.linalg.norm(off))}


def test_its_covariance_is_that_of_noise_and_parameters(fit, tables):
    estimate = fit.fitted.estimate
    x, table = np.array(estimate.x), tables[30]
    steps = 1e-6
    slopes = []
    for k in range(len(x)):
        up, down = x.copy(), x.copy()
        up[k] += steps
        down[k] -= steps
        change = places_by(fit, up, table.joints) - places_by(fit, down, table.joints)
        slopes.append(change[0] / (2.0 * steps))
    A = np.array(slopes).T / estimate.sigma["m"]
    S = np.eye(3) + A @ estimate.covariance @ A.T
    prediction = fit.predict(table)
    assert prediction is not None
    assert pytest.approx(S, rel=1e-4) == prediction.S
    square = prediction.y @ np.linalg.inv(S) @ prediction.y / 3.0
    assert prediction.square == pytest.approx(square, rel=1e-4)
    usual = noise_of(fit) * np.sqrt(np.trace(S))
    assert prediction.usual == {"m": pytest.approx(usual, rel=1e-4)}


def squares_of(virtual, before: int, seeds: range) -> list[float]:
    """Squares of new stops by fits to so many, each with noise of its own."""
    squares = []
    for seed in seeds:
        tables = good_readings(virtual, before + 4, seed)
        fit = fit_of(virtual, tables[:before])
        predictions = [fit.predict(table) for table in tables[before:]]
        squares += [p.square for p in predictions if p is not None]
    return squares


@pytest.mark.slow
@pytest.mark.parametrize(("model", "before"), [("zeros", 15), ("placement", 25), ("placement", 60)])
def test_the_square_is_one_on_average(ur3, model, before):
    virtual = virtual_cell(ur3, points_cell(model))
    # With an estimated noise it is F(3, nu), whose mean is nu / (nu - 2).
    squares = squares_of(virtual, before, range(60))
    assert np.mean(squares) == pytest.approx(1.05, abs=0.15)


@pytest.mark.slow
def test_the_square_of_poses_is_one_on_average(ur3):
    cell = points_cell("placement", kind="pose")
    virtual = virtual_cell(ur3, replace(cell, sigma={"m": LENGTH, "rad": ANGLE}))
    squares = squares_of(virtual, 20, range(40))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_a_picture_is_six_numbers_whose_square_is_one_on_average(pictures):
    squares = []
    for seed in range(6):
        tables = good_readings(pictures, 16, seed)
        fit = fit_of(pictures, tables[:12])
        for table in tables[12:]:
            prediction = fit.predict(table)
            assert prediction is not None
            assert prediction.y.shape == (6,)
            assert prediction.S.shape == (6, 6)
            # Of many corners two numbers each; the residual is that of a corner.
            assert len(table) > 6
            assert 0.1 < prediction.residual["px"] < 3.0
            squares.append(prediction.square)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.35)


@pytest.mark.slow
def test_a_displaced_picture_is_far_off_in_its_six_numbers(pictures):
    tables = good_readings(pictures, 14, 3)
    fit = fit_of(pictures, tables[:13])
    good = fit.predict(tables[13])
    moved = dict(tables[13].readings)
    column = next(name for name in moved if name.startswith("u"))
    moved[column] = moved[column] + 20.0
    off = fit.predict(replace(tables[13], readings=moved))
    assert good is not None
    assert off is not None
    assert good.square < 10.0
    assert off.square > 100.0
    assert off.residual["px"] == pytest.approx(20.0, abs=2.0)


def test_nothing_is_predicted_for_other_targets_and_stations(fit, tables):
    table = tables[30]
    assert fit.predict(replace(table, targets=("another",))) is None
    assert fit.predict(replace(table, groups=("another",))) is None


def test_the_place_of_a_target_is_predicted(fit, virtual, tables):
    for table in tables[40:45]:
        place = fit.places(table.joints[0])
        truth = virtual.truth.poses(table.joints)[0, :3, 3]
        assert place.shape == (1, 3)
        assert np.linalg.norm(place[0] - truth) < 5e-4


def test_it_is_told_how_far_a_reading_is_from_other_poses(fit, tables):
    table = tables[30]
    q = np.array([table.joints[0], tables[31].joints[0], table.joints[0] + 0.01])
    distances = fit.distances(table, q)
    predicted = places_by(fit, fit.fitted.estimate.x, q)
    by_hand = [rms_of(table.points[0] - place) / LENGTH for place in predicted]
    assert distances == pytest.approx(by_hand, rel=1e-9)
    assert np.argmin(distances) == 0


@pytest.mark.parametrize("count", [17, 40])
def test_a_fit_that_begins_at_another_ends_where_a_cold_one_does(virtual, tables, count):
    robot, cell = virtual.truth.nominal, known_cell(virtual, 1)
    some = tables[:count]
    cold = RunningFit.of(robot, cell, some)
    half = RunningFit.of(robot, cell, tables[: count // 2])
    warm = RunningFit.of(robot, cell, some, half)
    assert cold is not None
    assert warm is not None
    q = np.array([table.joints[0] for table in tables])
    apart = np.linalg.norm(
        places_by(cold, cold.fitted.estimate.x, q) - places_by(warm, warm.fitted.estimate.x, q),
        axis=1,
    )
    prediction = cold.predict(tables[50])
    assert prediction is not None
    assert apart.max() < 1e-5 * prediction.usual["m"]
    std = np.sqrt(np.diag(cold.fitted.estimate.covariance))
    names = cold.fitted.kinematics.model.names
    assert names == warm.fitted.kinematics.model.names
    # Frame and target count from where they were registered, the robot's own parameters do not.
    parameters = cold.fitted.kinematics.model.parameters
    own = [k for k, p in enumerate(parameters) if not p.place.startswith((FRAME, TARGET))]
    assert len(own) == len(names) - 9
    off = (cold.fitted.estimate.x - warm.fitted.estimate.x)[own] / std[own]
    assert np.abs(off).max() < 1e-4
    assert cold.fitted.estimate.sigma["m"] == pytest.approx(warm.fitted.estimate.sigma["m"], 1e-6)


def test_too_few_stops_have_no_fit(virtual, tables):
    robot, cell = virtual.truth.nominal, known_cell(virtual, 1)
    assert RunningFit.of(robot, cell, []) is None
    assert RunningFit.of(robot, cell, tables[:1]) is None
    assert RunningFit.of(robot, cell, tables[:2]) is None
    several = RunningFit.of(robot, cell, tables[:4])
    assert several is not None
    assert several.count == 4


def test_rows_of_a_stop_with_several_targets_belong_to_it(ur3):
    cell = points_cell(targets={"a": [0.0, 0.0, 0.1], "b": [0.05, 0.0, 0.08]}, estimate_target=True)
    virtual = virtual_cell(ur3, cell)
    tables = good_readings(virtual, 9)
    assert [len(table) for table in tables] == [2] * 9
    fit = fit_of(virtual, tables[:8])
    assert fit.count == 8
    assert fit.stops.tolist() == [k for k in range(8) for _ in range(2)]
    prediction = fit.predict(tables[8])
    assert prediction is not None
    assert prediction.y.shape == (6,)
    assert fit.places(tables[8].joints[0]).shape == (2, 3)
    # One of the two alone is predicted too.
    alone = fit.predict(tables[8].select(np.array([False, True])))
    assert alone is not None
    assert alone.y == pytest.approx(prediction.y[3:], rel=1e-9)


def test_readings_at_the_same_seed_are_the_same(virtual):
    q = virtual.poses(2, 1)
    first, second = readings_at(virtual, [*q], 5), readings_at(virtual, [*q], 5)
    assert all((a.points == b.points).all() for a, b in zip(first, second, strict=True))
