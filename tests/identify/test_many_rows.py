"""A table of many rows goes another way through the program; what comes out must be the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identify import nominal, problem, thinning
from calib.identify.calibration import calibrate
from calib.identify.nominal import residual_of
from calib.identify.rows import NONE, Rows, evenly, thinned, whole_blocks
from calib.identify.table_rows import rows_of
from calib.identify.thinning import thin
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model import batch
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from tests.identify.test_passes import KINDS, rows_of_kinds

#: Numbers of kinds in the registry.
PLANE = 5

COUNT = 1700


@pytest.fixture(scope="module")
def table(ur3) -> Measurements:
    """Points with outliers, repeats, validation rows, and a few rows seen from a second set-up."""
    rng = np.random.default_rng(7)
    model = error_model(ur3, "dh", target=True)
    T = np.eye(4)
    T[:3, 3] = (0.05, 0.02, 0.03)
    x = rng.normal(size=len(model)) * np.where(np.array(model.units) == "m", 3e-4, 3e-3)
    q = rng.uniform(-2.8, 2.8, (COUNT, 6))
    q[100:200] = q[:100]
    points = Kinematics(ur3, model, np.eye(4), T).points(x, q) + rng.normal(0.0, 5e-5, (COUNT, 3))
    points[::90] += rng.normal(0.0, 5e-3, points[::90].shape)
    sets = ["validate" if i % 50 == 7 else "estimate" for i in range(COUNT)]
    return Measurements(joint_names=ur3.joint_names, joints=q, points=points, sets=tuple(sets))


@pytest.fixture(scope="module")
def both(ur3, table):
    """The result of many rows, and that of the same rows with every derivative at hand."""
    many = calibrate(ur3, table, model="dh")
    with pytest.MonkeyPatch.context() as patch:
        for module in (batch, problem, nominal):
            patch.setattr(module, "MANY", 10 * COUNT)
        patch.setattr("calib.model.kinematics.MANY", 10 * COUNT)
        patch.setattr("calib.identify.crossvalidation.MANY", 10 * COUNT)
        few = calibrate(ur3, table, model="dh")
    assert many.fitted.estimate.problem.passes is not None
    assert few.fitted.estimate.problem.passes is None
    return many, few


def test_parameters_and_their_uncertainty(both):
    many, few = both
    std = np.sqrt(np.diag(few.covariance))
    np.testing.assert_allclose(many.x, few.x, atol=1e-4 * std.min())
    np.testing.assert_allclose(many.covariance, few.covariance, atol=1e-6 * std.max() ** 2)
    assert many.freedom == pytest.approx(few.freedom, rel=1e-6)
    assert many.sigma == pytest.approx(few.sigma, rel=1e-6)
    assert many.observability.rank == few.observability.rank
    assert many.observability.condition == pytest.approx(few.observability.condition, rel=1e-6)
    assert many.observability.indices == pytest.approx(few.observability.indices, rel=1e-6)


def test_rows_and_their_scores(both):
    many, few = both
    np.testing.assert_allclose(many.residual_calibrated, few.residual_calibrated, atol=1e-9)
    np.testing.assert_allclose(many.residual_nominal, few.residual_nominal, atol=1e-12)
    np.testing.assert_allclose(many.scores, few.scores, rtol=1e-3, atol=1e-3)
    assert [o.row for o in many.outliers] == [o.row for o in few.outliers]
    assert len(many.outliers) >= COUNT // 100
    assert [o.row for o in many.suspects] == [o.row for o in few.suspects]


def test_errors_of_left_out_rows_and_the_verdict(both):
    many, few = both
    ours, theirs = many.cross_validation, few.cross_validation
    assert ours.errors_without_outliers.rms == pytest.approx(
        theirs.errors_without_outliers.rms, rel=1e-3
    )
    assert many.nominal_cross_validation.errors.rms == pytest.approx(
        few.nominal_cross_validation.errors.rms, rel=1e-9
    )
    assert many.robustness.moved_rms == pytest.approx(few.robustness.moved_rms, rel=1e-3)
    assert many.verdict == few.verdict
    assert many.repeats.freedom == pytest.approx(few.repeats.freedom, rel=1e-6)


@pytest.mark.parametrize("kind", ["point", "all"])
def test_rows_are_thinned_evenly_and_whole(ur3, kind):
    _, rows = rows_of_kinds(ur3, KINDS[kind], count=2000)
    mask = evenly(rows, 500)
    assert 490 <= np.sum(mask) <= 900
    chosen = np.flatnonzero(mask)
    for view in {(f, t) for f, t in zip(rows.samples.frame, rows.samples.target, strict=True)}:
        own = (rows.samples.frame[chosen] == view[0]) & (rows.samples.target[chosen] == view[1])
        assert np.sum(own) >= 100
    partners = rows.partner[chosen]
    assert set(partners[partners >= 0]) <= set(chosen)
    assert not np.any((rows.kinds[chosen] == NONE) & ~np.isin(chosen, rows.partner[chosen]))
    assert thinned(rows, 2000) is rows
    assert len(thinned(rows, 500)) == len(chosen)


def test_parts_hold_whole_blocks(ur3):
    _, rows = rows_of_kinds(ur3, KINDS["all"], count=400)
    parts = list(whole_blocks(rows, 50))
    assert len(parts) > 5
    np.testing.assert_array_equal(np.sum(parts, axis=0), 1)
    for mask in parts:
        assert not np.isin(rows.blocks[mask], rows.blocks[~mask]).any()


def test_a_thin_fit_is_the_fit_on_some_of_its_rows(both):
    fitted = both[0].fitted
    few = thin(fitted, 600)
    rows = few.estimate.problem.rows
    assert 500 <= len(rows) <= 700
    assert few.estimate.problem.passes is None
    np.testing.assert_array_equal(few.estimate.x, fitted.estimate.x)
    own = np.isin(fitted.estimate.problem.rows.samples.q[:, 0], rows.samples.q[:, 0])
    own &= np.isin(fitted.estimate.problem.rows.points[:, 0], rows.points[:, 0])
    np.testing.assert_array_equal(fitted.estimate.scores[own], few.estimate.scores)
    np.testing.assert_array_equal(fitted.estimate.problem.scales[own], few.estimate.problem.scales)
    assert thin(fitted) is fitted
    assert thinning.MOST > COUNT


@pytest.mark.parametrize("kind", KINDS)
def test_the_nominal_robot_in_passes(ur3, kind, monkeypatch):
    _, rows = rows_of_kinds(ur3, KINDS[kind], count=60)
    _, setup = rows_of(ur3, _points_of(ur3, rows), Cell())
    expected = residual_of(ur3, setup, _in_one_frame(rows))
    monkeypatch.setattr(nominal, "MANY", 1)
    np.testing.assert_allclose(residual_of(ur3, setup, _in_one_frame(rows)), expected, atol=1e-12)


def _points_of(robot, rows) -> Measurements:
    return Measurements(
        joint_names=robot.joint_names, joints=rows.joints, points=np.zeros((len(rows), 3))
    )


def _in_one_frame(rows: Rows) -> Rows:
    nothing = np.zeros(len(rows), dtype=int)
    return replace(rows, samples=replace(rows.samples, frame=nothing, target=nothing))


def test_thin_rows_have_every_kind_and_no_cycle(ur3):
    _, rows = rows_of_kinds(ur3, KINDS["point"], count=4000)
    kinds = rows.kinds.copy()
    kinds[1234] = PLANE
    some = np.flatnonzero(evenly(replace(rows, kinds=kinds), 400))
    assert 1234 in some
    for cycle in (2, 3, 10):
        shares = np.bincount(some % cycle) / len(some)
        assert np.all(np.abs(shares * cycle - 1.0) < 0.5)
    np.testing.assert_array_equal(evenly(rows, 400), evenly(rows, 400))
