"""Errors of boards in three dimensions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Sightings
from calib.result.board_errors import BoardErrors, board_errors, board_table
from tests.pictures import BOARD, STATED, pictures_of

#: Standard deviation of an image coordinate [px].
NOISE = 0.1


def errors_of(displaced: np.ndarray, noise: float, turn: np.ndarray | None = None) -> BoardErrors:
    """Return the errors of predictions that lack a displacement [m] of boards, along the camera's axes, and a turn."""
    cell, table = pictures_of(BOARD, seed=5, count=15)
    rows, _ = rows_and_setup(
        cell.truth.nominal, table, Cell(cameras={"": STATED}, boards={"": BOARD})
    )
    true, predicted = poses(rows, cell.truth.T_frame_base[0], cell.truth.nominal, displaced, turn)
    measured = rows.as_measured_at(true)
    random = np.random.default_rng(0).standard_normal((len(rows), 2))
    residual = measured.residual(Sightings(predicted)) + noise * random
    found = board_errors(measured, Sightings(predicted), residual)
    assert found is not None
    return found


def poses(rows: Rows, T_frame_base, robot, displaced, turn) -> tuple[np.ndarray, np.ndarray]:
    """Return poses of the boards in the camera, and predictions that lack a motion about the boards' middles."""
    predicted = T_frame_base @ robot.poses(rows.joints)
    true = predicted.copy()
    middle = rows.points(predicted)
    for block in np.unique(rows.blocks):
        of_view = rows.blocks == block
        centre = middle[of_view].mean(axis=0)
        R = np.eye(3) if turn is None else Rotation.from_rotvec(turn).as_matrix()
        true[of_view, :3, :3] = R @ predicted[of_view, :3, :3]
        true[of_view, :3, 3] = (
            centre + (R @ (predicted[of_view, :3, 3] - centre)[:, :, None])[:, :, 0] + displaced
        )
    return true, predicted


def test_depth_and_turn_are_told_apart_without_noise() -> None:
    """A board 1 mm farther away, and turned by 1 mrad about its middle."""
    found = errors_of(np.array([0.0, 0.0, 1e-3]), 0.0, np.array([1e-3, 0.0, 0.0]))
    assert np.hypot(found.across, found.depth) == pytest.approx(1e-3, rel=0.02)
    assert found.depth_bias == pytest.approx(1e-3, rel=0.1)
    assert found.turn == pytest.approx(1e-3, rel=0.05)
    assert found.predicted == pytest.approx(1e-3, rel=0.05)


def test_noise_alone_is_no_error_of_the_prediction() -> None:
    """What a view alone does not show is its own uncertainty, far larger in depth."""
    found = errors_of(np.zeros(3), NOISE)
    assert found.depth == pytest.approx(found.depth_alone, rel=0.6)
    assert found.depth_alone > 3.0 * found.across_alone
    assert found.predicted_depth < 0.7 * found.depth_alone
    assert abs(found.depth_bias) < 3.0 * found.depth_bias_std


def test_keys_of_a_file_have_units() -> None:
    """Lengths end in m, angles in rad."""
    table = board_table(errors_of(np.zeros(3), NOISE))
    assert {"views", "depth_m", "turn_rad", "depth_bias_std_m"} <= set(table)
