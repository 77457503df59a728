"""The table of corners: a row each, with the joint values of its picture as the table of joints has them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from calib.camera.board import Board
from calib.errors import MeasurementError
from calib.files import csv_bytes
from calib.tables.table import Column
from calib.vision.detection.board_search import BoardView
from calib.vision.detection.detect import Detection
from calib.vision.detection.image_files import ImageFile
from calib.vision.detection.matching import IMAGE, TARGET, JointTable, Matches
from calib.vision.detection.picture import NO_ROW

#: The kind of measurement of a corner.
KIND = "pixel"

#: Columns behind the joints', the picture's, the camera's and the board's.
_CORNER_HEADS = (
    "corner",
    "board_x [m]",
    "board_y [m]",
    "board_z [m]",
    "u [px]",
    "v [px]",
    "sigma_image [px]",
    "kind",
)


def with_cameras(files: Sequence[ImageFile], matches: Matches) -> tuple[ImageFile, ...]:
    """Return pictures with the cameras that their rows name."""
    pairs = zip(files, matches.cameras, strict=True)
    return tuple(replace(file, camera=camera) for file, camera in pairs)


def with_rows_only(detection: Detection, matches: Matches) -> Detection:
    """Return what was detected, with the pictures that have no row of joint values not used."""
    pictures = []
    for picture, row in zip(detection.pictures, matches.rows, strict=True):
        is_left_out = row is None and not picture.reason
        pictures.append(replace(picture, reason=NO_ROW) if is_left_out else picture)
    return replace(detection, pictures=tuple(pictures))


def corner_table(detection: Detection, joints: JointTable, matches: Matches) -> bytes:
    """Return the table of all corners that are used, as CSV.

    Args:
        detection: What was detected.
        joints: The table of joint values.
        matches: The row of each picture.

    Returns:
        The table. The column ``group`` is there if a camera is named, ``target`` if there are several boards or the
        table of joints has one: ``board/place`` where both are so.

    Raises:
        MeasurementError: Some pictures have a camera, others none.
    """
    has_camera = _names_cameras(detection, matches)
    has_target = len(detection.boards) > 1 or joints.target is not None
    heads: list[object] = [_head(name, column) for name, column in _kept(joints)]
    heads.append(IMAGE)
    heads += ["group"] if has_camera else []
    heads += [TARGET] if has_target else []
    rows = [[*heads, *_CORNER_HEADS]]
    boards = {board.name: board for board in detection.boards}
    for picture, row in zip(detection.pictures, matches.rows, strict=True):
        if row is None:
            continue
        of_row = [joints.cell(row, column) for _, column in _kept(joints)]
        for view in picture.used:
            cells: list[object] = [*of_row, picture.file.name]
            cells += [picture.file.camera] if has_camera else []
            cells += [_target(detection, joints, row, view)] if has_target else []
            rows += [[*cells, *corner] for corner in _corners(boards[view.board], view)]
    return csv_bytes(rows)


def _kept(joints: JointTable) -> list[tuple[str, Column]]:
    """Return the columns of the table of joints that are kept, by the names that they are read by."""
    kept = {column.index for column in joints.kept}
    return [(name, column) for name, column in joints.columns.items() if column.index in kept]


def _head(name: str, column: Column) -> str:
    """Return the header of a column: its name, perhaps as renamed, and its unit."""
    return name if column.symbol is None else f"{name} [{column.symbol}]"


def _names_cameras(detection: Detection, matches: Matches) -> bool:
    """Test whether the cameras are named; refuse pictures of which some have one and others none."""
    pairs = zip(detection.pictures, matches.rows, strict=True)
    used = [picture for picture, row in pairs if row is not None and picture.used]
    without = [picture for picture in used if not picture.file.camera]
    if without and len(without) < len(used):
        raise MeasurementError(
            f"The camera of the picture '{without[0].file.name}' is not named, of others it is. Name its folder: "
            "--camera-name \"NAME=FOLDER\", or fill the column 'group' of the table of joints."
        )
    return bool(used) and not without


def _target(detection: Detection, joints: JointTable, row: int, view: BoardView) -> str:
    """Return the name of the target of corners: the board, where it was, or both."""
    parts = [view.board] if len(detection.boards) > 1 else []
    place = joints.cell(row, joints.target)
    parts += [place] if place else []
    return "/".join(parts) or view.board


def _corners(board: Board, view: BoardView) -> Iterator[list[object]]:
    """Yield the cells of each corner that a picture shows of a board."""
    positions = board.corners
    for corner, pixel, sigma in zip(view.ids, view.pixels, view.sigma, strict=True):
        place = [round(float(length), 9) for length in positions[corner]]
        measured = [round(float(value), 4) for value in pixel]
        yield [int(corner), *place, *measured, round(float(sigma), 4), KIND]
