"""Candidates of a plan of images: joint values at which the camera sees the board.

Random joint values rarely do. So viewpoints are drawn first, and the robot is brought to each as near as it can by
inverse kinematics, from the joint values whose view is nearest to it. What it reaches is tested, not what was wanted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.jobs import Progress
from calib.errors import ModelError
from calib.robot.ranges import spread_between
from calib.robot.robot import Robot
from calib.verbs.plan.candidates import Condition, Draws, Pool, collect, rounded
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.images.bodies import ImageBodies
from calib.verbs.plan.images.sight import CameraSight
from calib.verbs.plan.images.viewpoints import NUMBERS, viewpoints

#: Inverse kinematics: function of wanted poses of the tip in the base, shape (n, 4, 4), [m], and of joint values to
#: start at, shape (n, m), [rad] or [m], that returns joint values as near to the wanted poses as it comes.
Reach = Callable[[Array, Array], Array]

#: The same of any robot: the robot and the ranges of its joints, shape (m, 2), [rad] or [m], come before these.
Inverse = Callable[[Robot, Array, Array, Array], Array]

#: Viewpoints of one batch; a power of two keeps the sequence even.
_BATCH = 512

#: At most this many times the wanted number are drawn.
_MOST = 10

#: At most this many are drawn until the first that can be measured.
_NONE_YET = 8 * _BATCH

#: Viewpoints drawn for each that is tried: of those with the board in the image the robot tries the nearest.
_CHOICE = 8

#: Joint values among which those to start at are looked for.
_STARTS = 2048

#: Distance that counts as much as a turn by one radian where views are compared [m].
_RADIAN = 0.3

_TURN = 2.0 * np.pi


class Wanted(NamedTuple):
    """Candidates that are wanted."""

    #: How many are enough, 1 or more.
    number: int
    #: Seed: the same one draws the same poses.
    seed: int

    @classmethod
    def of(cls, request: PlanRequest) -> Wanted:
        """Return the candidates that a plan is made of."""
        return cls(request.candidates, request.seed)


def draw_images(
    robot: Robot,
    sight: CameraSight,
    ranges: Array,
    bodies: ImageBodies | None,
    wanted: Wanted,
    reach: Reach,
    progress: Progress | None = None,
) -> Pool:
    """Draw poses at which the camera sees the board, spread over viewpoints, until there are enough.

    Args:
        robot: The robot, from the link that carries the camera to that which carries the board.
        sight: The camera, the board, and where it may be in the camera.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
        bodies: Tests poses for collisions, and the view of the board for what is in it; None: neither is tested.
        wanted: The number of candidates, and the seed.
        reach: Inverse kinematics of the robot.
        progress: Called after each batch with the number of candidates so far and that wanted; None: nothing is called.

    Returns:
        The pool: ``q``, joint values of the candidates, shape (n, m), [rad] or [m]; ``workspace``, as many poses spread
        over the joints' ranges as are wanted, wherever the camera looks; how many poses were drawn, and refused for
        ``"limits"``, ``"focus"``, ``"tilt"``, ``"image"``, ``"beam"`` (a link or box between camera
        and board) and ``"collision"``.

    Raises:
        ModelError: The camera sees the board at no pose that was drawn.
    """
    conditions = list(_conditions(robot, sight, ranges, bodies))
    draws = Draws(wanted.number, _NONE_YET, _MOST * max(wanted.number, _BATCH))
    batches = _batches(robot, sight, ranges, wanted.seed, reach)
    pool = collect(batches, conditions, draws, progress)
    workspace = robot.readings(spread_between(ranges, len(pool.q)))
    return pool._replace(workspace=read_only(workspace))


def _batches(
    robot: Robot, sight: CameraSight, ranges: Array, seed: int, reach: Reach
) -> Iterator[Array]:
    """Yield batches of joint values, (512, m) [rad] or [m], that bring the robot near viewpoints, without end."""
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    sequence = qmc.Sobol(NUMBERS, scramble=True, seed=seed)
    starts = robot.readings(spread_between(ranges, _STARTS))
    views = _coordinates(sight.board_poses(robot, starts))
    while True:
        T_camera_board = _in_image(sight, viewpoints(sight, sequence.random(_CHOICE * _BATCH)))
        start, distance = _nearest(views, _coordinates(T_camera_board))
        near = np.argsort(distance)[:_BATCH]
        q = reach(sight.tip_poses(T_camera_board[near]), starts[start[near]])
        yield rounded(robot, _turned_into(robot, q, ranges))


def _in_image(sight: CameraSight, T_camera_board: Array) -> Array:
    """Return the poses of a board in the camera (n, 4, 4), [m], of which it is in the image.

    Raises:
        ModelError: There are none.
    """
    inside = T_camera_board[sight.in_image(T_camera_board)]
    if not len(inside):
        _refuse_none_in_image(sight)
    return inside


def _refuse_none_in_image(sight: CameraSight) -> None:
    """Raise the error that the board is in the image from no viewpoint.

    Raises:
        ModelError: Always.
    """
    limits = sight.limits
    raise ModelError(
        f"At distances from {1e3 * limits.nearest:.4g} to {1e3 * limits.farthest:.4g} mm the board "
        f"'{sight.board.name}' is never in the image of {sight.camera.width} x {sight.camera.height} px "
        f"({100 * limits.share:.3g} % of its corners). Widen the distances, take a smaller board, or ask for a smaller "
        "share of the corners."
    )


def _coordinates(T: Array) -> Array:
    """Return poses (n, 4, 4) as coordinates (n, 12) [m], whose distances weigh shifts and turns."""
    # Of a small turn by an angle a, the nine entries of the matrix change by a sqrt(2) in all.
    turns = T[:, :3, :3].reshape(-1, 9) * (_RADIAN / np.sqrt(2.0))
    return np.concatenate([T[:, :3, 3], turns], axis=1)


def _nearest(places: Array, wanted: Array) -> tuple[Integers, Array]:
    """Return the index of the nearest of places (N, k) to each wanted one (n, k), and its distance, shape (n,) each."""
    squares = np.sum(places**2, axis=1) - 2.0 * wanted @ places.T
    nearest = np.argmin(squares, axis=1)
    return nearest, np.linalg.norm(places[nearest] - wanted, axis=1)


def _turned_into(robot: Robot, q: Array, ranges: Array) -> Array:
    """Return joint values with joints that turn moved by whole turns into their ranges, where that can be.

    Args:
        robot: The robot.
        q: Readings, shape (n, m), [rad] or [m].
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or [m].

    Returns:
        Readings, shape (n, m), [rad] or [m].
    """
    values = robot.input_values(q)
    middle = ranges.mean(axis=1)
    turns = np.array([joint.type != "prismatic" for joint in robot.inputs])
    moved = values - _TURN * np.round((values - middle) / _TURN)
    return robot.readings(np.where(turns, moved, values))


def _within(robot: Robot, ranges: Array, q: Array) -> Mask:
    """Test whether all joints are between their lowest and highest values (m, 2), at readings (n, m); shape (n,)."""
    values = robot.input_values(q)
    return np.asarray(((values >= ranges[:, 0]) & (values <= ranges[:, 1])).all(axis=1))


def _conditions(
    robot: Robot, sight: CameraSight, ranges: Array, bodies: ImageBodies | None
) -> Iterator[Condition]:
    """Yield what a candidate must pass, the cheap conditions first; see `draw_images`."""
    yield Condition("limits", partial(_within, robot, ranges))
    yield Condition("focus", lambda q: sight.in_focus(sight.board_poses(robot, q)))
    yield Condition("tilt", lambda q: sight.is_facing(sight.board_poses(robot, q)))
    yield Condition("image", lambda q: sight.in_image(sight.board_poses(robot, q)))
    if bodies is not None:
        yield Condition("beam", bodies.view_free)
        yield Condition("collision", bodies.model.free)
