"""Joint values at which a camera sees the whole board, near and far, tilted in all directions, all over the image.

A view is chosen at random: where the centre c of the board and its normal n are to be in the camera. From random joint
values, Levenberg-Marquardt steps lead towards it within the limits, with derivatives by differences:

    e  = (c_wanted - c, L (n_wanted - n)),   dq = (J^T J + lambda^2)^-1 J^T e

If an arm cannot reach a view, its joint values are scattered. What counts is whether the picture shows the whole board
in the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.boards.board import Board
from calib.boards.printed import Print
from calib.boards.project import Sight, corner_pixels, rays
from calib.camera.camera import Camera
from calib.errors import CalibError
from calib.instruments.camera import board_tilts
from calib.instruments.instrument import Sightline
from calib.verbs.plan.pose_candidates import planning_ranges

#: Number of views that are chosen at once.
_BATCH = 128

#: Largest number of such batches.
_BATCHES = 60

#: Number of steps towards each view.
_STEPS = 25

#: Largest move of a joint in one step [rad or m].
_LONGEST_STEP = 0.5

#: Least step, to divide by [rad or m].
_STILL = 1e-12

#: lambda, for errors in metres and joint values in radians.
_DAMPING = 0.02

#: L, the weight of the normal against lengths [m].
_NORMAL = 0.3

#: Difference of joint values for derivatives [rad or m].
_DIFFERENCE = 1e-6

#: Margin to the joints' limits [rad].
_LIMIT_MARGIN = np.deg2rad(2.0)

#: Largest error of a view that is reached [m].
_REACHED = 0.02

#: Largest scatter of a joint, as a share of its range and absolute [rad or m].
_SCATTER_SHARE = 0.1
_SCATTER = 0.3

#: Share of the image's width and height in which the centre of the board is to be.
_CENTRAL = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class CameraScene(Value):
    """A camera on one link of a robot, and a board on another."""

    #: The camera and the board, with the chain between them.
    sightline: Sightline
    #: The camera, whose numbers are known.
    camera: Camera
    #: The board.
    printed: Print


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing(Value):
    """Conditions under which a picture shows the board well."""

    #: Least distance of the corners from the image's edges [px].
    margin: float = 15.0
    #: Largest angle between the board's normal and the line of sight to its centre [rad].
    tilt: float = np.deg2rad(50.0)
    #: Least and largest share of the image's width or height, whichever is more, that the corners span.
    fill: tuple[float, float] = (0.2, 0.8)


#: The usual framing.
USUAL_FRAMING = Framing()


def filled_shares(camera: Camera, pixels: Array) -> Array:
    """Return the share of the image's width or height, whichever is more, that corners (N, n, 2) [px] span, (N,)."""
    spans = pixels.max(axis=1) - pixels.min(axis=1)
    return np.asarray((spans / [camera.width, camera.height]).max(axis=1))


def is_framed(scene: CameraScene, T_camera_board: Array, framing: Framing = USUAL_FRAMING) -> Mask:
    """Return which pictures show the whole board, neither too small nor too large, nor tilted too much.

    Args:
        scene: Has the camera and the board.
        T_camera_board: Poses of the board in the camera, shape (N, 4, 4) [m].
        framing: Conditions under which it is shown well.

    Returns:
        True where a picture does, shape (N,).
    """
    sight = Sight(margin=framing.margin, tilt=np.pi / 2.0)
    pixels, is_seen = corner_pixels(scene.camera, scene.printed.corners, T_camera_board, sight)
    fill = filled_shares(scene.camera, pixels)
    least, most = framing.fill
    is_facing = board_tilts(scene.printed.board, T_camera_board) <= framing.tilt
    return np.asarray(is_seen.all(axis=1) & is_facing & (fill >= least) & (fill <= most))


def filling_distance(camera: Camera, board: Board) -> float:
    """Return the distance [m] at which a board that faces a camera fills the width or the height of its image.

    That is the one that is full first as the board comes nearer. The camera's numbers must be known.
    """
    assert camera.values is not None
    focal_lengths = camera.values[:2]
    shares = focal_lengths * board.size / [camera.width, camera.height]
    return float(shares.max())


def draw_views(
    scene: CameraScene,
    count: int,
    seed: int | np.random.Generator,
    framing: Framing = USUAL_FRAMING,
    progress: Progress | None = None,
) -> Array:
    """Draw joint values at which the camera sees the whole board.

    Args:
        scene: The robot, the camera and the board.
        count: Number of views.
        seed: Of the random numbers, or where they come from.
        framing: Conditions under which a picture shows the board well.
        progress: Called after each batch with the number of views so far and ``count``; None: nothing is called.

    Returns:
        Readings, shape (count, m), [rad] or [m], read-only.

    Raises:
        CalibError: Too few were found.
    """
    rng = np.random.default_rng(seed)
    views = np.empty((0, len(scene.sightline.robot.joint_names)))
    for _ in range(_BATCHES):
        if len(views) >= count:
            break
        views = np.concatenate([views, try_views(scene, _BATCH, rng, framing)])
        if progress is not None:
            progress(min(len(views), count), count)
    if len(views) < count:
        raise CalibError(
            f"The camera sees the whole board at {len(views)} of {_BATCHES * _BATCH} poses that were tried, and "
            f"{count} are wanted. Move the camera or the board, or make the board smaller or larger."
        )
    return read_only(views[:count])


def try_views(
    scene: CameraScene, tries: int, rng: np.random.Generator, framing: Framing = USUAL_FRAMING
) -> Array:
    """Draw as many views as there are tries, and move the robot towards each from random joint values.

    Returned are the readings (n, m), [rad] or [m], of those that show the board well, which may be few or none.
    """
    robot = scene.sightline.robot
    low, high = planning_ranges(robot, {}, _LIMIT_MARGIN).T
    limits = planning_ranges(robot, {}, _LIMIT_MARGIN, turns=True)
    wanted = _draw_wanted(scene, tries, rng, framing)
    start = rng.uniform(low, high, size=(tries, len(limits)))
    values = _approach(scene, wanted, start, limits)
    miss = np.linalg.norm(wanted - _see(scene, values), axis=1)

    # An arm that misses its view is stretched there, and is scattered; a joint at a limit goes back from it.
    low, high = limits.T
    most = np.minimum(_SCATTER_SHARE * (high - low), _SCATTER)
    step = most * rng.uniform(-1.0, 1.0, size=values.shape)
    step = np.where(values <= low, np.abs(step), step)
    step = np.where(values >= high, -np.abs(step), step)
    is_stopped = (values <= low) | (values >= high)
    is_scattered = is_stopped | (miss > _REACHED)[:, None]
    q = robot.readings(np.where(is_scattered, np.clip(values + step, low, high), values))
    return np.asarray(q[is_framed(scene, scene.sightline.target_poses(q), framing)])


def _draw_wanted(
    scene: CameraScene, count: int, rng: np.random.Generator, framing: Framing
) -> Array:
    """Draw where the board's centre [m] and its normal, times `_NORMAL`, are to be in the camera, shape (count, 6)."""
    camera = scene.camera
    size = np.array([camera.width, camera.height])
    pixels = (size - 1) / 2.0 + size * rng.uniform(-0.5, 0.5, size=(count, 2)) * _CENTRAL
    directions = rays(camera, pixels)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    fill = rng.uniform(*framing.fill, size=count)
    distance = filling_distance(camera, scene.printed.board) / fill
    tilt = framing.tilt * np.sqrt(rng.uniform(size=count))[:, None]
    side = np.cross(directions, rng.standard_normal(directions.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    normals = np.cos(tilt) * directions + np.sin(tilt) * side
    return np.column_stack([distance[:, None] * directions, _NORMAL * normals])


def _approach(scene: CameraScene, wanted: Array, start: Array, limits: Array) -> Array:
    """Return joint values (n, m), moved from a start (n, m) towards views (n, 6), within limits (m, 2), [rad] or [m].

    The views are as `_draw_wanted` returns them; the moves are damped Gauss-Newton steps.
    """
    low, high = limits.T
    values = start
    steps = _DIFFERENCE * np.eye(len(low))
    for _ in range(_STEPS):
        seen = _see(scene, values)
        columns = [(_see(scene, values + step) - seen) / _DIFFERENCE for step in steps]
        J = np.stack(columns, axis=-1)
        J_transposed = np.swapaxes(J, 1, 2)
        normal_matrix = J_transposed @ J + _DAMPING**2 * np.eye(len(low))
        gradient = J_transposed @ (wanted - seen)[..., None]
        step = np.linalg.solve(normal_matrix, gradient)[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _STILL))
        values = np.clip(values + step, low, high)
    return values


def _see(scene: CameraScene, values: Array) -> Array:
    """Return centre [m] and normal, times `_NORMAL`, of the board in the camera at joint values (n, m), (n, 6)."""
    sightline = scene.sightline
    T = sightline.target_poses(sightline.robot.readings(values))
    middle = T[:, :3, :3] @ scene.printed.board.centre + T[:, :3, 3]
    return np.concatenate([middle, _NORMAL * T[:, :3, 2]], axis=1)
