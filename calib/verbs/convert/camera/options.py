"""Options of a camera's hand-over: which camera and board, and the links and joints of the URDF that stand for them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions:
    """Names that a camera's hand-over needs; all may be left out."""

    #: Name of the camera, as in the column ``group``; None: the only one.
    camera: str | None = None
    #: The link that is the camera's optical frame: z along the line of sight, x to the right in the image.
    camera_frame: str | None = None
    #: The fixed joint whose origin is changed, so that the optical frame comes out at its estimated pose; None: the
    #: only one between the link that carries the camera and the optical frame.
    move: str | None = None
    #: Name of a link to add at the optical frame, where the URDF has none.
    new_camera_frame: str | None = None
    #: Name of the board, as in the column ``target``; None: the only one.
    board: str | None = None
    #: Name of a link to add at the board.
    new_board_frame: str | None = None


#: Options that name nothing.
NOTHING_NAMED = CameraOptions()
