"""Places of camera and board in a cell: of several that are drawn, the one with most views, and the most various."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import Value
from calib.boards.printed import Print
from calib.camera.camera import Camera
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.mounts import (
    board_in_workspace,
    board_on_flange,
    camera_beside,
    camera_on_flange,
)
from calib.verbs.simulate.camera.scene import USUAL_FRAMING, CameraScene, Framing, filling_distance
from calib.verbs.simulate.camera.views import try_views

#: Places that are compared.
_PLACES = 12

#: Views that are tried for at each.
_TRIES = 48

#: Share of the image that a board fills at least where it is seen from beside the robot.
_STILL_FILLS = 0.25


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Mounts(Value):
    """Mounts of camera and board that are given; the others are drawn."""

    #: Pose of the camera's link in the camera, shape (4, 4) [m]; None: drawn.
    T_camera_base: Array | None = None
    #: Pose of the board in its link, shape (4, 4) [m]; None: drawn.
    T_tip_board: Array | None = None


#: Both mounts are drawn.
NONE_GIVEN = Mounts()


def draw_scene(
    robot: Robot,
    camera: Camera,
    printed: Print,
    seed: int | np.random.Generator,
    mounts: Mounts = NONE_GIVEN,
    framing: Framing = USUAL_FRAMING,
) -> CameraScene:
    """Draw the places of camera and board in a cell.

    A camera on the flange looks outward, and the board lies on the table or hangs on a wall; a camera beside the robot
    looks at its workspace, and the board is on the flange.

    Args:
        robot: The chain from the link that carries the camera to the one that carries the board. If both move, the
            camera's mount must be given.
        camera: The camera, whose numbers are known.
        printed: The board.
        seed: Of the random numbers, or where they come from.
        mounts: Those that are given.
        framing: How pictures are to show the board.

    Raises:
        CalibError: Both links move and the camera's mount is not given, or the board is seen from nowhere.
    """
    rng = np.random.default_rng(seed)
    best = None
    most = 0.0
    for _ in range(_PLACES):
        scene = _draw_place(robot, camera, printed, mounts, rng)
        worth = _worth(try_views(scene, _TRIES, rng, framing))
        if worth > most:
            best, most = scene, worth
    if best is None:
        raise CalibError(
            f"In {_PLACES} cells that were drawn the camera at '{robot.base}' never sees the whole board at "
            f"'{robot.tip}': make the board smaller or larger, or state in the cell file where both are: "
            "frame_xyz_mm and frame_rpy_deg, target_mm and target_rpy_deg."
        )
    return best


def _draw_place(
    robot: Robot, camera: Camera, printed: Print, mounts: Mounts, rng: np.random.Generator
) -> CameraScene:
    """Draw one place of camera and board, where these are not given."""
    centre = printed.board.centre
    T_camera_base = mounts.T_camera_base
    T_tip_board = mounts.T_tip_board
    if T_camera_base is None:
        T_camera_base = rigid_inverse(_draw_camera(robot, camera, printed, rng))
    if T_tip_board is None and moving_sides(robot)[1]:
        T_tip_board = board_on_flange(robot, centre, rng)
    elif T_tip_board is None:
        T_tip_board = board_in_workspace(_reversed(robot), centre, rng)
    return CameraScene(robot, camera, printed, read_only(T_camera_base), read_only(T_tip_board))


def _draw_camera(robot: Robot, camera: Camera, printed: Print, rng: np.random.Generator) -> Array:
    """Draw a camera on the flange, or beside the robot; returns T_base_camera, shape (4, 4) [m]."""
    if camera_moves(robot):
        return camera_on_flange(_reversed(robot), rng)
    farthest = filling_distance(camera, printed.board) / _STILL_FILLS
    return camera_beside(robot, farthest, rng)


def _reversed(robot: Robot) -> Robot:
    """Return the chain from the board's link to the camera's."""
    return robot.rebuilt(base=robot.tip, tip=robot.base)


def _worth(q: Array) -> float:
    """Return what views (n, m) [rad] or [m] are worth: their number, times how far the joints move between them."""
    if not len(q):
        return 0.0
    # The root of the standard deviations counts the joint that hardly moves, and is not lost in one that turns round.
    return float(len(q) * np.mean(np.sqrt(q.std(axis=0))))


def moving_sides(robot: Robot) -> tuple[bool, bool]:
    """Return whether the robot's joints move the camera, its base, and whether they move the board, its tip."""
    moving = {joint.name for joint in robot.joints}
    on_camera_side, on_board_side = robot.urdf.chain(robot.base, robot.tip)
    return bool(moving.intersection(on_camera_side)), bool(moving.intersection(on_board_side))


def camera_moves(robot: Robot) -> bool:
    """Return whether the robot moves the camera, its base, and not the board, its tip.

    Raises:
        CalibError: It moves both.
    """
    moves_camera, moves_board = moving_sides(robot)
    if moves_camera and moves_board:
        raise CalibError(
            f"Both '{robot.base}', which carries the camera, and '{robot.tip}', which carries the board, move; state "
            "in the cell file where the link is in the camera: frame_xyz_mm and frame_rpy_deg."
        )
    return moves_camera
