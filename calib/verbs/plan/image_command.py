"""Options of ``calib plan`` for images of a board and for touching one, and how they are read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.errors import CalibError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calib.basics.arrays import Array, Integers
    from calib.boards.board import Board
    from calib.data.cell import Cell
    from calib.verbs.plan.images.plan import ImageRequest
    from calib.verbs.plan.touch import Pointer

#: Columns of the option's text in the help.
_POSE = '"X Y Z UNIT RX RY RZ UNIT"'


@dataclass(frozen=True, slots=True)
class TouchOptions:
    """Corners of a calibrated board to touch with a pointer, to check a calibration."""

    touch: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT",
            help="Result of a calibration to check: in place of a plan, write the joint values that bring a pointer to "
            "corners of the board, and the error to expect.",
        ),
    ] = None
    pointer: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT [RX RY RZ UNIT]"',
            help="Pose of the pointer's tip in its link, for --touch; the pointer points along z.",
        ),
    ] = None
    pointer_on: Annotated[
        str | None,
        typer.Option(
            metavar="LINK", help="Link that the pointer is mounted on. Default: that of the camera."
        ),
    ] = None
    corners: Annotated[
        str | None,
        typer.Option(
            metavar='"ID ..."',
            help="Ids of the corners to touch. Default: four outer ones and one in the middle.",
        ),
    ] = None

    def tool(self) -> Pointer:
        """Return the pointer; raises `CalibError` where it is missing."""
        from calib.verbs.plan.touch import Pointer

        if self.pointer is None:
            raise CalibError(
                '--touch needs the pointer: --pointer "0 0 120 mm" for a tip 120 mm in front of the flange.'
            )
        return Pointer(pose_of(self.pointer, "--pointer"), self.pointer_on or "")

    def ids(self) -> Integers | None:
        """Return the ids of the corners, shape (k,); None: the usual ones; raises `CalibError`."""
        import numpy as np

        if self.corners is None:
            return None
        words = self.corners.replace(",", " ").split()
        if not words or not all(word.isdigit() for word in words):
            raise CalibError(
                f'--corners "{self.corners}": it must be ids of corners, such as "0 7 32 39".'
            )
        return np.array([int(word) for word in words])


@dataclass(frozen=True, slots=True)
class ImageOptions(TouchOptions):
    """Images of a printed board, where camera and board roughly are, and corners to touch."""

    camera_at: Annotated[
        str | None,
        typer.Option(
            metavar=_POSE,
            help="Approximate pose of the camera in its link, with a rotation vector; z is the line of sight, "
            "and y points "
            "down in the image. Default: the link is the camera's optical frame.",
        ),
    ] = None
    board_at: Annotated[
        str | None,
        typer.Option(
            metavar=_POSE,
            help="Approximate pose of the board in its link, with a rotation vector; x points along its columns, z "
            "into the page.",
        ),
    ] = None
    distance: Annotated[
        str | None,
        typer.Option(
            metavar='"NEAREST FARTHEST UNIT"',
            help="Distances between which the camera is in focus. Default: those at which the board fills 15 to "
            "80 % of "
            "the image.",
        ),
    ] = None
    tilt: Annotated[
        str,
        typer.Option(
            metavar="ANGLE", help="Largest angle between the board's normal and the line of sight."
        ),
    ] = "55 deg"
    share: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Share of the board's corners that each image must show, from 0 to 1.",
        ),
    ] = 1.0

    def request(self) -> ImageRequest:
        """Return what is wanted of the images.

        Raises:
            CalibError: The board's place is missing, or a text that its option does not take.
        """
        from calib.basics.units import ANGLE, parse_amount
        from calib.verbs.plan.images.plan import ImageRequest

        if self.board_at is None:
            raise CalibError(
                "To plan images it must be known roughly where the board is in its link: --board-at, such as "
                '"500 0 0 mm 180 0 0 deg" for one that lies face up in front of the robot.'
            )
        tilt = parse_amount(self.tilt, "--tilt", ANGLE, "55 deg")
        return ImageRequest(
            T_link_camera=pose_of(self.camera_at or "0 0 0 mm", "--camera-at"),
            T_link_board=pose_of(self.board_at, "--board-at"),
            distances=self._distances(),
            tilt=tilt,
            share=self.share,
        )

    def _distances(self) -> tuple[float, float] | None:
        """Return nearest and farthest distance [m]; None: the usual ones; raises `CalibError`."""
        from calib.basics.units import LENGTH, parse_quantities

        if self.distance is None:
            return None
        example = "300 900 mm"
        near, far = parse_quantities(self.distance, "--distance", {LENGTH: 2}, example)[LENGTH]
        return float(near), float(far)


def pose_of(text: str, option: str) -> Array:
    """Parse a pose, a position with or without a rotation vector.

    Args:
        text: As typed, such as ``0 0 100 mm 0 0 90 deg``.
        option: The option that it was given with, for messages.

    Returns:
        Shape (4, 4), [m].

    Raises:
        CalibError: It is no such text.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from calib.basics.units import ANGLE, LENGTH, parse_quantities

    example = "0 0 100 mm 0 0 90 deg"
    values = parse_quantities(text, option, {LENGTH: 3, ANGLE: 3}, example)
    T = np.eye(4)
    T[:3, 3] = values.get(LENGTH, [0.0, 0.0, 0.0])
    T[:3, :3] = Rotation.from_rotvec(values.get(ANGLE, [0.0, 0.0, 0.0])).as_matrix()
    return T


def board_of(cell: Cell, calibrated: Mapping[str, Board]) -> Board:
    """Return the board whose corners are touched.

    Args:
        cell: Boards that were given.
        calibrated: Boards of the result, as it was given them; they count where none was given.

    Raises:
        CalibError: There is none, or there are several.
    """
    boards = cell.boards or calibrated
    if len(boards) != 1:
        raise CalibError("--touch needs the board whose corners are touched: --board board.toml.")
    return next(iter(boards.values()))
