"""Images of a board by a camera on the hand of an arm, made by hand for tests: exact, or with noise."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.boards.bodies import tag_at
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.robot import Robot

BOARD = Board(
    name="sheet",
    pattern="charuco",
    columns=6,
    rows=5,
    square=0.03,
    marker=0.022,
    dictionary="DICT_5X5_100",
)

#: Tags on the faces of a blunt pyramid, all of which a camera in front of it sees; corners in the box of `BOARD`.
BODY = Board(
    name="pyramid",
    pattern="body",
    dictionary="DICT_APRILTAG_36h11",
    sigma_corner=5e-4,
    tags=(
        tag_at(0, np.array([0.09, 0.075, -0.02]), np.zeros(3), 0.03),
        tag_at(1, np.array([0.13, 0.075, 0.0]), np.array([0.0, -0.8, 0.0]), 0.03),
        tag_at(2, np.array([0.05, 0.075, 0.0]), np.array([0.0, 0.8, 0.0]), 0.03),
        tag_at(3, np.array([0.09, 0.115, 0.0]), np.array([0.8, 0.0, 0.0]), 0.03),
        tag_at(4, np.array([0.09, 0.035, 0.0]), np.array([-0.8, 0.0, 0.0]), 0.03),
    ),
)
VALUES = {
    "pinhole": np.array([700.0, 705.0, 1200.0, 995.0, -0.1, 0.05, 1e-3, -5e-4, 0.0]),
    "rational": np.array([700.0, 705.0, 1200.0, 995.0, 0.2, 0.05, 1e-3, -5e-4, 0.0, 0.3, 0.1, 0.0]),
    "tilted": np.array(
        [
            *(700.0, 705.0, 1200.0, 995.0, 0.2, 0.05, 1e-3, -5e-4, 0.0, 0.3, 0.1, 0.0),
            *(1e-3, 0.0, -1e-3, 0.0, 0.01, -0.02),
        ]
    ),
    "fisheye": np.array([420.0, 418.0, 1201.0, 998.0, -0.02, 0.01, -4e-3, 6e-4]),
}

HOME = np.array([0.0, -0.3, 0.0, -2.3, 0.0, 2.0, 0.8])


def arm():
    """The Panda from its hand, which carries the camera, down to its base, where the board lies."""
    return Robot.load("panda", base="panda_link8", tip="panda_link0")


def camera(lens="pinhole", **changes):
    return Camera(
        **({"width": 2400, "height": 2000, "lens": lens, "values": VALUES[lens]} | changes)
    )


def mounts():
    """T_camera_base and T_tip_board: the camera beside the hand, the board 0.4 m in front of it at home."""
    T_camera_base = np.eye(4)
    T_camera_base[:3, :3] = Rotation.from_euler("xyz", [4, -3, 47], degrees=True).as_matrix()
    T_camera_base[:3, 3] = [0.01, 0.06, 0.02]
    T_camera_board = np.eye(4)  # at the home pose
    T_camera_board[:3, :3] = Rotation.from_euler("xyz", [10, -15, 20], degrees=True).as_matrix()
    T_camera_board[:3, 3] = np.array([0.0, 0.0, 0.4]) - T_camera_board[:3, :3] @ BOARD.centre
    T_base_tip = arm().poses(HOME[None])[0]
    return T_camera_base, np.linalg.inv(T_camera_base @ T_base_tip) @ T_camera_board


def poses(count, seed=0):
    """Joint values about a pose from which the hand looks down at the board."""
    rng = np.random.default_rng(seed)
    return HOME + rng.uniform(-1, 1, (count, 7)) * [0.2, 0.15, 0.15, 0.15, 0.3, 0.3, 0.7]


def table(
    q,
    *,
    robot=None,
    lens="pinhole",
    values=None,
    board=BOARD,
    points=None,
    noise=0.0,
    seed=0,
    **words,
):
    """The images of all corners at joint values (n, 7), by plain arithmetic."""
    robot = robot or arm()
    rng = np.random.default_rng(seed)
    T_camera_base, T_tip_board = mounts()
    corners = board.corners if points is None else points
    T = T_camera_base @ robot.poses(q) @ T_tip_board
    in_camera = corners @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
    assert in_camera[..., 2].min() > 0.05
    flat = in_camera.reshape(-1, 3)
    pixels = LENSES[lens].project(flat, VALUES[lens] if values is None else values)
    pixels += noise * rng.standard_normal(pixels.shape)
    count = len(corners)
    return Measurements(
        joint_names=robot.joint_names,
        joints=np.repeat(q, count, axis=0),
        points=np.full((len(pixels), 3), np.nan),
        kinds=("pixel",) * len(pixels),
        images=tuple(f"{i}.png" for i in range(len(q)) for _ in range(count)),
        corners=tuple(str(k) for _ in range(len(q)) for k in range(count)),
        board_points=np.tile(board.corners, (len(q), 1)),
        readings={"u": pixels[:, 0], "v": pixels[:, 1]},
        **words,
    )


def cell(lens="pinhole", **changes):
    return Cell(**({"cameras": {"": camera(lens)}, "boards": {"": BOARD}} | changes))
