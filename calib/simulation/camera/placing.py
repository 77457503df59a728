"""Places of camera and board in a cell: of several that are drawn, the one with most views, and the most various."""

from __future__ import annotations

import numpy as np

from calib.camera.camera import Camera
from calib.errors import CalibError
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.simulation.camera.mounts import (
    board_in_workspace,
    board_on_flange,
    camera_beside,
    camera_on_flange,
)
from calib.simulation.camera.scene import USUAL_FRAMING, CameraScene, Framing, filling_distance
from calib.simulation.camera.views import try_views
from calib.units import Array
from calib.vision.printed import Print

#: Places that are compared.
_PLACES = 12

#: Views that are tried for at each.
_TRIES = 48

#: Share of the image that a board fills at least where it is seen from beside the robot.
_STILL_FILLS = 0.25


def draw_scene(
    robot: Robot,
    camera: Camera,
    printed: Print,
    seed: int | np.random.Generator,
    framing: Framing = USUAL_FRAMING,
) -> CameraScene:
    """Draw the places of camera and board in a cell.

    A camera on the flange looks outward, and the board lies on the table or hangs on a wall; a camera beside the robot
    looks at its workspace, and the board is on the flange.

    Args:
        robot: The chain from the link that carries the camera to the one that carries the board; one of both must not
            move.
        camera: The camera, whose numbers are known.
        printed: The board.
        seed: Of the random numbers, or where they come from.
        framing: How pictures are to show the board.

    Raises:
        CalibError: Both links move, or the board is seen from nowhere.
    """
    rng = np.random.default_rng(seed)
    best = None
    most = 0.0
    for _ in range(_PLACES):
        scene = _draw_place(robot, camera, printed, rng)
        worth = _worth(try_views(scene, _TRIES, rng, framing))
        if worth > most:
            best, most = scene, worth
    if best is None:
        raise CalibError(
            f"In {_PLACES} cells that were drawn the camera at '{robot.base}' never sees the whole board at "
            f"'{robot.tip}': make the board smaller or larger, or state where both are."
        )
    return best


def _draw_place(
    robot: Robot, camera: Camera, printed: Print, rng: np.random.Generator
) -> CameraScene:
    """Draw one place of camera and board."""
    centre = printed.board.centre
    if camera_moves(robot):
        arm = robot.rebuilt(base=robot.tip, tip=robot.base)
        T_camera_base = rigid_inverse(camera_on_flange(arm, rng))
        T_tip_board = board_in_workspace(arm, centre, rng)
    else:
        farthest = filling_distance(camera, printed.board) / _STILL_FILLS
        T_camera_base = rigid_inverse(camera_beside(robot, farthest, rng))
        T_tip_board = board_on_flange(robot, centre, rng)
    return CameraScene(robot, camera, printed, read_only(T_camera_base), read_only(T_tip_board))


def _worth(q: Array) -> float:
    """Return what views (n, m) [rad] or [m] are worth: their number, times how far the joints move between them."""
    if not len(q):
        return 0.0
    # The root of the standard deviations counts the joint that hardly moves, and is not lost in one that turns round.
    return float(len(q) * np.mean(np.sqrt(q.std(axis=0))))


def camera_moves(robot: Robot) -> bool:
    """Return whether the robot moves the camera, its base, and not the board, its tip.

    Raises:
        CalibError: It moves both.
    """
    moving = {joint.name for joint in robot.joints}
    on_camera_side, on_board_side = robot.urdf.chain(robot.base, robot.tip)
    if moving.intersection(on_camera_side) and moving.intersection(on_board_side):
        raise CalibError(
            f"Both '{robot.base}', which carries the camera, and '{robot.tip}', which carries the board, move; state "
            "where camera and board are on them."
        )
    return bool(moving.intersection(on_camera_side))
