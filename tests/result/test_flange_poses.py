"""Mount, board and camera from poses of the flange, without a robot; the truth is NumPy's alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.data.forms.flange_poses import flange_joints
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.errors import ModelError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.flange import FLANGE, JOINTS, NAME
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

FOCAL, CENTRE = 900.0, np.array([640.0, 360.0])
CORNERS = np.array([[0.03 * i, 0.03 * j, 0.0] for j in range(5) for i in range(7)])


def pose(rotation_vector, position) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    T[:3, 3] = position
    return T


T_FLANGE_CAMERA = pose([0.05, -0.1, 0.8], [0.04, -0.06, 0.09])
T_BASE_BOARD = pose([0.02, 0.04, 0.7], [0.55, -0.1, 0.05])


def views(count: int, seed: int = 0, tilt: float = 0.5) -> np.ndarray:
    """T_base_flange of a camera on the hand that looks at the board, tilted about two axes by up to so much."""
    rng = np.random.default_rng(seed)
    result = []
    for _ in range(count):
        turned = np.append(rng.uniform(-tilt, tilt, 2), rng.uniform(-1.5, 1.5))
        looks_at = pose([np.pi, 0.0, 0.0], [0.09, 0.06, 0.0]) @ pose(turned, [0.0, 0.0, 0.0])
        T_board_camera = looks_at @ pose(
            [0, 0, 0], [*rng.uniform(-0.03, 0.03, 2), -rng.uniform(0.45, 0.6)]
        )
        result.append(T_BASE_BOARD @ T_board_camera @ np.linalg.inv(T_FLANGE_CAMERA))
    return np.array(result)


def table(T_base_flange: np.ndarray, noise: float = 0.0) -> Measurements:
    """Corners as the camera sees them."""
    rng = np.random.default_rng(1)
    n, k = len(T_base_flange), len(CORNERS)
    T_camera_board = np.linalg.inv(T_base_flange @ T_FLANGE_CAMERA) @ T_BASE_BOARD
    points = (
        np.einsum("nij,kj->nki", T_camera_board[:, :3, :3], CORNERS)
        + T_camera_board[:, None, :3, 3]
    )
    pixels = FOCAL * points[..., :2] / points[..., 2:] + CENTRE
    pixels = (pixels + rng.normal(0.0, noise, pixels.shape)).reshape(-1, 2)
    q = flange_joints(T_base_flange[:, :3, 3], T_base_flange[:, :3, :3])
    return Measurements(
        joint_names=JOINTS,
        joints=np.repeat(q, k, axis=0),
        prismatic=JOINTS[:3],
        points=np.full((n * k, 3), np.nan),
        kinds=("pixel",) * (n * k),
        readings={"u": pixels[:, 0], "v": pixels[:, 1]},
        board_points=np.tile(CORNERS, (n, 1)),
        images=tuple(f"{i:02}.png" for i in range(n) for _ in range(k)),
        corners=tuple(str(c) for _ in range(n) for c in range(k)),
    )


CELL = Cell(
    base=FLANGE,
    tip="base",
    sigma={"px": 0.1},
    cameras={"": Camera(width=1280, height=720)},
    boards={"": Board(pattern="chessboard", columns=8, rows=6, square=0.03)},
)


def calibrated(measured: Measurements, **options) -> Calibration:
    return calibrate(Robot.load(NAME, base=FLANGE, tip="base"), measured, cell=CELL, **options)


@pytest.mark.slow
def test_mount_board_and_lens_are_those_of_the_truth():
    exact = calibrated(table(views(20)), validate=False)
    np.testing.assert_allclose(
        np.linalg.inv(exact.setup.T_frame_base[0]), T_FLANGE_CAMERA, atol=1e-7
    )
    np.testing.assert_allclose(exact.setup.T_tip_target[0], T_BASE_BOARD, atol=1e-7)
    assert exact.model.name == "frames"
    assert exact.parameter("fx").value == pytest.approx(FOCAL, abs=1e-3)

    noisy = calibrated(table(views(20), noise=0.2))
    assert noisy.verdict.use == "use"
    assert noisy.verdict.reasons[0].why is Why.SETUP_LOCATED
    assert noisy.noise.sigma["px"] == pytest.approx(0.2, rel=0.1)
    miss = np.linalg.inv(noisy.setup.T_frame_base[0])[:3, 3] - T_FLANGE_CAMERA[:3, 3]
    assert np.abs(miss).max() < noisy.verdict.reasons[0].values["located_m"]


@pytest.mark.slow
def test_the_urdf_has_camera_and_board_as_links(tmp_path):
    result = calibrated(table(views(12)))
    urdf = Urdf.read(result.write_urdf(tmp_path / "with_camera.urdf"))
    camera, board = urdf.joint("calib_frame_joint"), urdf.joint("calib_target_joint")
    assert (camera.parent, board.parent) == ("flange", "base")
    np.testing.assert_allclose(camera.T_parent_joint, T_FLANGE_CAMERA, atol=1e-6)
    np.testing.assert_allclose(board.T_parent_joint, T_BASE_BOARD, atol=1e-6)
    # Another run moves the links that the first one added.
    again = replace(result, robot=replace(result.robot, urdf=urdf))
    assert again.checked_urdf().joint("calib_frame_joint").parent == "flange"


@pytest.mark.slow
def test_a_hand_that_turns_about_one_axis_does_not_locate_the_mount():
    T = views(15, tilt=0.0)
    result = calibrated(table(T, noise=0.2))
    assert result.verdict.use != "use"


def test_such_poses_have_no_errors_of_joints():
    with pytest.raises(ModelError, match="'frames'"):
        calibrated(table(views(4)), model="zeros")
