"""Forecasts against calibrations that are made: of a model that is linear, whose fits are exact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.robot.ranges import spread_poses
from calib.verbs.plan.forecast import Forecast, Workspace, covariance_root, position_std
from calib.verbs.plan.sensitivity import Sensitivity

#: Sizes of the errors in truth, those of the priors too: lengths [m] and angles [rad].
UNITS = ("m", "m", "rad", "rad", "m", "rad", "rad")
TAU = np.array([2e-3, 1e-3, 4e-3, 2e-3, 3e-3, 5e-3, 1e-3])
NAMES = tuple("abcdefg")

_MIX = np.random.default_rng(1).normal(size=(6, 3, 7))


def jacobian(q: np.ndarray) -> np.ndarray:
    """How a position depends on seven parameters, at two joint values, shape (n, 3, 7)."""
    a, b = q.T
    features = np.stack(
        [np.ones_like(a), np.cos(a), np.sin(a), np.cos(b), np.sin(b), a * b], axis=1
    )
    return np.einsum("nf,fij->nij", features, _MIX)


def noise(q: np.ndarray) -> np.ndarray:
    """Of one coordinate [m]: larger far away."""
    return 2e-4 * (1.0 + 0.5 * np.abs(q[:, 0]))


@dataclass(frozen=True)
class Linear:
    """A model that is linear, in place of a robot's `Sensitivity`."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    measured: Callable[..., np.ndarray]
    located: Callable[[np.ndarray], np.ndarray]
    noise: Callable[[np.ndarray], np.ndarray]
    precision: np.ndarray
    analysed = Sensitivity.analysed

    def sigma_by_unit(self, q: np.ndarray) -> dict[str, float]:
        return {"m": float(np.sqrt(np.mean(self.noise(q) ** 2)))}


def covariance(of: Linear, measured: np.ndarray) -> np.ndarray:
    root = covariance_root(measured, of.precision)
    return root @ root.T


def sensitivity(precision: np.ndarray | None = None) -> Linear:
    return Linear(
        names=NAMES,
        units=UNITS,
        measured=lambda q, _moves=None, _seen=None: jacobian(q) / noise(q)[:, None, None],
        located=jacobian,
        noise=noise,
        precision=1.0 / TAU**2 if precision is None else precision,
    )


def poses(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.5, 1.5, size=(count, 2))


def calibrations(q: np.ndarray, runs: int, *, priors: bool = True) -> np.ndarray:
    """What so many calibrations leave of the errors, shape (runs, 7): drawn, measured, and fitted by least squares."""
    rng = np.random.default_rng(99)
    sigma = np.repeat(noise(q), 3)
    J = jacobian(q).reshape(-1, 7)
    truth = TAU[:, None] * rng.normal(size=(7, runs))
    measured = J @ truth + sigma[:, None] * rng.normal(size=(len(J), runs))
    rows, values = J / sigma[:, None], measured / sigma[:, None]
    if priors:
        rows = np.concatenate([rows, np.diag(1.0 / TAU)])
        values = np.concatenate([values, np.zeros((7, runs))])
    return (np.linalg.lstsq(rows, values, rcond=None)[0] - truth).T


# The parameters


def test_the_covariance_is_that_of_what_fits_leave():
    q = poses(4)
    left = calibrations(q, 40_000)
    found = covariance(sensitivity(), sensitivity().measured(q))
    np.testing.assert_allclose(np.sqrt(np.diag(found)), left.std(axis=0), rtol=0.02)
    scale = left.std(axis=0)
    np.testing.assert_allclose(found / np.outer(scale, scale), np.corrcoef(left.T), atol=0.03)


# The workspace


@pytest.mark.parametrize("count", [3, 12])
def test_the_rms_over_the_workspace_and_its_range_are_those_of_calibrations(count):
    q, where = poses(count), poses(60, 1)
    left = calibrations(q, 20_000)
    off = np.einsum("nij,rj->rni", jacobian(where), left)
    rms = np.sqrt(np.mean(np.sum(off**2, axis=2), axis=1))
    f = Forecast.of(sensitivity(), Workspace.of(sensitivity(), where), q)
    assert f.rms == pytest.approx(np.sqrt(np.mean(rms**2)), rel=0.02)
    inside = (rms > f.rms_low) & (rms < f.rms_high)
    assert 0.88 < np.mean(inside) < 0.92
    assert 0.04 < np.mean(rms < f.rms_low) < 0.06
    each = np.sqrt(np.mean(np.sum(off**2, axis=2), axis=0))
    assert f.max == pytest.approx(each.max(), rel=0.04)


def test_at_single_poses_the_standard_deviations_are_those_whose_rms_the_workspace_has(ur3):
    cell = Cell(model="zeros", target=[0.0, 0.05, 0.1])
    measured, where = spread_poses(ur3, 8), spread_poses(ur3, 30)
    single = position_std(Sensitivity.of(ur3, cell), measured, where)
    assert single.shape == (30, 1)
    of_ur3 = Sensitivity.of(ur3, cell)
    f = Forecast.of(of_ur3, Workspace.of(of_ur3, where), measured)
    assert np.sqrt(np.mean(single**2)) == pytest.approx(f.rms)
    assert single.max() == pytest.approx(f.max)


# In the noise of what is measured


# Priors off
