"""The table of corners: a row for each, with the joint values of its picture as the table of joints has them.

Rows are in the order of the table of joints, which is that in which the robot went to the poses. A pose without corners
has one row, in which nothing is measured: the next one is approached from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calib.basics.files import csv_bytes
from calib.boards.detection.board_search import BoardView
from calib.boards.detection.detect import Detection
from calib.boards.detection.picture import NO_ROW, ImageFile, Picture
from calib.errors import MeasurementError
from calib.verbs.detect.matching import IMAGE, TARGET, JointTable, Matches

#: The kind of measurement of a corner.
KIND = "pixel"

#: Columns of the corner, after those of the joints, the picture, the camera and the board.
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
    """Return a detection whose pictures without a row of joint values are not used, for the reason `NO_ROW`."""
    pictures = []
    for picture, row in zip(detection.pictures, matches.rows, strict=True):
        is_left_out = row is None and not picture.reason
        pictures.append(replace(picture, reason=NO_ROW) if is_left_out else picture)
    return replace(detection, pictures=tuple(pictures))


def corner_table(detection: Detection, joints: JointTable, matches: Matches) -> bytes:
    """Return the table of all corners that are used, and of the poses without any, as CSV.

    Args:
        detection: The corners and the pictures that they are in.
        joints: The table of joint values.
        matches: The row of each picture.

    Returns:
        The table. It has the column ``group`` if cameras are named, and ``target`` if there are several boards or the
        table of joints has one: ``board/place`` in both cases together.

    Raises:
        MeasurementError: Some pictures have a camera, others do not.
    """
    used = []
    of_row: dict[int, list[Picture]] = {}
    for picture, row in zip(detection.pictures, matches.rows, strict=True):
        if row is not None and picture.used:
            used.append(picture)
            of_row.setdefault(row, []).append(picture)
    without = [picture for picture in used if not picture.file.camera]
    if without and len(without) < len(used):
        raise MeasurementError(
            f"The camera of the picture '{without[0].file.name}' is not named, but those of others are. Name that of "
            'its folder or its name, --camera-name "NAME=FOLDER" or "NAME=cam1_*", or fill the column \'group\' of the '
            "table of joints."
        )
    has_camera = bool(used) and not without
    boards = {board.name: board for board in detection.boards}
    has_target = len(boards) > 1 or joints.target is not None

    kept = {column.index for column in joints.kept}
    columns = [(name, column) for name, column in joints.columns.items() if column.index in kept]
    # A column has its name, perhaps as renamed, and its unit.
    heads: list[object] = [
        name if column.symbol is None else f"{name} [{column.symbol}]" for name, column in columns
    ]
    heads.append(IMAGE)
    heads += ["group"] if has_camera else []
    heads += [TARGET] if has_target else []
    rows = [[*heads, *_CORNER_HEADS]]
    for row in range(len(joints.table.cells)):
        of_pose: list[object] = [joints.cell(row, column) for _, column in columns]
        if row not in of_row:
            nothing = [""] * (len(rows[0]) - len(of_pose) - 2)
            rows.append([*of_pose, joints.cell(row, joints.image), *nothing, KIND])
        for picture in of_row.get(row, ()):
            for view in picture.used:
                cells = [*of_pose, picture.file.name]
                cells += [picture.file.camera] if has_camera else []
                cells += [_target(joints, row, view, several=len(boards) > 1)] if has_target else []
                positions = boards[view.board].corners
                for corner, pixel, sigma in zip(view.ids, view.pixels, view.sigma, strict=True):
                    place = [round(float(length), 9) for length in positions[corner]]
                    found = [round(float(value), 4) for value in (*pixel, sigma)]
                    rows.append([*cells, int(corner), *place, *found, KIND])
    return csv_bytes(rows)


def _target(joints: JointTable, row: int, view: BoardView, *, several: bool) -> str:
    """Return the target of a view's corners: the board's place in the row of the table of joints, else its name.

    With several boards, it is ``board/place``.
    """
    place = joints.cell(row, joints.target)
    if not place:
        return view.board
    return f"{view.board}/{place}" if several else place
