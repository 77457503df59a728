"""What has moved: against refits with an explicit displacement, and in cells where something is knocked or nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pinocchio as pin
import pytest

from calib.data.priors import Priors
from calib.verbs.measure.moved import Moved, _scans, find_moved
from calib.verbs.measure.running_fit import RunningFit
from calib.verbs.simulate.operator import BASE_MOVED, TARGET_MOVED, Mistakes, Operator
from tests.verbs.measure.sessions import (
    ANGLE,
    LENGTH,
    fit_of,
    good_readings,
    points_cell,
    virtual_cell,
)

#: Stops before which frames and targets are not determined.
FIRST = 6


def knocked(virtual, code: str, at: int, count: int, seed: int = 1, size: float = 1e-3):
    """Readings at random poses; before the one of number ``at`` something is knocked."""
    mistakes = Mistakes(at={at: code}, moved_length=(size, size))
    operator = Operator.of(virtual, seed, mistakes)
    tables = [operator.measure(q).readings for q in virtual.poses(count, seed)]
    assert [mistake.code for mistake in operator.knocked] == [code]
    return tables


@pytest.fixture(scope="module")
def virtual(ur3):
    return virtual_cell(ur3, points_cell())


@pytest.fixture(scope="module")
def given(ur3):
    """Of a fit whose priors are stated, as those of the scan are."""
    return virtual_cell(ur3, points_cell("placement", priors=Priors("given")))


def slopes_of(fit: RunningFit, what: Literal["target", "base"]) -> np.ndarray:
    """Change of each residual with a displacement of the target or the base, by differences, (N, 3, c)."""
    setup = fit.fitted.estimated_setup()
    tips = fit.fitted.tip_poses(fit.rows.samples)
    step, columns = 1e-6, []
    for k in range(6 if what == "base" else 3):
        places = []
        for sign in (1.0, -1.0):
            twist = np.zeros(6)
            twist[k] = sign * step
            D = pin.exp6(pin.Motion(twist[:3], twist[3:])).homogeneous
            T_frame_base, T_tip_target = setup.T_frame_base[0], setup.T_tip_target[0]
            if what == "base":
                T_frame_base = T_frame_base @ D
            else:
                T_tip_target = T_tip_target @ D
            places.append((T_frame_base @ tips @ T_tip_target)[:, :3, 3])
        columns.append((places[0] - places[1]) / (2.0 * step * LENGTH))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize("what", ["target", "base"])
@pytest.mark.parametrize("code", [TARGET_MOVED, ""])
def test_the_squares_explained_are_those_of_a_refit_with_the_displacement(given, what, code):
    tables = knocked(given, code, 18, 26) if code else good_readings(given, 26)
    fit = fit_of(given, tables)
    estimate = fit.fitted.estimate
    linear = estimate.problem.linear(estimate.x)
    A = linear.A.reshape(-1, len(estimate.x))
    r = linear.residual(estimate.x).reshape(-1)
    # Least squares with the priors as further rows; without and with the displacement from a stop on.
    root = np.sqrt(estimate.problem.prior_precision)
    pulled = root * (estimate.problem.prior_mean - estimate.x)
    E = slopes_of(fit, what)
    scan = next(scan for kind, name, scan in _scans(fit) if kind == what)

    def square(columns: np.ndarray) -> float:
        above = np.hstack([A, columns])
        below = np.hstack([np.diag(root), np.zeros((len(root), columns.shape[1]))])
        whole, right = np.vstack([above, below]), np.concatenate([r, pulled])
        size = np.linalg.norm(whole, axis=0)
        size[size == 0.0] = 1.0
        x, *_ = np.linalg.lstsq(whole / size, right, rcond=1e-13)
        return float(np.sum((right - whole / size @ x) ** 2))

    without = square(np.zeros((len(A), 0)))
    for k in (10, 17, 20):
        gain, numbers, total, _ = scan[k]
        columns = np.where((fit.stops >= k)[:, None, None], E, 0.0).reshape(len(A), -1)
        assert total == pytest.approx(without, rel=1e-6)
        assert numbers == columns.shape[1]
        assert gain == pytest.approx(without - square(columns), rel=0.03, abs=2e-3 * without)


def test_the_freedom_is_that_of_numbers_less_parameters(virtual):
    fit = fit_of(virtual, good_readings(virtual, 20))
    _, _, scan = next(_scans(fit))
    # Six zeros, of which the first and last are alike a turn of frame and target, that is 13 of 60 numbers.
    assert scan[0][3] == pytest.approx(60.0 - 13.0, abs=0.1)


@pytest.mark.parametrize("what", ["target", "base"])
@pytest.mark.parametrize("seed", range(3))
def test_what_is_knocked_is_found_at_its_stop_and_named_soon(ur3, what, seed):
    virtual = virtual_cell(ur3, points_cell(), seed)
    code = TARGET_MOVED if what == "target" else BASE_MOVED
    tables = knocked(virtual, code, 16, 20, seed)
    assert find_moved(fit_of(virtual, tables[:15]), 1.0, FIRST) == ()
    found = {
        count: find_moved(fit_of(virtual, tables[:count]), 1.0, FIRST) for count in (16, 17, 20)
    }
    # By a single stop target and base are the same, and so is a reading that is far off.
    assert {moved.what for moved in found[16]} == {"target", "base", "stop"}
    for count in (16, 17, 20):
        assert {moved.first for moved in found[count]} == {15}
    for count in (17, 20):
        (moved,) = found[count]
        assert moved.what == what
        assert moved.name == ("target" if what == "target" else "")
    assert found[20][0].gain > found[17][0].gain > 50.0


def test_of_two_targets_the_one_that_is_knocked_is_named(ur3):
    places = {"a": [0.0, 0.0, 0.1], "b": [0.05, 0.0, 0.08]}
    virtual = virtual_cell(ur3, points_cell(targets=places, estimate_target=True))
    tables = good_readings(virtual, 20)
    for name in ("a", "b"):
        T = virtual.truth.T_tip_target.copy()
        T[virtual.truth.targets.index(name), :3, 3] += [8e-4, 0.0, 6e-4]
        elsewhere = replace(virtual, truth=replace(virtual.truth, T_tip_target=T))
        after = good_readings(elsewhere, 20)
        found = find_moved(fit_of(virtual, [*tables[:14], *after[14:]]), 1.0, FIRST)
        assert [(moved.what, moved.name, moved.first) for moved in found] == [("target", name, 14)]


def test_a_displaced_pose_is_found_by_its_orientation_alone(ur3):
    cell = replace(points_cell(kind="pose"), sigma={"m": LENGTH, "rad": ANGLE})
    virtual = virtual_cell(ur3, cell)
    T = virtual.truth.T_tip_target.copy()
    T[0, :3, :3] = T[0, :3, :3] @ pin.exp3(np.array([0.0, 2e-3, 0.0]))
    turned = replace(virtual, truth=replace(virtual.truth, T_tip_target=T))
    tables = [*good_readings(virtual, 14)[:12], *good_readings(turned, 18)[12:]]
    found = find_moved(fit_of(virtual, tables), 1.0, 3)
    assert [(moved.what, moved.first) for moved in found] == [("target", 12)]


def test_a_displacement_that_the_fit_took_for_noise_counts(virtual):
    tables = knocked(virtual, TARGET_MOVED, 11, 20, size=0.8e-3)
    fit = fit_of(virtual, tables)
    # The fit knows nothing of it: its noise is several times that of the instrument.
    assert fit.fitted.estimate.sigma["m"] > 2.0 * LENGTH
    (moved,) = find_moved(fit, 1.0, FIRST)
    assert (moved.what, moved.first) == ("target", 10)


def test_nothing_is_found_before_the_first_stop_that_is_asked_for(virtual):
    fit = fit_of(virtual, knocked(virtual, TARGET_MOVED, 11, 20))
    (moved,) = find_moved(fit, 1.0, 10)
    assert moved.first == 10
    assert all(moved.first >= 13 for moved in find_moved(fit, 1.0, 13))


def test_a_session_whose_stops_are_noisier_needs_a_larger_displacement(virtual):
    fit = fit_of(virtual, knocked(virtual, TARGET_MOVED, 14, 20))
    found = find_moved(fit, 1.0, FIRST)
    assert found
    noisier = find_moved(fit, 4.0, FIRST)
    assert [moved.gain for moved in noisier] == pytest.approx([m.gain / 4.0 for m in found[:1]])
    assert find_moved(fit, 400.0, FIRST) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("model", "first"), [("zeros", FIRST), ("placement", 15)])
def test_nothing_has_moved_in_cells_where_nothing_was_knocked(ur3, model, first):
    found: list[tuple[Moved, ...]] = []
    for seed in range(25):
        virtual = virtual_cell(ur3, points_cell(model), seed)
        tables = good_readings(virtual, first + 25, seed)
        fits = [fit_of(virtual, tables[:count]) for count in range(first + 1, first + 26)]
        found += [find_moved(fit, 1.0, first) for fit in fits]
    assert len(found) == 625
    assert sum(map(bool, found)) <= 2
