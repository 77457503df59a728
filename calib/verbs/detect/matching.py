"""Rows of the table of joint values and pictures, matched by the pictures' names or numbers, never by their order."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from calib.basics.tables import Column, Table
from calib.basics.values import Value
from calib.boards.detection.picture import ENDINGS, ImageFile
from calib.data.columns import list_columns, name_columns
from calib.errors import MeasurementError, choices, did_you_mean

#: The column with the name of the picture.
IMAGE = "image"

#: Columns with the name of the camera; a table has at most one of them.
CAMERA = ("group", "camera")

#: The column with the name of the board, or of the place where it stood.
TARGET = "target"

#: Columns of corners, which detection writes.
WRITTEN = (
    "corner",
    "board_x",
    "board_y",
    "board_z",
    "u",
    "v",
    "sigma_image",
    "kind",
)

#: A whole number in the name of a picture.
_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True, slots=True, eq=False)
class JointTable(Value):
    """A table of joint values: a row for each picture, or for the pictures that several cameras took at once.

    Rows that name no picture are poses that the robot drove by.
    """

    table: Table
    #: The columns in order, by the names under which they are read.
    columns: Mapping[str, Column]
    #: The column with names of pictures; None if they are matched by number.
    image: Column | None
    #: The column with numbers of pictures; None if they are matched by name.
    index: Column | None

    @property
    def camera(self) -> Column | None:
        """The column with the camera's name; None without one."""
        return next((self.columns[name] for name in CAMERA if name in self.columns), None)

    @property
    def target(self) -> Column | None:
        """The column with the name of the board's place; None without one."""
        return self.columns.get(TARGET)

    @property
    def kept(self) -> tuple[Column, ...]:
        """The columns that go into the table of corners unchanged: all except camera, target and picture's name."""
        moved = [column for column in (self.camera, self.target) if column is not None]
        places = {column.index for column in moved}
        return tuple(
            column
            for name, column in self.columns.items()
            if column.index not in places and name.casefold() != IMAGE
        )

    def without(self, name: str) -> JointTable:
        """Return the table without a column, by its name in lower case; itself if it has no such column."""
        kept = {key: column for key, column in self.columns.items() if key.casefold() != name}
        return replace(self, columns=kept)

    def cell(self, row: int, column: Column | None) -> str:
        """Return the cell of a row (from 0) and a column; empty if the table does not have the column (None)."""
        return "" if column is None else self.table.cells[row][column.index]

    def key(self, row: int) -> str:
        """Return what pictures are matched with a row by: their number, or their name without folders and ending.

        It is empty if the row names no picture.
        """
        if self.index is not None:
            number = self.cell(row, self.index)
            return str(int(number)) if number else ""
        return _stem(self.cell(row, self.image))


@dataclass(frozen=True, slots=True)
class Matches(Value):
    """Rows and pictures that belong together."""

    #: The row of each picture, from 0; None if there is none.
    rows: tuple[int | None, ...]
    #: The camera of each picture; "" if it is not stated.
    cameras: tuple[str, ...]
    #: Rows whose picture is not there, from 0.
    unmatched: tuple[int, ...]


def read_joint_table(
    path: str | Path, names: Mapping[str, str] | None = None, index: str | None = None
) -> JointTable:
    """Read a table of joint values.

    Args:
        path: The table.
        names: New names of columns by those in the table, as in ``--columns``; None: as they are.
        index: Name of the column with the numbers of pictures; None: the column ``image`` has their names.

    Returns:
        The table; its numbers are not parsed.

    Raises:
        MeasurementError: The table cannot be read, or lacks the column that says which picture a row belongs to.
    """
    table = Table.read(path)
    columns, _ = name_columns(table, (), names or {})
    taken = [name for name in WRITTEN if name in columns]
    if taken:
        raise MeasurementError(
            f"{table.source}: the column {choices(taken)} is reserved for the output of the detection; rename it, or "
            f'leave it out: --columns "{columns[taken[0]].label}=-".'
        )
    if index is not None:
        column = columns.get(index)
        if column is None:
            raise MeasurementError(
                f"{table.source}: there is no column '{index}', which --index names{did_you_mean(index, columns)}. "
                f"{list_columns(table)}"
            )
        for row, cell in enumerate(table.column(column)):
            if cell and not cell.isdecimal():
                table.fail(
                    row, column, f"'{cell}' is not the number of a picture, such as 7 or 0007."
                )
        return JointTable(table, columns, None, column)
    by_folded = {name.casefold(): column for name, column in columns.items()}
    if IMAGE not in by_folded:
        raise MeasurementError(
            f"{table.source}: there is no column '{IMAGE}' with the name of each row's picture. Map yours to it, "
            f'--columns "NAME={IMAGE}", or name the column with the numbers of the pictures, --index NAME. '
            f"{list_columns(table)}"
        )
    return JointTable(table, columns, by_folded[IMAGE], None)


def match(joints: JointTable, images: Sequence[ImageFile]) -> Matches:
    """Match pictures with rows of joint values.

    A row's name fits a picture of the same name, in upper or lower case, with or without folders and ending; a row's
    number fits a picture whose name has it as its last number.

    Args:
        joints: The table.
        images: The pictures.

    Returns:
        The row of each picture, None if there is none, and its camera; and the rows whose picture is not there.

    Raises:
        MeasurementError: Two rows fit a picture, or a row fits two pictures of one camera, or none fits any.
    """
    source = joints.table.source
    by_key = defaultdict(list)
    for number in range(len(joints.table.cells)):
        if joints.key(number):
            by_key[joints.key(number)].append(number)
    rows: list[int | None] = []
    cameras = []
    for image in images:
        fitting = _fitting_rows(joints, image, by_key)
        if len(fitting) > 1:
            lines = " and ".join(str(joints.table.lines[row]) for row in fitting[:5])
            raise MeasurementError(
                f"{source}: lines {lines} both belong to the picture '{image.name}'. Write the folder before the name, "
                "or the camera into a column 'group'; or remove one."
            )
        row = fitting[0] if fitting else None
        camera = image.camera
        if row is not None:
            camera = camera or joints.cell(row, joints.camera)
        rows.append(row)
        cameras.append(camera)

    if all(row is None for row in rows):
        column = joints.image or joints.index
        cells = [joints.cell(number, column) for number in range(len(joints.table.cells))]
        raise MeasurementError(
            f"{source}: no row belongs to any of the pictures. The table names {choices(cells, limit=3)}; the pictures "
            f"are {choices([image.name for image in images], limit=3)}."
        )
    first_of: dict[tuple[int, str], ImageFile] = {}
    for image, row, camera in zip(images, rows, cameras, strict=True):
        if row is None:
            continue
        other = first_of.setdefault((row, camera), image)
        if other is not image:
            raise MeasurementError(
                f"{source}, line {joints.table.lines[row]}: the row belongs to two pictures, '{other.name}' and "
                f"'{image.name}'. Write the folder before the name; or, if they are of two cameras, say so: "
                '--camera-name "NAME=FOLDER", or "NAME=cam1_*" by their names.'
            )
    unmatched = {row for of_key in by_key.values() for row in of_key} - set(rows)
    return Matches(tuple(rows), tuple(cameras), tuple(sorted(unmatched)))


def _fitting_rows(
    joints: JointTable, image: ImageFile, by_key: Mapping[str, Sequence[int]]
) -> list[int]:
    """Return the rows, from 0, that a picture may belong to: those with its name or number, by `JointTable.key`.

    Of these, those remain that do not name another camera or folder, and if possible those with its ending.
    """
    if joints.index is None:
        key = _stem(image.path.name)
    else:
        numbers = _NUMBER.findall(image.path.stem)
        key = str(int(numbers[-1])) if numbers else ""
    fitting = list(by_key[key]) if key in by_key else []
    if image.camera and joints.camera is not None:
        fitting = [row for row in fitting if joints.cell(row, joints.camera) == image.camera]
    if joints.image is None:
        return fitting
    names = {row: joints.cell(row, joints.image).replace("\\", "/").casefold() for row in fitting}
    folders = {row: PurePosixPath(name).parent.name for row, name in names.items()}
    own_folder = image.path.absolute().parent.name.casefold()
    fitting = [row for row in fitting if folders[row] in ("", own_folder)]
    exact = [row for row in fitting if names[row].endswith(image.path.suffix.casefold())]
    return exact or fitting


def _stem(name: str) -> str:
    """Return a file's name without folders and without the ending of a picture, in lower case."""
    last = PurePosixPath(name.replace("\\", "/")).name.casefold()
    ending = next((ending for ending in ENDINGS if last.endswith(ending)), "")
    return last.removesuffix(ending)
