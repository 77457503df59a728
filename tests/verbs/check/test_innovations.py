"""Innovations against points by Pinocchio, and their covariance against draws of the parameters and the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.stats import multivariate_t

from calib.data.cell import Cell
from calib.verbs.check.check import fresh_stops
from calib.verbs.check.innovations import LEVER, StoredResult, _tails, numbered_as, stacked
from tests.verbs.check.shop import JOINTS, POSES, paper_result, points


@pytest.fixture(scope="module")
def stored() -> StoredResult:
    return StoredResult.of(paper_result())


def innovations(stored: StoredResult, **moved: object) -> np.ndarray:
    stops = fresh_stops(stored, points(**moved), Cell())  # type: ignore[arg-type]
    return np.concatenate([stop.y for stop in stops])


def test_without_noise_nothing_is_left(stored: StoredResult):
    assert np.abs(innovations(stored)).max() < 1e-4


def test_displacements_are_those_of_pinocchio(stored: StoredResult):
    """A millionth of a metre or radian, of the base, the target and each joint."""
    stops = fresh_stops(stored, points(), Cell())
    D = np.concatenate([stop.by_displacements for stop in stops])
    before = innovations(stored)
    names = stored.displaced.model.names
    step = 1e-6
    for k, direction in enumerate(("x", "y", "z", "rx", "ry", "rz")):
        frame = pin.exp6(step * np.eye(6)[k]).homogeneous
        change = (innovations(stored, frame=frame) - before) / step
        np.testing.assert_allclose(
            D[:, names.index(f"frame_{direction}")], change, atol=2e-3 * np.abs(D).max()
        )
    R = stored.part.setup.T_tip_target[0, :3, :3]
    for k, direction in enumerate("xyz"):
        change = (innovations(stored, target=tuple(step * R[:, k])) - before) / step
        np.testing.assert_allclose(
            D[:, names.index(f"target_{direction}")], change, atol=2e-3 * np.abs(D).max()
        )
    for k, name in enumerate(JOINTS):
        zeros = tuple(step * np.eye(6)[k])
        change = (innovations(stored, zeros=zeros) - before) / step
        np.testing.assert_allclose(
            D[:, names.index(f"{name}.zero")], change, atol=2e-3 * np.abs(D).max()
        )


def test_the_whitened_numbers_have_the_covariance_of_noise_and_parameters(stored: StoredResult):
    stops = fresh_stops(stored, points(), Cell())
    rng = np.random.default_rng(0)
    draws = 20_000
    J = np.concatenate([stop.by_parameters for stop in stops])
    drawn = J @ rng.standard_normal((J.shape[1], draws)) + rng.standard_normal((9, draws))
    whitened = []
    for y in drawn.T[:2000]:
        parts = np.split(y, 3)
        whitened.append(
            stacked([replace(stop, y=part) for stop, part in zip(stops, parts, strict=True)]).y
        )
    np.testing.assert_allclose(np.cov(np.array(whitened).T), np.eye(9), atol=0.12)
    # The parameters' error is the result's: in metres of the covariance of its predictions.
    sigma = stored.sigma["m"]
    expected = paper_result().position_std(POSES) ** 2
    by_pose = sigma**2 * np.sum(J**2, axis=1).reshape(3, 3).sum(axis=1)
    scale = stored.part.change_by_scale
    if not np.any(scale):
        np.testing.assert_allclose(by_pose, expected, rtol=1e-6)


def test_a_stop_alone_is_displaced_by_shift_and_turn(stored: StoredResult):
    stop = fresh_stops(stored, points(), Cell())[0]
    np.testing.assert_allclose(stop.by_target[:, :3], np.eye(3) / stored.sigma["m"])
    assert stop.by_target[:, 3:] == pytest.approx(np.zeros((3, 3)))
    assert LEVER == 0.3


def test_repeats_count_as_one_row_if_nothing_is_known_of_them(stored: StoredResult):
    once = points()
    twice = points(np.repeat(POSES, 2, axis=0))
    stops, repeated = (fresh_stops(stored, table, Cell()) for table in (once, twice))
    assert [len(stop.y) for stop in repeated] == [6, 6, 6]
    J, J2 = (stacked(of).by_displacements for of in (stops, repeated))
    np.testing.assert_allclose(J2.T @ J2, J.T @ J, rtol=1e-6, atol=1e-6 * np.abs(J.T @ J).max())


def test_names_are_those_of_the_result():
    index = np.array([0, 1, 0])
    assert numbered_as(("b", "a"), ("a", "b"), index) is not None
    np.testing.assert_array_equal(numbered_as(("b", "a"), ("a", "b"), index), [1, 0, 1])  # type: ignore[arg-type]
    assert numbered_as(("b", "c"), ("a", "b"), index) is None
    np.testing.assert_array_equal(numbered_as(("new",), ("old",), np.zeros(2, int)), [0, 0])  # type: ignore[arg-type]


@pytest.mark.parametrize(("nu", "most"), [(6.0, 25.0), (np.inf, np.inf)])
def test_tails_of_residuals_are_those_of_a_t(nu: float, most: float):
    """Of 2,000 rows of three coordinates with one scale each, as SciPy has a multivariate t."""
    result = paper_result()
    draws = multivariate_t(shape=np.eye(3), df=nu).rvs(2000, random_state=4)
    rows = result.rows
    chosen = np.resize(np.flatnonzero(rows.estimation), 2000)
    scaled = replace(
        rows,
        numbers=tuple(range(2000)),
        sets=("estimate",) * 2000,
        residual_calibrated=draws * result.noise.sigma["m"],
        channels=rows.channels.select(chosen),
        weights=np.ones(2000),
    )
    found = _tails(replace(result, rows=scaled))
    assert (4.0 < found < most) if np.isfinite(most) else found > 100.0
