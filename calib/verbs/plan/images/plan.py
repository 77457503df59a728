"""plan of images: a robot, a camera and a board in, the poses to take images at out, in the order to drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arguments import check_callable, check_type, numbers
from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import Value
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.inputs import CellInput, RobotInput, cell_of, robot_of
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.plan.candidates import planning_ranges
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.collision import CollisionCheck
from calib.verbs.plan.forecast import Forecast, Workspace
from calib.verbs.plan.images.bodies import ImageBodies
from calib.verbs.plan.images.candidates import Inverse, Wanted, draw_images
from calib.verbs.plan.images.sensitivity import ImageSensitivity
from calib.verbs.plan.images.sight import LARGEST_TILT, CameraSight, SightLimits, with_intrinsics
from calib.verbs.plan.notes import Note
from calib.verbs.plan.plan import Plan, Planned, Progress, planned_of, stage

#: Candidates to choose from, unless another number is given: an image has many rows, and good ones are alike.
CANDIDATES = 600

#: The print's scale is worth a remark where the error without its uncertainty is a smaller share of that with it.
_MATTERS = 0.7

_USUAL_POSES = PlanRequest(candidates=CANDIDATES)
_USUAL_CHECK = CollisionCheck()

Entry = TypeVar("Entry")


@dataclass(frozen=True, slots=True, eq=False)
class ImageRequest(Value):
    """Images that are wanted, and where camera and board are, to a few centimetres and degrees."""

    #: Shape (4, 4), pose of the camera in the link that carries it [m]: z along the line of sight, y down in the image.
    T_link_camera: ArrayLike
    #: Shape (4, 4), pose of the board in the link that carries it [m]: z away from the camera that sees it.
    T_link_board: ArrayLike
    #: Least and largest distance of the board's centre from the camera [m]; None: it fills 15 to 80 % of the image.
    distances: tuple[float, float] | None = None
    #: Largest angle between line of sight and the board's normal [rad].
    tilt: float = LARGEST_TILT
    #: Share of the board's corners that must be in the image; 1: the whole pattern.
    share: float = 1.0
    #: Numbers of images to fit and to validate with, criterion, number of candidates, margin, start and seed.
    poses: PlanRequest = _USUAL_POSES

    def __post_init__(self) -> None:
        """Refuse a request for poses of another type."""
        check_type("poses", self.poses, PlanRequest, "a PlanRequest")

    def sight(self, camera: Camera, board: Board) -> CameraSight:
        """Return camera and board as placed, with the limits of the images.

        Args:
            camera: The camera; intrinsics that it lacks are assumed.
            board: The board.

        Raises:
            CalibError: Limits that no board can keep, or a pose of another shape.
        """
        known = with_intrinsics(camera)
        usual = SightLimits.of(known, board)
        nearest, farthest = self.distances or (usual.nearest, usual.farthest)
        limits = SightLimits(nearest, farthest, self.tilt, self.share, usual.margin)
        T_link_camera = _pose("T_link_camera", self.T_link_camera)
        T_link_board = _pose("T_link_board", self.T_link_board)
        return CameraSight(known, board, rigid_inverse(T_link_camera), T_link_board, limits)


def plan_images(
    robot: RobotInput,
    cell: CellInput,
    images: ImageRequest,
    inverse: Inverse,
    *,
    taken: ArrayLike | None = None,
    collisions: CollisionCheck | None = _USUAL_CHECK,
    progress: Progress | None = None,
) -> Plan:
    """Plan the poses at which images of a board are taken.

    Args:
        robot: The nominal robot, from the link that carries the camera to that which carries the board; or the path of
            a URDF or xacro, or a name such as ``"ur3"``, with the cell's base and tip.
        cell: What the fit will use: the camera and the board, noise, priors, model, joint ranges; or the path of a cell
            file.
        images: Where camera and board are, and which images are wanted.
        inverse: Inverse kinematics, `calib.verbs.plan.reaching.reach`.
        taken: Joint values of images taken already, shape (T, m), [rad] or [m]: the plan adds to them; None: none.
        collisions: How poses and moves are checked for collisions, and that nothing hides the board; None: neither is.
        progress: Called with the stage of the work, ``"candidates"`` or ``"choice"``, how much of it is done, and all
            of it; None: nothing is called.

    Returns:
        The plan; what is expected of an image is the board's centre in the camera.

    Raises:
        ArgumentError: An argument of another type.
        CalibError: No camera or board, or several; too few poses for the model; the camera sees the board nowhere.
    """
    check_type("images", images, ImageRequest, "an ImageRequest")
    check_type("collisions", collisions, (CollisionCheck, type(None)), "a CollisionCheck, or None")
    check_callable("progress", progress)
    images.poses.check(images.poses.candidates)
    known = cell_of(cell)
    arm = robot_of(robot, known)
    sight = images.sight(_only(known.cameras, "camera"), _only(known.boards, "board"))
    bodies = None
    if collisions is not None:
        bodies = ImageBodies.of(arm, sight, known.boxes, collisions)
    ranges = planning_ranges(arm, known.ranges, images.poses.margin)
    reach = partial(inverse, arm, ranges)
    planned = Planned(
        sensitivity=ImageSensitivity.of_images(arm, known, sight),
        request=images.poses,
        pool=draw_images(
            arm,
            sight,
            ranges,
            bodies,
            Wanted.of(images.poses),
            reach,
            stage(progress, "candidates"),
        ),
        taken=_different(arm, taken),
        body=None if bodies is None else bodies.model,
        sight=sight,
    )
    result = planned_of(planned, stage(progress, "choice"))
    return replace(result, notes=(*_scale_notes(planned, result), *result.notes))


def _pose(name: str, value: ArrayLike) -> Array:
    """Return a pose (4, 4) that was given; raises `CalibError` where it has another shape."""
    T = numbers(name, value, "a pose of shape (4, 4)")
    if T.shape != (4, 4):
        raise CalibError(f"{name} is a pose of shape (4, 4), not one of shape {T.shape}.")
    return read_only(T)


def _only(entries: Mapping[str, Entry], what: str) -> Entry:
    """Return the only camera, or the only board; raises `CalibError` where there is none, or several."""
    if len(entries) != 1:
        given = f"{len(entries)} were given" if entries else "none was given"
        example = "1280x720" if what == "camera" else "board.toml"
        raise CalibError(
            f"Images are planned for one {what} at a time, and {given}. Give one: --{what} {example}."
        )
    return next(iter(entries.values()))


def _different(robot: Robot, taken: ArrayLike | None) -> Array:
    """Return the joint values of images taken already, each once: a table of corners has many rows of an image."""
    if taken is None:
        return read_only(np.zeros((0, len(robot.inputs))))
    q = robot.columns(taken, "taken")
    _, first = np.unique(q, axis=0, return_index=True)
    return read_only(q[np.sort(first)])


def _scale_notes(planned: Planned, plan: Plan) -> tuple[Note, ...]:
    """Return the remark that the scale of the print makes most of the error, if it does."""
    sensitivity, pool = planned.sensitivity, planned.pool
    assert planned.sight is not None
    is_scale = np.array([name.startswith("board_scale") for name in sensitivity.names])
    sigma = planned.sight.board.sigma_scale
    if not is_scale.any() or not sigma:
        return ()
    precision = np.where(is_scale, 1e6 * sensitivity.precision, sensitivity.precision)
    exact = replace(sensitivity, precision=read_only(precision))
    q = np.concatenate([plan.taken, plan.estimation])
    rms = Forecast.of(exact, Workspace.of(exact, pool.workspace, pool.q), q).rms
    if rms > _MATTERS * plan.forecast.rms:
        return ()
    return (Note("board_scale", (sigma, rms)),)
