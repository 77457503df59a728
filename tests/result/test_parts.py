"""The rows of a result: their images, flags, and errors at the board."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.channels import Channels
from calib.result.calibrate import calibrate
from calib.result.parts import errors_at_board
from tests.images import BOARD, arm, cell, poses, table


def test_images_are_counted_where_all_rows_are_corners(default_result):
    sets = ("estimate", "estimate", "estimate", "validate")
    images = ("a.png", "b.png", "a.png", "")
    rows = replace(default_result.rows, numbers=(1, 2, 3, 4), sets=sets, images=images)
    assert rows.count_images(rows.estimation) == 2
    assert rows.count_images(np.ones(4, dtype=bool)) == 0  # one is not a corner
    assert replace(rows, images=()).count_images(rows.estimation) == 0


def test_lengths_are_pixels_times_their_length():
    measured = np.array([[True, True], [True, True], [False, False]])
    residual = np.array([[3.0, 4.0], [0.0, 1.0], [9.0, 9.0]])
    scale = np.array([1e-3, 2e-3, np.nan])
    errors = errors_at_board(residual, Channels.of_unit(measured, "px"), scale)["m"]
    assert errors.n == 2
    assert errors.max == pytest.approx(5e-3)
    assert errors.mean == pytest.approx(3.5e-3)


def test_errors_of_images_are_lengths_at_the_board():
    """Of each robot and set, and of held-out rows: pixels times the length of a pixel."""
    count = len(BOARD.corners)
    sets = ("estimate",) * 12 * count + ("validate",) * 3 * count
    m = table(poses(15), noise=0.1, seed=1, sets=sets)
    c = calibrate(arm(), m, cell=replace(cell(), model="frames"))
    rows = c.rows
    scale = rows.metres_per_pixel

    def rms(residual, chosen):
        return np.sqrt(np.mean((np.linalg.norm(residual, axis=1) * scale[chosen]) ** 2))

    for who, residual in (
        ("nominal", rows.residual_nominal),
        ("calibrated", rows.residual_calibrated),
    ):
        for name, chosen in (("estimation", rows.estimation), ("validation", rows.validation)):
            found = rows.errors_at_board[who][name]["m"].rms
            assert found == pytest.approx(rms(residual[chosen], chosen), rel=1e-12)
    held_out = rows.held_out_errors_at_board(c.cross_validation)
    expected = rms(c.cross_validation.residual, rows.estimation)
    assert held_out["m"].rms == pytest.approx(expected, rel=1e-12)


def test_without_images_there_are_no_errors_at_the_board(default_result):
    c = default_result
    assert c.rows.errors_at_board == {}
    assert c.rows.held_out_errors_at_board(c.cross_validation) is None


def test_flagged_are_outliers_and_suspects(calibrations):
    c = calibrations.made("with_outliers")
    flagged = {outlier.row for outlier in (*c.rows.outliers, *c.rows.suspects)}
    assert flagged
    assert {c.fit.measurements.rows[k] for k in np.flatnonzero(c.rows.flagged)} == flagged
