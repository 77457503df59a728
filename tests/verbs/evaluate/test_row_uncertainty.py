"""Uncertainty of the errors of rows: by kind, by unit, in which frame, and how often errors are within it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.channels import Channels
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.uncertainty.at_poses import uncertainty_at
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.evaluate.row_uncertainty import RowUncertainty, matching


@pytest.fixture(scope="module")
def paper(default_result):
    """The paper's calibration, and its five validation rows evaluated with it."""
    c = default_result
    rows = c.fit.measurements.select(c.fit.measurements.validation)
    return c, rows, evaluate(c.nominal, rows, c.fit.cell, calibration=c)


def test_without_noise_it_is_the_uncertainty_of_the_prediction(paper):
    c, rows, found = paper
    U = c.uncertainty(rows.joints, non_geometric=False)
    np.testing.assert_allclose(found.uncertainty.of_predictions("m"), U.position, rtol=1e-9)
    np.testing.assert_allclose(found.expanded("m"), U.position, rtol=1e-9)
    assert np.isnan(found.expanded("rad")).all()


def test_stated_noise_of_the_rows_adds_to_it(paper):
    c, rows, _ = paper
    noise = 5e-4
    noisy = evaluate(c.nominal, rows, replace(c.fit.cell, sigma={"m": noise}), calibration=c)
    known = replace(noisy.uncertainty, freedom={"m": np.full(5, np.inf)}).of_errors("m")
    V = c.uncertainty(rows.joints, non_geometric=False).covariance[:, :3, :3]
    samples = np.random.default_rng(3).standard_normal((200_000, 3))
    for k in range(5):
        root = np.linalg.cholesky(V[k] + noise**2 * np.eye(3))
        share = np.mean(np.linalg.norm(samples @ root.T, axis=1) < known[k])
        assert share == pytest.approx(0.9545, abs=0.004)
    # Estimated with few degrees of freedom it is larger.
    assert (noisy.expanded("m") > known).all()


def test_the_mean_of_repeats_has_less_of_the_measurement_but_all_of_the_prediction():
    unknown = np.full(4, np.inf)
    found = RowUncertainty(
        np.repeat([1e-8 * np.eye(3)], 4, axis=0),
        np.full((4, 3), 2e-4),
        {"m": unknown},
        Channels.of_unit(np.ones((4, 3), dtype=bool)),
    )
    # Equal variances along three axes: 2.8332 standard deviations of one axis hold 95.45 % of the lengths.
    assert found.of_errors("m")[0] == pytest.approx(2.8332 * np.hypot(1e-4, 2e-4), rel=1e-3)
    mean = found.of_mean("m", np.arange(4))
    assert mean == pytest.approx(2.8332 * np.hypot(1e-4, 1e-4), rel=1e-3)


def test_a_target_that_is_not_the_results_has_none(paper):
    c, rows, _ = paper
    elsewhere = evaluate(
        c.nominal,
        replace(rows, targets=("other",) * 5),
        replace(c.fit.cell, targets={"other": np.array([0.0, 0.0, 0.1])}, target=None),
        calibration=c,
    )
    assert np.isnan(elsewhere.expanded("m")).all()
    assert not elsewhere.within("m").any()


def test_a_frame_that_was_registered_again_does_not_count(calibrations):
    """The robot's own errors in the base, turned into the frame that the rows are in."""
    c = calibrations.made("poses")
    m = c.fit.measurements
    open_cell = replace(c.fit.cell, estimate_frame=True)
    found = evaluate(c.nominal, m, open_cell, calibration=c, which=("target",))
    assert found.registered == ("frame",)
    samples = c.samples(
        m.joints_for(c.nominal.joint_names), moves=m.moves_for(c.nominal.joint_names)
    )
    in_base = uncertainty_at(c, samples, non_geometric=False, in_base=True)
    np.testing.assert_allclose(found.uncertainty.of_predictions("m"), in_base.position, rtol=1e-9)
    R = found.setup.T_frame_base[0, :3, :3]
    V = R @ in_base.covariance[0, :3, :3] @ R.T
    np.testing.assert_allclose(found.uncertainty.predicted[0, :3, :3], V, rtol=1e-6, atol=1e-18)


def test_a_distance_has_the_uncertainty_along_its_line(paper):
    """|p - a| of an anchor far away changes as the position along the line to it."""
    c, rows, _ = paper
    anchor = np.array([3.0, -2.0, 1.0])
    distances = np.linalg.norm(rows.points - anchor, axis=1)
    table = Measurements(
        rows.joint_names,
        rows.joints,
        np.full((5, 3), np.nan),
        distances=distances,
        kinds=("distance",) * 5,
        groups=("anchor",) * 5,
    )
    T_anchor_base = np.eye(4)
    T_anchor_base[:3, 3] = -anchor
    cell = Cell(frames={"anchor": T_anchor_base}, target=c.target, estimate_target=False)
    found = evaluate(c.nominal, table, cell, calibration=c, which=("target",))
    U = c.uncertainty(rows.joints, non_geometric=False)
    line = U.poses[:, :3, 3] - anchor
    line /= np.linalg.norm(line, axis=1)[:, None]
    along = np.einsum("ni,nij,nj->n", line, U.covariance[:, :3, :3], line)
    np.testing.assert_allclose(found.uncertainty.predicted[:, 0, 0], along, rtol=1e-6)


def test_names_are_matched_and_single_ones_whatever_they_are_called():
    assert matching(("a", "b", "c"), ("b", "c")) == {1: 0, 2: 1}
    assert matching(("a",), ("b",)) == {0: 0}
    assert matching(("a",), ("b",), by_name=True) == {}
