"""What residuals say beside noise, the sense of turning, and how far a joint turned against its own values."""

from dataclasses import replace

import numpy as np
import pytest

from calib.circle_points.fits import fit_circle
from calib.circle_points.survey import Finding, findings
from calib.circle_points.sweeps import Sweep, Turning, check_joint, positive, turning
from calib.errors import MeasurementError

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


def found(swept: Sweep) -> tuple[Finding, ...]:
    return tuple(findings(swept, fit_circle(swept.points, swept.sigma)))


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
    assert said.code == ("axial" if axial else "radial")
    assert said.values["correlation"] > 0.5


def test_a_gross_row_is_named_left_out_or_not():
    move = np.zeros((N, 3))
    move[7] = [1e-3, 0.0, 0.0]
    swept = sweep(200.0, move=move)
    (said,) = found(swept)
    assert (said.code, said.where) == ("gross", "s.csv, row 28 (sweep 'pan')")
    assert said.values["off_mm"] == pytest.approx(1.0, abs=0.1)


def test_sigma_that_is_too_small():
    (said,) = found(sweep(200.0, sigma=1e-5))
    assert said.code == "scatter"
    assert said.values == pytest.approx({"scatter_mm": 0.029, "sigma_mm": 0.01}, abs=1e-3)
    assert found(sweep(200.0, sigma=SIGMA)) == ()


def test_gains_and_once_per_turn_errors_are_told_where_they_are_no_chance():
    swept = sweep(200.0)
    circle = fit_circle(swept.points)
    own = Turning(1e-4, -1e-3, 1e-4, True, 2e-3, 1e-4, True)
    told, once = findings(swept, circle, own)
    assert (told.code, told.values["gain"]) == ("gain", -1.0)
    assert (once.code, once.values["eccentricity"]) == ("eccentricity", 2.0)
    chance = replace(own, gain_found=False, eccentricity_found=False)
    assert tuple(findings(swept, circle, chance)) == ()


NAMES = ("a", "b")
Z = np.array([0.0, 0.0, 1.0])


def turned(
    q: np.ndarray, *, sense: float = 1.0, values: bool = True, sigma: float = SIGMA, seed: int = 0
):
    """A sweep about z, or -z, of radius 0.3 m, whose joint b says q."""
    points = 0.3 * np.column_stack([np.cos(sense * q), np.sin(sense * q), 0.0 * q])
    points = points + sigma * np.random.default_rng(seed).normal(size=points.shape)
    joints = np.column_stack([np.full_like(q, 0.3), q]) if values else None
    return Sweep(1, "b", points, None, joints, tuple(range(1, len(q) + 1)), "s.csv")


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("arc", [20.0, 120.0, 300.0, 700.0])
def test_the_sign_comes_from_the_values(arc: float, sense: float):
    q = np.radians(np.random.default_rng(1).uniform(0.0, arc, size=40))
    swept = turned(q, sense=sense)
    assert positive(swept, fit_circle(swept.points)).normal @ Z == pytest.approx(sense, abs=1e-4)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("arc", [20.0, 120.0, 300.0])
def test_or_from_the_order_of_the_rows(arc: float, sense: float):
    swept = turned(np.radians(np.linspace(40.0, 40.0 + arc, 40)), sense=sense, values=False)
    assert positive(swept, fit_circle(swept.points)).normal @ Z == pytest.approx(sense, abs=1e-4)


def test_rows_both_ways_need_values():
    there = np.radians(np.linspace(0.0, 100.0, 20))
    q = np.concatenate([there, there[::-1]])
    back = turned(q, values=False)
    with pytest.raises(
        MeasurementError, match=r"^s.csv, sweep 'b' \(rows 1 to 40\): the points go round"
    ):
        positive(back, fit_circle(back.points))
    known = turned(q)
    assert positive(known, fit_circle(known.points)).normal @ Z == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("joints", "said"),
    [([0.0, 0.0], "'a' 0 deg, 'b' 0 deg"), ([0.1, 1.0], "'a' 5.73 deg, 'b' 57.3 deg")],
)
def test_the_columns_show_another_joint(joints: list[float], said: str):
    q = np.linspace(0.0, 1.0, 20)
    with pytest.raises(MeasurementError, match=said):
        check_joint(replace(turned(q), joints=q[:, None] * joints), NAMES)
    check_joint(turned(q), NAMES)
    check_joint(turned(q, values=False), NAMES)


def test_gain_and_eccentricity_are_found_with_their_uncertainty():
    q = np.radians(np.linspace(-135.0, 135.0, 40))
    said = q / 1.002
    found = []
    for seed in range(60):
        swept = replace(turned(q, seed=seed), joints=np.column_stack([0 * q, said]))
        found.append(turning(swept, positive(swept, fit_circle(swept.points))))
    gains = np.array([t.gain for t in found])
    assert gains.mean() == pytest.approx(2e-3, abs=1e-5)
    assert gains.std() == pytest.approx(np.mean([t.gain_std for t in found]), rel=0.35)
    assert all(t.gain_found for t in found)
    assert sum(t.eccentricity_found for t in found) <= 2


@pytest.mark.slow
def test_without_errors_nothing_is_found():
    q = np.radians(np.linspace(-135.0, 135.0, 40))
    found = []
    for seed in range(300):
        swept = turned(q, seed=seed)
        found.append(turning(swept, positive(swept, fit_circle(swept.points))))
    assert sum(t.gain_found or t.eccentricity_found for t in found) <= 3
    assert np.mean([t.rms for t in found]) == pytest.approx(SIGMA / 0.3, rel=0.1)
