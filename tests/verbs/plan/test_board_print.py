"""The print of a calibrated board: corners by scale and sag, against the prediction of images."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calib.boards.board import Board
from calib.camera import optics
from calib.verbs.plan.board_print import printed_corners

BOARD = Board(pattern="chessboard", columns=8, rows=6, square=0.025)
PRINT = {"board_scale_x": 0.002, "board_sag_x": 8e-4, "board_scale_y": -0.001, "board_sag_y": -3e-4}


def part(suffix: str = "") -> SimpleNamespace:
    """A fit with a parameter of the robot before those of the print."""
    values = {"joint.z": 0.1} | {f"{name}{suffix}": value for name, value in PRINT.items()}
    root = np.random.default_rng(1).normal(size=(5, 5)) * [1e-3, 1e-3, 2e-4, 1e-3, 2e-4]
    parameters = [SimpleNamespace(name=name) for name in values]
    x = np.array(list(values.values()))
    return SimpleNamespace(parameters=parameters, x=x, covariance=root @ root.T)


def as_in_images(values: list[float]) -> np.ndarray:
    """Where the prediction of images has the corners."""
    rows = np.zeros((len(BOARD.corners), optics.COUNT))
    rows[:, optics.POINT] = BOARD.corners
    rows[:, optics.ACROSS] = optics.across(BOARD.corners, BOARD.centre, BOARD.size)
    rows[:, optics.SCALE] = values[0], values[2]
    rows[:, optics.WARP] = values[1], values[3]
    return optics.board_points(rows)


@pytest.mark.parametrize("suffix", ["", "[table]"])
def test_corners_are_where_images_are_predicted_from(suffix):
    corners = printed_corners(part(suffix), BOARD, "table", BOARD.corners)
    np.testing.assert_allclose(corners.points, as_in_images([*PRINT.values()]), atol=1e-15)


def test_their_covariance_is_that_of_draws():
    fit = part()
    corners = printed_corners(fit, BOARD, "table", BOARD.corners)
    root = np.linalg.cholesky(fit.covariance + 1e-20 * np.eye(5))[1:]
    draws = np.random.default_rng(2).normal(size=(20_000, 5)) @ root.T
    values = np.array([*PRINT.values()])
    # The corners are linear in these: the spread of a few draws tells the map of all.
    moved = np.array([as_in_images(values + draw) for draw in draws[:4000]])
    for k in (0, 17, 34):
        expected = np.cov(moved[:, k].T)
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-18
        np.testing.assert_allclose(corners.covariance[k] / scale, expected / scale, atol=0.08)


def test_without_an_estimate_they_are_as_designed():
    nothing = SimpleNamespace(parameters=[], covariance=np.zeros((0, 0)))
    corners = printed_corners(nothing, BOARD, "table", BOARD.corners[:3])
    np.testing.assert_array_equal(corners.points, BOARD.corners[:3])
    assert not corners.covariance.any()
    other = printed_corners(part("[shelf]"), BOARD, "table", BOARD.corners[:3])
    np.testing.assert_array_equal(other.points, BOARD.corners[:3])
