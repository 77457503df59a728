"""Joint values at which the camera sees the board, near and far, tilted every way, all over the image.

A view is wished for at random: where the board's middle c and its normal n are to be in the camera. From random joint
values Levenberg-Marquardt steps lead towards it, with differences for derivatives, and stay within the limits:

    e  = (c_wished - c, L (n_wished - n)),   dq = (J^T J + lambda^2)^-1 J^T e

What an arm cannot reach it misses, and its joint values are scattered; what counts is whether the picture shows the
whole board in the end.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.jobs import Progress
from calib.boards.project import rays
from calib.errors import CalibError
from calib.verbs.plan.candidates import planning_ranges
from calib.verbs.simulate.camera.scene import (
    USUAL_FRAMING,
    CameraScene,
    Framing,
    filling_distance,
    is_framed,
)

#: Views that are wished for at once.
_BATCH = 128

#: Most batches.
_BATCHES = 60

#: Steps towards each view.
_STEPS = 25

#: No joint moves farther in one step [rad or m].
_LONGEST_STEP = 0.5

#: A step shorter than this is none [rad or m].
_STILL = 1e-12

#: lambda, for errors in metres and joint values in radians.
_DAMPING = 0.02

#: L, the length that a unit of the normal weighs [m].
_NORMAL = 0.3

#: Difference of joint values for derivatives [rad or m].
_DIFFERENCE = 1e-6

#: Distance to the joints' limits [rad].
_LIMIT_MARGIN = np.deg2rad(2.0)

#: A view that is missed by less is reached [m].
_REACHED = 0.02

#: A joint is scattered by this share of its range at most, and by this [rad or m].
_SCATTER_SHARE = 0.1
_SCATTER = 0.3

#: The middle of the board is wished for in this share of the image's width and height.
_CENTRAL = 0.7


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
        framing: How the pictures are to show the board.
        progress: Called after each batch with the number of views so far and ``count``; None: nothing is called.

    Returns:
        Readings, shape (count, m), [rad] or [m], read-only.

    Raises:
        CalibError: Too few were found.
    """
    rng = np.random.default_rng(seed)
    views = np.empty((0, len(scene.robot.joint_names)))
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
    """Try for a number of views; returns the readings (n, m) [rad] or [m] of those that show the whole board."""
    robot = scene.robot
    ranges = planning_ranges(robot, {}, _LIMIT_MARGIN)
    limits = planning_ranges(robot, {}, _LIMIT_MARGIN, turns=True)
    wished = _wishes(scene, tries, rng, framing)
    low, high = ranges.T
    start = rng.uniform(low, high, size=(tries, len(ranges)))
    values = _approach(scene, wished, start, limits)
    miss = np.linalg.norm(wished - _shown(scene, values), axis=1)
    q = robot.readings(_scattered(values, miss, limits, rng))
    return np.asarray(q[is_framed(scene, scene.board_poses(q), framing)])


def _wishes(scene: CameraScene, count: int, rng: np.random.Generator, framing: Framing) -> Array:
    """Draw where the board's middle and its normal are to be in the camera.

    Args:
        scene: Has the camera and the board.
        count: Number of views.
        rng: Random numbers.
        framing: How the pictures are to show the board.

    Returns:
        The middle [m] and the normal times `_NORMAL`, shape (count, 6).
    """
    camera = scene.camera
    size = np.array([camera.width, camera.height])
    pixels = (size - 1) / 2.0 + size * rng.uniform(-0.5, 0.5, size=(count, 2)) * _CENTRAL
    directions = rays(camera, pixels)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    fill = rng.uniform(*framing.fill, size=count)
    distance = filling_distance(camera, scene.printed.board) / fill
    tilt = framing.tilt * np.sqrt(rng.uniform(size=count))
    normals = _tilted(directions, tilt, rng)
    return np.column_stack([distance[:, None] * directions, _NORMAL * normals])


def _tilted(directions: Array, tilt: Array, rng: np.random.Generator) -> Array:
    """Turn unit vectors (n, 3) by angles (n,) [rad] to random sides, shape (n, 3)."""
    side = np.cross(directions, rng.standard_normal(directions.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.asarray(np.cos(tilt)[:, None] * directions + np.sin(tilt)[:, None] * side)


def _approach(scene: CameraScene, wished: Array, start: Array, limits: Array) -> Array:
    """Go from joint values towards views.

    Args:
        scene: The robot, the camera and the board.
        wished: Middle and normal of the board, see `_wishes`, shape (n, 6).
        start: Joint values, shape (n, m), [rad] or [m].
        limits: Lowest and highest joint values, shape (m, 2), [rad] or [m].

    Returns:
        Joint values, shape (n, m), [rad] or [m].
    """
    low, high = limits.T
    values = start
    for _ in range(_STEPS):
        shown = _shown(scene, values)
        J = _derivative(scene, values, shown)
        J_transposed = np.swapaxes(J, 1, 2)
        normal_matrix = J_transposed @ J + _DAMPING**2 * np.eye(len(low))
        gradient = J_transposed @ (wished - shown)[..., None]
        step = np.linalg.solve(normal_matrix, gradient)[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _STILL))
        values = np.clip(values + step, low, high)
    return values


def _scattered(values: Array, miss: Array, limits: Array, rng: np.random.Generator) -> Array:
    """Scatter joint values that missed their view: they lie where the arm is stretched, or a joint at its limit.

    Args:
        values: Joint values, shape (n, m), [rad] or [m].
        miss: How far each is from its view, shape (n,), [m].
        limits: Lowest and highest joint values, shape (m, 2), [rad] or [m].
        rng: Random numbers.

    Returns:
        Joint values, shape (n, m), [rad] or [m]. A joint at its limit goes back from it.
    """
    low, high = limits.T
    most = np.minimum(_SCATTER_SHARE * (high - low), _SCATTER)
    step = most * rng.uniform(-1.0, 1.0, size=values.shape)
    step = np.where(values <= low, np.abs(step), step)
    step = np.where(values >= high, -np.abs(step), step)
    is_stopped = (values <= low) | (values >= high)
    is_scattered = is_stopped | (miss > _REACHED)[:, None]
    return np.where(is_scattered, np.clip(values + step, low, high), values)


def _shown(scene: CameraScene, values: Array) -> Array:
    """Return middle and normal of the board, see `_wishes`, at joint values (n, m) [rad] or [m], shape (n, 6)."""
    T = scene.board_poses(scene.robot.readings(values))
    middle = T[:, :3, :3] @ scene.printed.board.centre + T[:, :3, 3]
    return np.concatenate([middle, _NORMAL * T[:, :3, 2]], axis=1)


def _derivative(scene: CameraScene, values: Array, shown: Array) -> Array:
    """Return the derivative of `_shown` at joint values (n, m), where it is (n, 6), by differences, (n, 6, m)."""
    steps = _DIFFERENCE * np.eye(values.shape[1])
    columns = [(_shown(scene, values + step) - shown) / _DIFFERENCE for step in steps]
    return np.stack(columns, axis=-1)
