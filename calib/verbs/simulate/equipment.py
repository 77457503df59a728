"""Cameras and boards of virtual cells: usual ones, and true ones drawn around stated ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.boards.board import BODY, CHARUCO, Board
from calib.boards.printed import Print, draw_print
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.errors import CalibError, choices
from calib.robot.robot import Robot
from calib.verbs.simulate.mounting import reach
from calib.verbs.simulate.random_streams import stream

#: Numbers of the usual camera: fx, fy, cx, cy [px], k1, k2, p1, p2, k3.
_USUAL = read_only((920.0, 920.0, 639.5, 359.5, 0.1, -0.2, 0.0, 0.0, 0.1))

#: Focal length of a camera without stated numbers, as a share of the image's width.
_FOCAL = (0.65, 0.95)

#: Standard deviation of its first radial coefficient of distortion.
_RADIAL = 0.05

#: Square of the usual board, as a share of the arm's reach, and its least and largest length [m].
_SQUARE = 0.04
_SQUARES = (0.012, 0.04)

#: Ratio of the standard deviations of a coefficient of a fisheye lens and of the one before.
_HIGHER = 0.5

#: Largest number of draws of a lens that does not fold the image.
_DRAWS = 100

#: Number of angles from the axis at which a lens is examined, and the largest one [rad].
_ANGLES = 400
_WIDEST = float(np.deg2rad(85.0))

Described = TypeVar("Described", Camera, Board)


@dataclass(frozen=True, slots=True, eq=False)
class Equipment(Value):
    """The true camera and board of a virtual cell."""

    #: The camera as stated.
    stated: Camera
    #: The camera with its true numbers.
    camera: Camera
    #: The board as printed.
    printed: Print


def draw_equipment(robot: Robot, cell: Cell, seed: int) -> Equipment:
    """Draw camera and board around those that a cell states, or around usual ones, by their standard deviations.

    Args:
        robot: The chain between the links of camera and board, whose reach gives the size of a usual board.
        cell: Has at most one of each.
        seed: Of the random numbers.

    Returns:
        The stated camera, the true one, and the board as it is printed.

    Raises:
        CalibError: The cell has several cameras or boards, or a body of tags.
    """
    stated = _only(cell.cameras, "cameras") or usual_camera()
    board = _only(cell.boards, "boards") or usual_board(robot)
    if board.pattern == BODY:
        raise CalibError(
            f"The board '{board.name}' is a body of tags, whose far tags a camera does not see; pictures are simulated "
            "of flat boards. Give one of its size."
        )
    camera = draw_camera(stated, stream(seed, "camera"))
    return Equipment(stated, camera, draw_print(board, stream(seed, "board")))


def _only(described: Mapping[str, Described], what: str) -> Described | None:
    """Return the one camera or board of those described, by name; None if there is none, `CalibError` for several."""
    if len(described) > 1:
        raise CalibError(
            f"The cell has the {what} {choices(described)}; pictures are simulated with one of each."
        )
    return next(iter(described.values()), None)


def usual_camera() -> Camera:
    """Return the usual camera, with its maker's numbers."""
    return Camera(width=1280, height=720, values=_USUAL)


def usual_board(arm: Robot) -> Board:
    """Return the usual ChArUco board of 7 by 5 squares, in proportion to the reach of the arm, within limits.

    Args:
        arm: The chain from the foot to the flange, or the other way.
    """
    # Whole millimetres.
    square = round(float(np.clip(_SQUARE * reach(arm), *_SQUARES)), 3)
    return Board(
        pattern=CHARUCO,
        columns=7,
        rows=5,
        square=square,
        marker=0.75 * square,
        dictionary="DICT_5X5_100",
    )


def draw_camera(stated: Camera, rng: np.random.Generator) -> Camera:
    """Draw the true camera.

    Args:
        stated: The camera as stated: its true numbers are drawn by their standard deviations; without numbers, usual
            ones are drawn.
        rng: Random numbers.

    Returns:
        The same camera with its true numbers, whose standard deviations are 0. A lens that folds the image, which no
        real lens does, is drawn again, a limited number of times.
    """
    for _ in range(_DRAWS):
        unit_normal = rng.standard_normal(len(LENSES[stated.lens].names))
        if stated.values is None:
            focal_length = float(rng.uniform(*_FOCAL)) * stated.width
            values = np.zeros(len(unit_normal))
            values[:2] = focal_length
            values[2:4] = (np.array([stated.width, stated.height]) - 1) / 2.0
            sigma = _usual_sigma(stated, values)
            sigma[:2] = [0.0, 1e-3 * focal_length]
            sigma[4] = _RADIAL
            values = values + sigma * unit_normal
        else:
            usual = _usual_sigma(stated, stated.values)
            sigma = usual if stated.sigma is None else stated.sigma
            # A number that is not known is drawn as if a maker had stated it.
            known = np.where(np.isfinite(sigma), sigma, usual)
            values = stated.values + known * unit_normal
        exact = np.zeros(len(values))
        camera = replace(stated, values=read_only(values), sigma=read_only(exact))
        if not folds(camera):
            break
    return camera


def folds(camera: Camera) -> bool:
    """Return whether the distortion folds inside the image: points farther off axis are imaged closer to the centre.

    Args:
        camera: A camera with numbers of its lens.
    """
    assert camera.values is not None
    slopes = np.tan(np.linspace(0.0, _WIDEST, _ANGLES))
    points = np.column_stack([slopes, np.zeros(_ANGLES), np.ones(_ANGLES)])
    radii = LENSES[camera.lens].project(points, camera.values)[:, 0] - camera.values[2]
    outside = radii >= 0.5 * np.hypot(camera.width, camera.height)
    seen = radii[: int(np.argmax(outside)) + 1] if np.any(outside) else radii
    return bool(np.any(np.diff(seen) <= 0.0))


def _usual_sigma(camera: Camera, values: Array) -> Array:
    """Return the standard deviations that a maker's numbers of a lens usually have, (k,), in the units of the numbers.

    For a fisheye lens those of higher powers are smaller. Otherwise they would bend the edge of the image, 1 rad and
    more from the axis, more than real lenses do.
    """
    sigma = LENSES[camera.lens].default_sigma(values, camera.width)
    if camera.lens == "fisheye":
        sigma[4:] *= _HIGHER ** np.arange(len(sigma) - 4)
    return sigma
