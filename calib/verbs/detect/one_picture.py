"""One picture as it is taken: its corners, or at once why it cannot be used."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from calib.boards.board import Board
from calib.boards.detection.detect import detect
from calib.boards.detection.picture import ImageFile, Picture
from calib.errors import MeasurementError
from calib.verbs.detect.text import findings_text, reason_text


def find_corners(path: Path, boards: Sequence[Board], camera: str = "") -> Picture:
    """Find the corners of boards in a picture.

    Args:
        path: The picture.
        boards: The boards that it may show.
        camera: The camera that took it; empty: that is not stated.

    Returns:
        The picture, with corners that are used.

    Raises:
        MeasurementError: It cannot be used; the text says why.
    """
    detection = detect([ImageFile(path, path.name, camera)], boards)
    (picture,) = detection.pictures
    if not picture.used:
        reasons = [reason_text(picture, detection.fewest), *findings_text(detection)]
        why = "; ".join(reason.rstrip(".") for reason in reasons)
        raise MeasurementError(f"The picture '{path.name}' cannot be used: {why}. Take it again.")
    return picture
