"""What is left over along each joint's motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.report.figure_base import styled
from calib.report.figure_joints import along_joints, joints


@pytest.fixture(autouse=True)
def _look():
    with styled():
        yield


def with_residual(c, residual):
    return replace(c, residual_calibrated=residual)


@pytest.mark.parametrize("j", [0, 2, 5])
def test_an_error_of_a_joint_stands_in_its_own_panel_in_full(calibrations, j):
    """If a joint turned 0.1 mrad too far, what is left over is all along its motion."""
    c = calibrations.made("paper")
    q = c.measurements.joints_for(c.nominal.joint_names)
    off = c.predict(q + 1e-4 * np.eye(6)[j]) - c.predict(q)
    parts = along_joints(with_residual(c, off))
    np.testing.assert_allclose(parts[:, j], np.linalg.norm(off, axis=1), rtol=1e-3)
    sizes = np.linalg.norm(off, axis=1)[:, None]
    assert np.all(np.abs(parts) <= sizes * (1 + 1e-6))


def test_of_a_distance_all_is_along_the_beam(calibrations):
    c = calibrations.made("distances")
    parts = along_joints(c)
    sizes = np.abs(c.residual_calibrated[:, 0])
    there = np.isfinite(parts[:, 1])
    np.testing.assert_allclose(np.abs(parts[there, 1]), sizes[there])


def test_a_joint_that_does_not_move_the_target_has_no_part(calibrations):
    """The target on the last axis."""
    c = calibrations.made("paper")
    on_axis = np.array(c.setup.T_tip_target)
    on_axis[:, :2, 3] = 0.0
    moved = replace(c, robot=c.nominal, setup=replace(c.setup, T_tip_target=on_axis))
    parts = along_joints(moved)
    assert np.all(np.isnan(parts[:, 5]))
    assert np.all(np.isfinite(parts[:, 0]))
    words = [text.get_text() for text in joints(moved).axes[5].texts]
    assert words == ["does not move the target"]


def test_the_mean_is_that_of_the_estimation_rows_without_outliers(calibrations):
    c = calibrations.made("paper")
    # Wherever a row for validation or an outlier lies, the band is the same.
    moved = c.residual_calibrated.copy()
    moved[[10, 13, *range(30, 35)]] += 0.1
    bands = [
        joints(one).axes[0].collections[-1].get_paths()[0].vertices
        for one in (c, with_residual(c, moved))
    ]
    np.testing.assert_array_equal(*bands)
