"""Drawn places of a camera and a board: on the flange, on the table or a wall, beside the robot.

Several places are drawn, and the one with the most and the most varied views is taken. Up is z of the link that does
not move. The z axis of a camera is the line of sight, that of a board points into the page.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.boards.printed import Print
from calib.camera.camera import Camera
from calib.errors import CalibError
from calib.instruments.instrument import Sightline
from calib.numerics.geometry import pose_of
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.verbs.simulate.views import (
    USUAL_FRAMING,
    CameraScene,
    Framing,
    filling_distance,
    try_views,
)

#: Number of places that are compared.
_PLACES = 12

#: Number of views that are tried at each.
_TRIES = 48

#: Least share of the image that a board fills for a camera beside the robot.
_STILL_FILLS = 0.25

#: Distance of a camera from the axis of the flange that carries it [m].
_BESIDE_FLANGE = (0.05, 0.12)

#: Distance of this camera from the flange, along the axis [m].
_ALONG_FLANGE = (0.0, 0.04)

#: Largest rotation of a mount from its direction about each axis [rad].
_TURN = np.deg2rad(15.0)

#: Distance of a board from the flange that carries it, along its axis [m].
_BEFORE_FLANGE = (0.03, 0.08)

#: Distance of a camera beside the robot from the middle of the workspace [m].
_BESIDE_ROBOT = (1.0, 1.5)

#: Its least distance from there, in reaches of the arm, however small the board is.
_OUTSIDE = 0.9

#: Its elevation, seen from there [rad].
_ELEVATION = (np.deg2rad(5.0), np.deg2rad(50.0))

#: Share of boards that hang on a wall; the others lie on a table.
_ON_WALL = 0.3

#: Least share of the way to the flange along the last joint's axis, if the flange points along it; and least length of
#: the mean direction to another link, if that is mostly on one side.
_POINTS = 0.3


def draw_scene(
    robot: Robot,
    camera: Camera,
    printed: Print,
    seed: int | np.random.Generator,
    T_camera_base: Array | None = None,
    T_tip_board: Array | None = None,
    framing: Framing = USUAL_FRAMING,
) -> CameraScene:
    """Draw the places of camera and board in a cell.

    A camera on the flange looks outward, and the board lies on the table or hangs on a wall; a camera beside the robot
    looks at its workspace, and the board is on the flange. If both links move, the camera looks to where the board's
    link mostly is.

    Args:
        robot: The chain from the camera's link to the board's.
        camera: The camera, whose numbers are known.
        printed: The board.
        seed: Of the random numbers, or where they come from.
        T_camera_base: Pose of the camera's link in the camera, shape (4, 4) [m]; None: drawn.
        T_tip_board: Pose of the board in its link, shape (4, 4) [m]; None: drawn.
        framing: Conditions under which a picture shows the board well.

    Returns:
        Robot, camera and board with the places that give the most and the most varied views, of several drawn.

    Raises:
        CalibError: The board is never seen.
    """
    rng = np.random.default_rng(seed)
    best = None
    most = -1.0  # a single view, between which no joint moves, is worth 0
    centre = printed.board.centre
    moves_camera, moves_board = moving_sides(robot)
    for _ in range(_PLACES):
        T_camera, T_board = T_camera_base, T_tip_board
        if T_camera is None and moves_camera and moves_board:
            T_camera = rigid_inverse(camera_towards(robot, rng))
        elif T_camera is None and moves_camera:
            T_camera = rigid_inverse(camera_on_flange(_reversed(robot), rng))
        elif T_camera is None:
            farthest = filling_distance(camera, printed.board) / _STILL_FILLS
            T_camera = rigid_inverse(camera_beside(robot, farthest, rng))
        if T_board is None and moves_board:
            T_board = board_on_flange(robot, centre, rng)
        elif T_board is None:
            T_board = board_in_workspace(_reversed(robot), centre, rng)
        sightline = Sightline(robot, read_only(T_camera), read_only(T_board))
        scene = CameraScene(sightline, camera, printed)
        q = try_views(scene, _TRIES, rng, framing)
        # Views are worth their number, times how far the joints move between them. By the roots of the standard
        # deviations, a joint that hardly moves still counts beside one that turns all the way round.
        if not len(q):
            continue
        worth = float(len(q) * np.mean(np.sqrt(q.std(axis=0))))
        if worth > most:
            best, most = scene, worth
    if best is None:
        raise CalibError(
            f"In {_PLACES} cells that were drawn the camera at '{robot.base}' never sees the whole board at "
            f"'{robot.tip}': make the board smaller or larger, or state in the cell file where both are: "
            "frame_xyz_mm and frame_rpy_deg, target_mm and target_rpy_deg."
        )
    return best


def _reversed(robot: Robot) -> Robot:
    """Return the chain from the board's link to the camera's."""
    return robot.rebuilt(base=robot.tip, tip=robot.base)


def moving_sides(robot: Robot) -> tuple[bool, bool]:
    """Return whether the robot's joints move the camera, its base, and whether they move the board, its tip."""
    moving = {joint.name for joint in robot.joints}
    on_camera_side, on_board_side = robot.urdf.chain(robot.base, robot.tip)
    return bool(moving.intersection(on_camera_side)), bool(moving.intersection(on_board_side))


# Places


def outward(arm: Robot) -> Array:
    """Return the unit vector in which the flange at the tip of an arm points, in the frame of the tip, shape (3,).

    That is along the axis of the last joint, on the side away from the joint before it; or if that axis lies across,
    the direction from that joint to the flange. For an arm with one joint or none it is the z axis of the tip.
    """
    if len(arm.joints) < 2:
        return np.array([0.0, 0.0, 1.0])
    wrist = arm.rebuilt(base=arm.joints[-2].child)
    T = wrist.poses(np.zeros(len(wrist.inputs)))[0]
    way = T[:3, :3].T @ T[:3, 3]
    axis = arm.placements[-1][:3, :3].T @ np.asarray(arm.joints[-1].axis)
    along = float(axis @ way)
    length = float(np.linalg.norm(way))
    if arm.joints[-1].type != "prismatic" and abs(along) > _POINTS * length:
        return np.asarray(np.sign(along) * axis)
    if length == 0.0:
        return np.asarray(axis)
    return np.asarray(way / length)


def reach(arm: Robot) -> float:
    """Return the distance from the foot of an arm that its flange does not exceed at 95 % of the poses [m]."""
    positions = arm.poses(spread_poses(arm))[:, :3, 3]
    return float(np.quantile(np.linalg.norm(positions, axis=1), 0.95))


def frame_along(z: Array, roll: float) -> Array:
    """Return a rotation whose z axis is a unit vector (3,), turned about it by an angle [rad], shape (3, 3).

    Where x is at an angle of 0 is arbitrary.
    """
    other = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(other, z)
    x /= np.linalg.norm(x)
    frame = np.column_stack([x, np.cross(z, x), z])
    return np.asarray(frame @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix())


def camera_on_flange(arm: Robot, rng: np.random.Generator) -> Array:
    """Draw a camera beside the flange, the tip of an arm, that looks outward; returns T_flange_camera, (4, 4) [m]."""
    flange = frame_along(outward(arm), rng.uniform(0.0, 2.0 * np.pi))
    place = [rng.uniform(*_BESIDE_FLANGE), 0.0, rng.uniform(*_ALONG_FLANGE)]
    return pose_of(flange @ place, flange @ _draw_turn(rng))


def camera_towards(robot: Robot, rng: np.random.Generator) -> Array:
    """Draw a camera on a link that moves, which looks to where another link that moves mostly is.

    If that may be anywhere around it, as between the flanges of two arms, the camera looks outward.

    Args:
        robot: The chain from the camera's link to the other one.
        rng: Random numbers.

    Returns:
        T_link_camera, shape (4, 4) [m].
    """
    positions = robot.poses(spread_poses(robot))[:, :3, 3]
    towards = np.mean(positions / np.linalg.norm(positions, axis=1, keepdims=True), axis=0)
    length = float(np.linalg.norm(towards))
    if length < _POINTS:
        return camera_on_flange(_reversed(robot), rng)
    R = frame_along(towards / length, rng.uniform(0.0, 2.0 * np.pi))
    place = [rng.uniform(*_BESIDE_FLANGE), 0.0, rng.uniform(*_ALONG_FLANGE)]
    return pose_of(R @ place, R @ _draw_turn(rng))


def board_on_flange(arm: Robot, centre: Array, rng: np.random.Generator) -> Array:
    """Draw a board in front of the flange, whose printed side faces outward.

    Args:
        arm: The chain that ends at the flange.
        centre: The board's centre in its frame, shape (3,) [m].
        rng: Random numbers.

    Returns:
        T_flange_board, shape (4, 4) [m].
    """
    direction = outward(arm)
    R = frame_along(-direction, rng.uniform(0.0, 2.0 * np.pi)) @ _draw_turn(rng)
    beside = rng.uniform(-0.04, 0.04, size=3)
    beside -= (beside @ direction) * direction
    middle = rng.uniform(*_BEFORE_FLANGE) * direction + beside
    return pose_of(middle - R @ centre, R)


def board_in_workspace(arm: Robot, centre: Array, rng: np.random.Generator) -> Array:
    """Draw a board that lies on the table or hangs on a wall, about as far as the arm reaches; z of the base is up.

    Args:
        arm: The chain from the link that does not move to the flange.
        centre: The board's centre in its frame, shape (3,) [m].
        rng: Random numbers.

    Returns:
        T_base_board, shape (4, 4) [m].
    """
    length = reach(arm)
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    direction = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    if rng.uniform() < _ON_WALL:
        into_page = direction
        middle = length * (rng.uniform(0.8, 1.2) * direction + rng.uniform(0.1, 0.7) * up)
    else:
        into_page = -up
        middle = length * (rng.uniform(0.35, 0.75) * direction + rng.uniform(-0.2, 0.15) * up)
    R = frame_along(into_page, rng.uniform(0.0, 2.0 * np.pi)) @ _draw_turn(rng, _TURN / 5.0)
    return pose_of(middle - R @ centre, R)


def camera_beside(arm: Robot, farthest: float, rng: np.random.Generator) -> Array:
    """Draw a camera beside the robot that looks at its workspace.

    Args:
        arm: The chain from the link that does not move to the flange.
        farthest: Distance from which the camera still sees the board well [m].
        rng: Random numbers.

    Returns:
        T_base_camera, shape (4, 4) [m].
    """
    length = reach(arm)
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    elevation = rng.uniform(*_ELEVATION)
    across = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    middle = length * (rng.uniform(0.2, 0.5) * across + rng.uniform(0.2, 0.6) * up)
    distance = max(_OUTSIDE * length, min(rng.uniform(*_BESIDE_ROBOT), farthest))
    towards_camera = np.cos(elevation) * across + np.sin(elevation) * up
    # Up in the picture is up in the cell, except for a small rotation.
    line_of_sight = -towards_camera
    right = np.cross(line_of_sight, up)
    right /= np.linalg.norm(right)
    upright = np.column_stack([right, np.cross(line_of_sight, right), line_of_sight])
    return pose_of(middle + distance * towards_camera, upright @ _draw_turn(rng))


def _draw_turn(rng: np.random.Generator, most: float = _TURN) -> Array:
    """Draw a small rotation, at most by an angle [rad] about each axis, shape (3, 3)."""
    return np.asarray(Rotation.from_rotvec(rng.uniform(-most, most, size=3)).as_matrix())
