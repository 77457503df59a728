"""Which row of the table of joint values belongs to which picture: by the picture's name or number, never by order."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from calib.basics.tables import Column, Table
from calib.basics.values import Value
from calib.boards.detection.image_files import ENDINGS, ImageFile
from calib.data.columns import list_columns, name_columns
from calib.errors import MeasurementError, choices, did_you_mean

#: The column with the name of a row's picture.
IMAGE = "image"

#: Columns with the camera's name, of which a table has one at most.
CAMERA = ("group", "camera")

#: The column with the name of the board, or of the place where it was.
TARGET = "target"

#: Columns that detection writes.
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
    """A table of joint values, a row a picture or a row for the pictures that several cameras took at once."""

    table: Table
    #: The columns by the names that they are read by, in order.
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
        """The columns that go into the table of corners as they are."""
        moved = [column for column in (self.camera, self.target) if column is not None]
        places = {column.index for column in moved}
        return tuple(
            column
            for name, column in self.columns.items()
            if column.index not in places and name.casefold() != IMAGE
        )

    def without(self, name: str) -> JointTable:
        """Return the table without a column, by its name in small letters; itself where it has none of that name."""
        kept = {key: column for key, column in self.columns.items() if key.casefold() != name}
        return replace(self, columns=kept)

    def cell(self, row: int, column: Column | None) -> str:
        """Return a cell.

        Args:
            row: Its row, from 0.
            column: Its column; None: the table has no such column, and its cells are empty.
        """
        return "" if column is None else self.table.cells[row][column.index]


@dataclass(frozen=True, slots=True)
class Matches(Value):
    """Rows and pictures that belong together."""

    #: The row of each picture, from 0; None where there is none.
    rows: tuple[int | None, ...]
    #: The camera of each picture; "" where it is not said.
    cameras: tuple[str, ...]
    #: Rows without a picture, from 0.
    unmatched: tuple[int, ...]


def read_joint_table(
    path: str | Path, names: Mapping[str, str] | None = None, index: str | None = None
) -> JointTable:
    """Read a table of joint values.

    Args:
        path: The table.
        names: Names of columns by those in the table, as of ``--columns``; None: as they are.
        index: Name of the column with the numbers of pictures; None: the column ``image`` has their names.

    Returns:
        The table; its numbers are not read.

    Raises:
        MeasurementError: The table cannot be read, or lacks the column that says which picture a row belongs to.
    """
    table = Table.read(path)
    columns, _ = name_columns(table, (), names or {})
    taken = [name for name in WRITTEN if name in columns]
    if taken:
        raise MeasurementError(
            f"{table.source}: the column {choices(taken)} is written by the detection of corners; rename it, or leave "
            f'it out: --columns "{columns[taken[0]].label}=-".'
        )
    if index is not None:
        return JointTable(table, columns, None, _index_column(table, columns, index))
    by_folded = {name.casefold(): column for name, column in columns.items()}
    if IMAGE not in by_folded:
        raise MeasurementError(
            f"{table.source}: there is no column '{IMAGE}' with the name of each row's picture. Map yours to it, "
            f'--columns "NAME={IMAGE}", or name the column with the numbers of the pictures, --index NAME. '
            f"{list_columns(table)}"
        )
    return JointTable(table, columns, by_folded[IMAGE], None)


def match(joints: JointTable, images: Sequence[ImageFile]) -> Matches:
    """Match pictures with rows.

    A row's name fits a picture with the same name, in any case, with or without ending and folders; a row's number one
    whose name has it as its last number.

    Args:
        joints: The table.
        images: The pictures.

    Returns:
        The row of each picture.

    Raises:
        MeasurementError: Two rows fit a picture, or a row fits two pictures of one camera, or none fits any.
    """
    by_key = defaultdict(list)
    for row in range(len(joints.table.cells)):
        by_key[_row_key(joints, row)].append(row)
    rows: list[int | None] = []
    cameras = []
    for image in images:
        fitting = _fitting(joints, image, by_key)
        if len(fitting) > 1:
            _fail_on_rows(joints, image, fitting)
        named_in_row = joints.cell(fitting[0], joints.camera) if fitting else ""
        rows.append(fitting[0] if fitting else None)
        cameras.append(image.camera or named_in_row)
    if all(row is None for row in rows):
        _fail_on_none(joints, images)
    _check_used_once(joints, images, rows, cameras)
    unmatched = set(range(len(joints.table.cells))) - set(rows)
    return Matches(tuple(rows), tuple(cameras), tuple(sorted(unmatched)))


def _index_column(table: Table, columns: Mapping[str, Column], index: str) -> Column:
    """Return the column with the numbers of pictures; refuse one that holds other things."""
    column = columns.get(index)
    if column is None:
        raise MeasurementError(
            f"{table.source}: there is no column '{index}', which --index names{did_you_mean(index, columns)}. "
            f"{list_columns(table)}"
        )
    for row, cell in enumerate(table.column(column)):
        if not cell.isdecimal():
            table.fail(row, column, f"'{cell}' is not the number of a picture, such as 7 or 0007.")
    return column


def _row_key(joints: JointTable, row: int) -> str:
    """Return what a row is matched by: its picture's number, or the end of its name without ending, in lower case."""
    if joints.index is not None:
        return str(int(joints.cell(row, joints.index)))
    return _stem(joints.cell(row, joints.image))


def _image_key(joints: JointTable, image: ImageFile) -> str:
    """Return what a picture is matched by; "" without a number."""
    if joints.index is None:
        return _stem(image.path.name)
    numbers = _NUMBER.findall(image.path.stem)
    return str(int(numbers[-1])) if numbers else ""


def _stem(name: str) -> str:
    """Return a file's name without folders and without the ending of a picture, in lower case."""
    last = PurePosixPath(name.replace("\\", "/")).name.casefold()
    ending = next((ending for ending in ENDINGS if last.endswith(ending)), "")
    return last.removesuffix(ending)


def _fitting(
    joints: JointTable, image: ImageFile, by_key: Mapping[str, Sequence[int]]
) -> list[int]:
    """Return the rows that a picture may belong to: of several with its name those with its folder, ending, camera."""
    key = _image_key(joints, image)
    fitting = list(by_key[key]) if key in by_key else []
    if image.camera and joints.camera is not None:
        fitting = [row for row in fitting if joints.cell(row, joints.camera) == image.camera]
    if joints.image is None:
        return fitting
    fitting = [row for row in fitting if _folders_fit(joints.cell(row, joints.image), image)]
    exact = [row for row in fitting if _ending_fits(joints.cell(row, joints.image), image)]
    return exact or fitting


def _folders_fit(cell: str, image: ImageFile) -> bool:
    """Test whether the folder that a row writes before the name, if any, is the one that the picture is in."""
    folder = PurePosixPath(cell.replace("\\", "/")).parent.name
    return not folder or folder.casefold() == image.path.absolute().parent.name.casefold()


def _ending_fits(cell: str, image: ImageFile) -> bool:
    """Test whether a row's name has the ending of the picture."""
    return cell.casefold().endswith(image.path.suffix.casefold())


def _lines(joints: JointTable, rows: Sequence[int]) -> str:
    """Return the lines of rows as text for a message."""
    return " and ".join(str(joints.table.lines[row]) for row in rows[:5])


def _fail_on_rows(joints: JointTable, image: ImageFile, rows: Sequence[int]) -> None:
    """Refuse two rows for one picture."""
    raise MeasurementError(
        f"{joints.table.source}: lines {_lines(joints, rows)} both belong to the picture '{image.name}'. Write the "
        "folder before the name, or the camera into a column 'group'; or remove one."
    )


def _fail_on_none(joints: JointTable, images: Sequence[ImageFile]) -> None:
    """Refuse a table that belongs to other pictures."""
    column = joints.image or joints.index
    cells = [joints.cell(row, column) for row in range(len(joints.table.cells))]
    raise MeasurementError(
        f"{joints.table.source}: no row belongs to any of the pictures. The table names {choices(cells, limit=3)}; the "
        f"pictures are {choices([image.name for image in images], limit=3)}."
    )


def _check_used_once(
    joints: JointTable,
    images: Sequence[ImageFile],
    rows: Sequence[int | None],
    cameras: Sequence[str],
) -> None:
    """Refuse a row for two pictures of one camera."""
    first: dict[tuple[int, str], ImageFile] = {}
    for image, row, camera in zip(images, rows, cameras, strict=True):
        if row is None:
            continue
        other = first.setdefault((row, camera), image)
        if other is not image:
            raise MeasurementError(
                f"{joints.table.source}, line {joints.table.lines[row]}: the row belongs to two pictures, "
                f"'{other.name}' and '{image.name}'. Write the folder before the name; or, if they are of two cameras, "
                'say so: --camera-name "NAME=FOLDER".'
            )
