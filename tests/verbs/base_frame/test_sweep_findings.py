"""What residuals say beside noise, and the sense of turning."""

import numpy as np
import pytest

from calib.errors import CalibError
from calib.verbs.base_frame.circles import fit_circle
from calib.verbs.base_frame.sweep_findings import SweepFinding, findings, with_positive_sense
from calib.verbs.base_frame.sweeps import Sweep

SIGMA = 33e-6
N = 40


def sweep(
    arc: float,
    *,
    move: np.ndarray | None = None,
    seed: int = 0,
    sigma: float | None = None,
) -> Sweep:
    """A sweep about z, radius 0.3 m, with something added to its points along (radius, z)."""
    t = np.radians(np.linspace(-arc / 2, arc / 2, N))
    e = np.column_stack([np.cos(t), np.sin(t), 0 * t])
    points = 0.3 * e + SIGMA * np.random.default_rng(seed).normal(size=(N, 3))
    if move is not None:
        points = points + move[:, :1] * e + move[:, 1:] * [0.0, 0.0, 1.0]
    given = None if sigma is None else np.full(N, sigma)
    return Sweep(0, "pan", points, given, None, tuple(range(21, 21 + N)), "s.csv")


def found(swept: Sweep) -> tuple[SweepFinding, ...]:
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
    move = np.zeros((N, 2))
    move[:, int(axial)] = 1e-4 * np.cos(lobes * angles(330.0))
    (said,) = found(sweep(330.0, move=move))
    assert said.code == ("axial" if axial else "radial")
    assert said.value > 0.5


def test_a_gross_row_is_named_left_out_or_not():
    move = np.zeros((N, 2))
    move[7] = [1e-3, 0.0]
    swept = sweep(200.0, move=move)
    (said,) = found(swept)
    assert (said.code, said.where) == ("gross", "s.csv, row 28 (sweep 'pan')")
    assert said.value == pytest.approx(1e-3, abs=1e-4)


def test_sigma_that_is_too_small():
    (said,) = found(sweep(200.0, sigma=1e-5))
    assert (said.code, said.value) == ("scatter", pytest.approx(2.9, abs=0.1))
    assert found(sweep(200.0, sigma=SIGMA)) == ()


Z = np.array([0.0, 0.0, 1.0])


def turned(
    q: np.ndarray, *, sense: float = 1.0, values: bool = True, sigma: float = SIGMA, seed: int = 0
):
    """A circle about z, or -z, of radius 0.3 m, whose joint b says q, and what `positive` needs with it."""
    points = 0.3 * np.column_stack([np.cos(sense * q), np.sin(sense * q), 0.0 * q])
    points = points + sigma * np.random.default_rng(seed).normal(size=points.shape)
    joints = np.column_stack([np.full_like(q, 0.3), q]) if values else None
    return fit_circle(points), joints, 1, ("a", "b")


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("arc", [20.0, 120.0, 300.0, 700.0])
def test_the_sign_comes_from_the_values(arc: float, sense: float):
    q = np.radians(np.random.default_rng(1).uniform(0.0, arc, size=40))
    swept = turned(q, sense=sense)
    assert with_positive_sense(*swept).normal @ Z == pytest.approx(sense, abs=1e-4)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("arc", [20.0, 120.0, 300.0])
def test_or_from_the_order_of_the_rows(arc: float, sense: float):
    swept = turned(np.radians(np.linspace(40.0, 40.0 + arc, 40)), sense=sense, values=False)
    assert with_positive_sense(*swept).normal @ Z == pytest.approx(sense, abs=1e-4)


def test_rows_both_ways_need_values():
    there = np.radians(np.linspace(0.0, 100.0, 20))
    q = np.concatenate([there, there[::-1]])
    back = turned(q, values=False)
    with pytest.raises(CalibError, match="the points go round"):
        with_positive_sense(*back)
    known = turned(q)
    assert with_positive_sense(*known).normal @ Z == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("joints", "said"),
    [([0.0, 0.0], "'a' 0 deg, 'b' 0 deg"), ([0.1, 1.0], "'a' 5.73 deg, 'b' 57.3 deg")],
)
def test_the_columns_show_another_joint(joints: list[float], said: str):
    q = np.linspace(0.0, 1.0, 20)
    circle, _, *names = turned(q)
    with pytest.raises(CalibError, match=said):
        with_positive_sense(circle, q[:, None] * joints, *names)
