"""Errors of boards in three dimensions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.camera.board_pose import board_pose
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.fit.registration.rows import Rows
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Sightings
from calib.result.board_errors import BoardErrors, board_errors, board_table
from calib.result.calibrate import calibrate
from tests import images
from tests.pictures import BOARD, STATED, joined, pictures_of

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


def apparent_shifts(
    T_camera_board: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far boards seem to be off through another lens: in the camera, (n, 3) [m], and along sight, (n,)."""
    lens, middle = LENSES["pinhole"], images.BOARD.centre
    shifts, along = [], []
    for T in T_camera_board:
        pixels = lens.project(images.BOARD.corners @ T[:3, :3].T + T[:3, 3], values)
        seen = board_pose(images.BOARD.corners, pixels, lens, images.VALUES["pinhole"])
        assert seen is not None
        where = T[:3, :3] @ middle + T[:3, 3]
        found = seen.T_camera_board
        shifts.append(found[:3, :3] @ middle + found[:3, 3] - where)
        along.append(shifts[-1] @ where / np.linalg.norm(where))
    return np.array(shifts), np.array(along)


@pytest.mark.slow
def test_validation_images_of_another_day_count_for_the_expected_error() -> None:
    """The lens is 0.2 % longer then, and boards seem to be nearer; residuals in pixels hardly show it."""
    known = images.camera(sigma=np.zeros(9))
    exact = replace(images.BOARD, sigma_scale=0.0, sigma_warp=0.0, sigma_corner=0.0)
    cell = images.cell(cameras={"": known}, boards={"": exact}, model="frames")
    longer = images.VALUES["pinhole"] * np.array([1.002, 1.002, *[1.0] * 7])
    q = images.poses(22)
    first = images.table(q[:12], noise=0.1)
    later = images.table(q[12:], values=longer, noise=0.1, seed=4)
    sets = ("estimate",) * len(first) + ("validate",) * len(later)
    table = replace(joined(first, later), sets=sets)
    result = calibrate(images.arm(), table, cell=cell)
    of_later = result.geometry.validation_board
    assert of_later is not None
    assert of_later.views == 10
    T_camera_base, T_tip_board = images.mounts()
    T = T_camera_base @ images.arm().poses(q[12:]) @ T_tip_board
    shifts, along = apparent_shifts(T, longer)
    in_space = np.sqrt(np.mean(np.sum(shifts**2, axis=1)))
    assert np.hypot(of_later.across, of_later.depth) == pytest.approx(in_space, rel=0.05)
    assert of_later.depth == pytest.approx(np.sqrt(np.mean(along**2)), rel=0.05)
    assert of_later.predicted == pytest.approx(in_space, rel=0.2)
    assert of_later.depth_bias < -5.0 * of_later.depth_bias_std
    assert result.new_point[0] == pytest.approx(of_later.predicted, rel=1e-6)
    alone = replace(result.geometry, validation_board=None).new_point
    assert alone[0] < 0.3 * result.new_point[0]
    assert result.new_point[1] > alone[1]
    nothing = calibrate(images.arm(), first, cell=cell, validate=False)
    assert nothing.geometry.validation_board is None
