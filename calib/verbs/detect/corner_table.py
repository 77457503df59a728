"""The table of corners: a row each, with the joint values of its picture as the table of joints has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from calib.basics.files import csv_bytes
from calib.basics.tables import Column
from calib.basics.values import ReadOnlyMapping, Value
from calib.boards.board import Board
from calib.boards.detection.board_search import BoardView
from calib.boards.detection.detect import Detection
from calib.boards.detection.image_files import ImageFile
from calib.boards.detection.picture import NO_ROW, Picture
from calib.errors import MeasurementError
from calib.verbs.detect.matching import IMAGE, TARGET, JointTable, Matches

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
    """Return pictures with the cameras that their rows name.

    Args:
        files: The pictures.
        matches: The camera of each.
    """
    pairs = zip(files, matches.cameras, strict=True)
    return tuple(replace(file, camera=camera) for file, camera in pairs)


def with_rows_only(detection: Detection, matches: Matches) -> Detection:
    """Return a detection in which the pictures without a row of joint values are not used.

    Args:
        detection: What was detected.
        matches: The row of each picture.
    """
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
    form = _Form(
        joints=joints,
        boards=ReadOnlyMapping({board.name: board for board in detection.boards}),
        has_camera=_names_cameras(detection, matches),
        has_target=len(detection.boards) > 1 or joints.target is not None,
    )
    rows = [form.heads()]
    for picture, row in zip(detection.pictures, matches.rows, strict=True):
        if row is not None:
            rows += form.rows(picture, row)
    return csv_bytes(rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Form(Value):
    """The columns of a table of corners."""

    #: The table of joint values.
    joints: JointTable
    #: The boards by name.
    boards: Mapping[str, Board]
    #: Whether there is a column ``group``.
    has_camera: bool
    #: Whether there is a column ``target``.
    has_target: bool

    def heads(self) -> list[object]:
        """Return the header's cells."""
        heads: list[object] = [_head(name, column) for name, column in _kept(self.joints)]
        heads.append(IMAGE)
        heads += ["group"] if self.has_camera else []
        heads += [TARGET] if self.has_target else []
        return [*heads, *_CORNER_HEADS]

    def rows(self, picture: Picture, row: int) -> Iterator[list[object]]:
        """Yield the cells of each corner of a picture, whose joint values are in a row, from 0."""
        joint_cells = [self.joints.cell(row, column) for _, column in _kept(self.joints)]
        for view in picture.used:
            cells: list[object] = [*joint_cells, picture.file.name]
            cells += [picture.file.camera] if self.has_camera else []
            cells += [self._target(row, view)] if self.has_target else []
            for corner in _corners(self.boards[view.board], view):
                yield [*cells, *corner]

    def _target(self, row: int, view: BoardView) -> str:
        """Return the name of the target of corners: the board, where it was, or both."""
        parts = [view.board] if len(self.boards) > 1 else []
        place = self.joints.cell(row, self.joints.target)
        parts += [place] if place else []
        return "/".join(parts) or view.board


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


def _corners(board: Board, view: BoardView) -> Iterator[list[object]]:
    """Yield the cells of each corner that a picture shows of a board."""
    positions = board.corners
    for corner, pixel, sigma in zip(view.ids, view.pixels, view.sigma, strict=True):
        place = [round(float(length), 9) for length in positions[corner]]
        measured = [round(float(value), 4) for value in pixel]
        yield [int(corner), *place, *measured, round(float(sigma), 4), KIND]
