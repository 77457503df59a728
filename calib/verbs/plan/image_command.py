"""Options of ``calib plan`` for images of a board, and how they are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.basics.arrays import Array
    from calib.verbs.plan.images.plan import ImageRequest

#: Columns of the option's text in the help.
_POSE = '"X Y Z UNIT RX RY RZ UNIT"'


@dataclass(frozen=True, slots=True)
class ImageOptions:
    """Images of a printed board, and where camera and board roughly are."""

    camera_at: Annotated[
        str | None,
        typer.Option(
            metavar=_POSE,
            help="Rough pose of the camera in its link, rotation vector; z is the line of sight, y "
            "down in the image. Default: the link is the camera's optical frame.",
        ),
    ] = None
    board_at: Annotated[
        str | None,
        typer.Option(
            metavar=_POSE,
            help="Rough pose of the board in its link, rotation vector; x along its columns, z into the page.",
        ),
    ] = None
    distance: Annotated[
        str | None,
        typer.Option(
            metavar='"NEAREST FARTHEST UNIT"',
            help="Distances at which the camera is sharp. Default: the board fills 15 to 80 % of the image.",
        ),
    ] = None
    tilt: Annotated[
        str, typer.Option(metavar="ANGLE", help="Largest tilt of the board to the line of sight.")
    ] = "55 deg"
    share: Annotated[
        float,
        typer.Option(metavar="SHARE", help="Share of the board's corners that an image must show."),
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
