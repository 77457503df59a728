"""Parts of residuals along joints' motions: an error of a joint is in its panel in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.show.plotting import styled
from calib.verbs.calibrate.figure_joints import along_joints, residuals_by_joint
from tests.parts import with_part


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def with_residual(c, residual):
    return with_part(c, "rows", residual_calibrated=residual)


@pytest.mark.parametrize("j", [0, 2, 5])
def test_an_error_of_a_joint_stands_in_its_panel_in_full(calibrations, j):
    """If a joint turned 0.1 mrad too far, the residual is all along its motion."""
    c = calibrations.made("paper")
    q = c.fit.measurements.joints_for(c.nominal.joint_names)
    residual = c.predict(q + 1e-4 * np.eye(6)[j]) - c.predict(q)
    parts = along_joints(with_residual(c, residual))
    norms = np.linalg.norm(residual, axis=1)
    np.testing.assert_allclose(parts[:, j], norms, rtol=1e-3)
    assert np.all(np.abs(parts) <= norms[:, None] * (1 + 1e-6))


def test_of_a_distance_all_is_along_the_beam(calibrations):
    c = calibrations.made("distances")
    parts = along_joints(c)
    residual = np.abs(c.rows.residual_calibrated[:, 0])
    has_part = np.isfinite(parts[:, 1])
    np.testing.assert_allclose(np.abs(parts[has_part, 1]), residual[has_part])


def test_a_joint_that_does_not_move_the_target_has_no_part(calibrations):
    """The target on the last axis."""
    c = calibrations.made("paper")
    on_axis = np.array(c.setup.T_tip_target)
    on_axis[:, :2, 3] = 0.0
    moved = with_part(
        replace(c, robot=c.nominal), "geometry", setup=replace(c.setup, T_tip_target=on_axis)
    )
    parts = along_joints(moved)
    assert np.all(np.isnan(parts[:, 5]))
    assert np.all(np.isfinite(parts[:, 0]))


def test_the_mean_is_that_of_the_estimation_rows_without_outliers(calibrations):
    c = calibrations.made("paper")
    # Wherever a row for validation or an outlier lies, the band is the same.
    moved = c.rows.residual_calibrated.copy()
    moved[[10, 13, *range(30, 35)]] += 0.1
    bands = []
    for calibration in (c, with_residual(c, moved)):
        panel = residuals_by_joint(calibration).axes[0]
        bands.append(panel.collections[-1].get_paths()[0].vertices)
    np.testing.assert_array_equal(*bands)
