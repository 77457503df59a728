"""What residuals say beside noise: each cause is named, and noise alone is not."""

import numpy as np
import pytest

from calib.base_frame.checks import circle_findings, plane_findings, turning_findings
from calib.base_frame.fits import fit_circle, fit_plane
from calib.base_frame.sweeps import Sweep
from calib.base_frame.turning import Turning

SIGMA = 33e-6
N = 40


def sweep(
    arc: float,
    *,
    move: np.ndarray | None = None,
    seed: int = 0,
    count: int = N,
    sigma: float | None = None,
) -> Sweep:
    """A sweep about z, radius 0.3 m, with something added to its points along (radius, tangent, z)."""
    t = np.radians(np.linspace(-arc / 2, arc / 2, count))
    e = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    around = np.column_stack([-np.sin(t), np.cos(t), 0 * t])
    points = 0.3 * e + SIGMA * np.random.default_rng(seed).normal(size=(count, 3))
    if move is not None:
        points = points + move[:, :1] * e + move[:, 1:2] * around + move[:, 2:] * [0.0, 0.0, 1.0]
    given = None if sigma is None else np.full(count, sigma)
    return Sweep(0, "pan", points, given, None, tuple(range(21, 21 + count)), "s.csv")


def found(swept: Sweep, *, robust: bool = True) -> tuple[str, ...]:
    circle = fit_circle(swept.points, swept.sigma, robust=robust)
    return circle_findings(swept, circle, "pan")


def angles(arc: float) -> np.ndarray:
    return np.radians(np.linspace(-arc / 2, arc / 2, N))


@pytest.mark.slow
@pytest.mark.parametrize("arc", [60.0, 180.0, 270.0])
def test_noise_is_noise(arc: float):
    alarms = sum(bool(found(sweep(arc, seed=seed))) for seed in range(100))
    assert alarms <= 2  # each of four tests is wrong in a thousandth of the sweeps


@pytest.mark.parametrize("lobes", [2, 3])
@pytest.mark.parametrize("axial", [False, True])
def test_lobes_of_a_bearing_make_neighbours_err_alike(lobes: int, axial: bool):
    move = np.zeros((N, 3))
    move[:, 2 if axial else 0] = 1e-4 * np.cos(lobes * angles(330.0))
    (said,) = found(sweep(330.0, move=move))
    assert f"err alike {'axially' if axial else 'radially'} (correlation 0." in said


@pytest.mark.parametrize("row", [5, 20, 33])
def test_and_so_does_a_target_that_moved_on_its_link(row: int):
    move = np.zeros((N, 3))
    move[row:] = [2e-4, 1e-4, -2e-4]
    said = found(sweep(270.0, move=move))
    assert said
    assert all("err alike" in text for text in said)


def test_a_gross_row_is_named_left_out_or_not():
    move = np.zeros((N, 3))
    move[7] = [1e-3, 0.0, 0.0]
    swept = sweep(200.0, move=move)
    (said,) = found(swept)
    assert said.startswith("s.csv, row 28 (sweep 'pan') is 1.0")
    assert said.endswith("mm off and left out: measure it again.")
    kept = found(swept, robust=False)
    assert kept[0].endswith("mm off and counts all the same: measure it again.")


def test_neighbours_that_err_alike():
    move = np.zeros((N, 3))
    move[:, 0] = 1e-4 * np.sin(
        2.0 * np.pi * np.arange(N) / 13.0
    )  # 18 times per turn: not looked for
    (said,) = found(sweep(60.0, move=move))
    assert "neighbouring points of 'pan' err alike radially (correlation 0." in said


def test_sigma_that_is_too_small():
    (said,) = found(sweep(200.0, sigma=1e-5))
    assert "the points scatter by 0.029 mm" in said
    assert "sigma says 0.01 mm. The uncertainty is that of the scatter." in said
    assert found(sweep(200.0, sigma=SIGMA)) == ()


def plane(bend: float = 0.0, gross: float = 0.0, seed: int = 0) -> tuple[str, ...]:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-0.25, 0.25, size=(20, 2))
    points = np.column_stack([xy, bend * (xy**2).sum(axis=1)]) + SIGMA * rng.normal(size=(20, 3))
    points[4, 2] += gross
    swept = Sweep(None, "plane", points, None, None, tuple(range(1, 21)), "s.csv")
    return plane_findings(swept, fit_plane(points))


def test_planes():
    assert sum(bool(plane(seed=seed)) for seed in range(100)) <= 2
    (bent,) = plane(bend=5e-3)
    assert bent.startswith(
        "s.csv, sweep 'plane' (rows 1 to 20): the surface is not flat but bent, by 0."
    )
    (gross,) = plane(gross=1e-3)
    assert gross.startswith("s.csv, row 5 (sweep 'plane') is ")


def turned(gain: float, once: float, *, found: bool) -> Turning:
    return Turning(1e-4, gain, 1e-4, once, 1e-4, found, found)


def test_gains_and_once_per_turn_errors_are_told_where_they_are_no_chance():
    assert turning_findings("pan", None) == ()
    assert turning_findings("pan", turned(1e-3, 1e-3, found=False)) == ()
    less, once = turning_findings("pan", turned(-1e-3, 2e-3, found=True))
    assert "1.000 mrad per rad less" in less
    assert "2.000 mrad once per turn" in once
    assert "further" in turning_findings("pan", turned(1e-3, 2e-3, found=True))[0]
