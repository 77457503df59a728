"""Algebraic circles: exact on exact points, biased by noise as they are known to be."""

import numpy as np
import pytest

from calib.errors import CalibError
from calib.measure.algebraic_circles import METHODS, algebraic_circle, principal_axes

CENTER = np.array([1.0, -2.0, 0.5])
B = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]


def arc(degrees: float, count: int = 40, radius: float = 0.3) -> np.ndarray:
    t = np.radians(np.linspace(-degrees / 2, degrees / 2, count))
    return CENTER + radius * (np.cos(t)[:, None] * B[:, 0] + np.sin(t)[:, None] * B[:, 1])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("degrees", [20.0, 120.0, 350.0])
def test_exact_points_give_the_circle(method: str, degrees: float):
    ring = algebraic_circle(arc(degrees), method)
    assert ring.center == pytest.approx(CENTER, abs=1e-9)
    assert ring.radius == pytest.approx(0.3, abs=1e-9)
    assert abs(ring.normal @ B[:, 2]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_weights_count_as_repeated_points(method: str):
    points = arc(100.0) + 1e-3 * np.random.default_rng(0).normal(size=(40, 3))
    twice = np.concatenate([points, points[:10]])
    weighted = algebraic_circle(points, method, np.where(np.arange(40) < 10, 2.0, 1.0))
    repeated = algebraic_circle(twice, method)
    assert weighted.center == pytest.approx(repeated.center, abs=1e-9)
    assert weighted.radius == pytest.approx(repeated.radius, abs=1e-9)


def test_three_points_are_enough():
    for method in METHODS:
        assert algebraic_circle(arc(200.0, 3), method).center == pytest.approx(CENTER, abs=1e-9)


def test_noise_makes_kasas_circle_too_small_on_a_short_arc_and_not_the_others():
    rng = np.random.default_rng(0)
    points = arc(30.0)
    noise = 1e-4 * rng.normal(size=(100, 40, 3))
    toward = {
        method: np.mean(
            [
                algebraic_circle(points + s * e, method).center @ B[:, 0]
                for e in noise
                for s in (1, -1)
            ]
        )
        - CENTER @ B[:, 0]
        for method in METHODS
    }
    assert toward["kasa"] == pytest.approx(265e-6, rel=0.15)
    assert abs(toward["pratt"]) < 0.1 * toward["kasa"]
    assert abs(toward["taubin"]) < 0.1 * toward["kasa"]


def test_what_cannot_be_fitted():
    line = np.linspace(0.0, 1.0, 9)[:, None] * np.array([1.0, 2.0, 3.0])
    with pytest.raises(CalibError, match=r"^the points lie on a line"):
        algebraic_circle(line)
    with pytest.raises(CalibError, match=r"^'best' is no way .* 'kasa', 'pratt', 'taubin'\.$"):
        algebraic_circle(arc(90.0), "best")


def test_principal_axes_are_a_right_handed_basis_longest_first():
    points = np.random.default_rng(1).normal(size=(500, 3)) * [1.0, 3.0, 2.0]
    mean, basis, spread = principal_axes(points, np.ones(500))
    assert mean == pytest.approx(points.mean(axis=0))
    assert np.linalg.det(basis) == pytest.approx(1.0)
    assert np.abs(basis[:, 0]) == pytest.approx([0, 1, 0], abs=0.1)
    assert spread == pytest.approx([3.0, 2.0, 1.0], rel=0.1)
