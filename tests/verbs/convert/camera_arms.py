"""A UR3 with a camera on its flange, as a URDF: mount, body, optical frame, and a second camera's frame below them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

import calib.example
from calib.basics.arrays import rigid_inverse
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.convert.convert import FORMATS
from calib.verbs.convert.format import CameraOptions, Conversion, Options
from calib.verbs.convert.urdf_formats import result_source
from tests.kept import kept

#: The lines of a camera, as people write them: mixed quotes, a comment, an origin without xyz, one not at all.
CAMERA = """\
  <!-- the camera -->
  <link name="camera_mount"/>
  <link name='camera_body'/>
  <link name="color_optical"/>
  <link name="depth_optical"/>
  <joint name="camera_mount_joint" type="fixed">
    <parent link="tool0"/>
    <child link="camera_mount"/>
    <origin  rpy='0 -1.5707963 0' xyz='0.05 0 0.03' />
  </joint>
  <joint name="camera_body_joint" type="fixed">
    <origin xyz="0.034 0.001 -0.012" rpy="0 0.02 0"/>
    <parent link="camera_mount"/>
    <child link="camera_body"/>
  </joint>
  <joint name="color_optical_joint" type="fixed">
    <origin rpy="-1.57079632679 0 -1.57079632679"/>
    <parent link="camera_body"/>
    <child link="color_optical"/>
  </joint>
  <joint name="depth_optical_joint" type="fixed">
    <parent link="camera_body"/>
    <child link="depth_optical"/>
    <origin xyz="0 0.015 0" rpy="-1.57079632679 0 -1.57079632679"/>
  </joint>
"""


def pose(*numbers: float) -> np.ndarray:
    """A pose (4, 4) of x, y, z [m] and a rotation vector [rad]."""
    T = np.eye(4)
    T[:3, :3] = pin.exp3(np.array(numbers[3:]))
    T[:3, 3] = numbers[:3]
    return T


#: Where the camera is on the flange, millimetres and degrees from where the URDF has it, and the board on the base.
T_TOOL_OPTICAL = pose(0.07, -0.005, 0.05, 0.02, 0.03, -1.55)
T_BASE_BOARD = pose(0.3, 0.1, 0.02, 0.02, 3.1, 0.1)


def _small_turns(rng: np.random.Generator, count: int) -> np.ndarray:
    return Rotation.from_rotvec(rng.normal(0.0, 1e-4, (count, 3))).as_matrix()


@cache
def urdf_with_camera() -> Urdf:
    """The UR3 of the paper with a camera on `tool0`."""
    text = Path(calib.example.paper_urdf()).read_text(encoding="utf-8")
    return Urdf.from_bytes(text.replace("</robot>", f"{CAMERA}</robot>").encode(), "arm.urdf")


def nominal_and_actual() -> tuple[Robot, Robot]:
    """The arm from the flange to the base, and one whose zeros are off."""
    robot = Robot.from_urdf(urdf_with_camera(), "tool0", "base")
    model = error_model(robot, "zeros")
    zeros = np.random.default_rng(2).normal(0.0, 3e-3, len(model))
    return robot, model.apply(robot, zeros)


def poses_of_board(actual: Robot, q: np.ndarray) -> np.ndarray:
    """The board in the camera (N, 4, 4)."""
    return rigid_inverse(T_TOOL_OPTICAL) @ actual.poses(q) @ T_BASE_BOARD


@kept
def calibration() -> Calibration:
    """A calibration of an arm with wrong zeros, by poses of a board on the base as a camera on the flange sees it."""
    robot, actual = nominal_and_actual()
    rng = np.random.default_rng(4)
    q = random_joint_values(robot, 40, 3)
    T_optical_board = poses_of_board(actual, q)
    table = Measurements(
        joint_names=robot.joint_names,
        joints=q,
        points=T_optical_board[:, :3, 3] + rng.normal(0.0, 1e-4, (len(q), 3)),
        rotations=T_optical_board[:, :3, :3] @ _small_turns(rng, len(q)),
        kinds=("pose",) * len(q),
        targets=("board",) * len(q),
        groups=("color",) * len(q),
    )
    return calibrate(robot, table, cell=Cell(kind="pose", estimate_frame=True, model="zeros"))


#: The camera's numbers, which the images tell; and the print.
INTRINSICS = np.array([900.0, 905.0, 640.0, 360.0, -0.05, 0.02, 1e-3, -5e-4, 0.0])
BOARD = Board(
    pattern="chessboard", columns=6, rows=5, square=0.04, sigma_corner=0.0, sigma_warp=0.0
)
WIDTH, HEIGHT = 1280, 720


def images(actual: Robot, q: np.ndarray) -> np.ndarray:
    """The images of the board's corners (N, n, 2) [px]; NaN where the board is not wholly in sight."""
    n = len(BOARD.corners)
    result = np.full((len(q), n, 2), np.nan)
    for k, T in enumerate(poses_of_board(actual, q)):
        points = BOARD.corners @ T[:3, :3].T + T[:3, 3]
        if points[:, 2].min() < 0.2 or points[:, 2].max() > 0.9 or T[2, 2] < 0.5:
            continue
        pixels = LENSES["pinhole"].project(points, INTRINSICS)
        if np.all(pixels > 0.0) and np.all(pixels < (WIDTH - 1, HEIGHT - 1)):
            result[k] = pixels
    return result


@kept
def image_calibration() -> Calibration:
    """A calibration of the same arm by images of the board, of whose camera the size alone is known."""
    robot, actual = nominal_and_actual()
    candidates = random_joint_values(robot, 12000, 3)
    pixels = images(actual, candidates)
    seen = np.flatnonzero(np.isfinite(pixels[:, 0, 0]))[:20]
    n = len(BOARD.corners)
    count = len(seen) * n
    measured = pixels[seen].reshape(-1, 2)
    measured += np.random.default_rng(5).normal(0.0, 0.05, measured.shape)
    table = Measurements(
        joint_names=robot.joint_names,
        joints=np.repeat(candidates[seen], n, axis=0),
        points=np.full((count, 3), np.nan),
        kinds=("pixel",) * count,
        targets=("board",) * count,
        groups=("color",) * count,
        images=tuple(f"{k // n}.png" for k in range(count)),
        corners=tuple(str(k % n) for k in range(count)),
        board_points=np.tile(BOARD.corners, (len(seen), 1)),
        readings={"u": measured[:, 0], "v": measured[:, 1]},
        sigma={"px": np.full(count, 0.05)},
    )
    camera = Camera(name="color", width=WIDTH, height=HEIGHT)
    cell = Cell(
        kind="pixel",
        estimate_frame=True,
        model="zeros",
        cameras={"color": camera},
        boards={"board": BOARD},
    )
    return calibrate(robot, table, cell=cell, validate=False)


def words(to: str, path: str, result: Calibration, **names: str) -> list[str]:
    """What a conversion of a result to a format prints of it, each paragraph in one line."""
    describe = FORMATS[to].describe
    assert describe is not None
    source = result_source(result, Options(), "result")
    options = Options(camera=CameraOptions(**names))
    conversion = Conversion(source, to, Path(path), (), options=options)
    return [" ".join(paragraph.split()) for paragraph in describe(conversion)]
