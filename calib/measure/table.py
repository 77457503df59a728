"""A table as text: its separator, its header, its rows of cells."""

from __future__ import annotations

import codecs
import csv
import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from calib.errors import FileError, MeasurementError
from calib.model.files import read_bytes
from calib.units import split_header

SEPARATORS = (",", ";", "\t")

#: Rows that are read together.
_TOGETHER = 5_000

_EXAMPLE = "such as: set,joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]"


class Row(NamedTuple):
    """One data row: its line in the file, its number among the data rows (from 1), its cells."""

    line: int
    ordinal: int
    cells: list[str]


class Block(NamedTuple):
    """Data rows that follow one another: the lines where they end, the first one's number, their cells as written."""

    lines: list[int]
    first: int
    cells: list[list[str]]

    def row(self, i: int) -> Row:
        """One of its rows, from 0, cells stripped."""
        return Row(self.lines[i], self.first + i, [cell.strip() for cell in self.cells[i]])


@dataclass(frozen=True, slots=True)
class Table:
    """A text table: comma, semicolon or tab separated, one header line, blank and # lines skipped.

    Attributes:
        source: the file's name, for messages.
        sha256: of the file's bytes.
        text: the whole file.
        separator: one of `SEPARATORS`.
        header: the header's cells.
    """

    source: str
    sha256: str
    text: str
    separator: str
    header: tuple[str, ...]

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a file and find its separator and its header.

        Raises:
            MeasurementError: there is no such file, it is too large, no text, or has no header.
        """
        source = Path(path).name or str(path)
        try:
            data = read_bytes(path, "The table")
        except FileError as error:
            raise MeasurementError(str(error)) from error
        text = _decode(data, source)
        line = next((content for _, content in _kept(text)), None)
        if line is None:
            raise MeasurementError(
                f"{path}: the file is empty. A table begins with a header line, {_EXAMPLE}"
            )
        separator = _separator(line)
        try:
            header = tuple(cell.strip() for cell in _cells(line, separator, strict=True))
        except csv.Error as error:
            raise MeasurementError(
                f'{source}: not a CSV table ({error}). Check the double quotes (") in its header.'
            ) from error
        if all(_is_number(cell) for cell in header):
            raise MeasurementError(
                f"{source}: the first line holds numbers where the header should stand (a line "
                f"that begins with # is a comment). A table begins with a header line, {_EXAMPLE}"
            )
        return cls(source, hashlib.sha256(data).hexdigest(), text, separator, header)

    def names(self, columns: Mapping[str, str]) -> set[str]:
        """The names of the columns without their units, and those that ``--columns`` gives them."""
        return {split_header(label)[0] for label in (*self.header, *columns.values())}

    def rows(self) -> Iterator[Row]:
        """The data rows, in order, cells stripped.

        Raises:
            MeasurementError: a quote is not closed, or a cell is too long.
        """
        for block in self.blocks():
            for i in range(len(block.lines)):
                yield block.row(i)

    def blocks(self) -> Iterator[Block]:
        """The data rows, in order, some thousand at a time.

        Raises:
            MeasurementError: a quote is not closed, or a cell is too long.
        """
        kept = list(_kept(self.text))
        numbers = [number for number, _ in kept]
        reader = csv.reader(
            [line for _, line in kept],
            delimiter=self.separator,
            skipinitialspace=True,
            strict=True,
        )
        # A cell in quotes may run over several lines: a row stands where its last one is.
        numbered = ((numbers[reader.line_num - 1], cells) for cells in reader)
        try:
            next(reader)  # the header
            first = 1
            while some := list(islice(numbered, _TOGETHER)):
                yield Block([at for at, _ in some], first, [cells for _, cells in some])
                first += len(some)
        except csv.Error as error:
            raise MeasurementError(
                f"{self.source}, line {numbers[reader.line_num - 1]}: not a CSV table ({error}). Check the double "
                'quotes (") there and above.'
            ) from error


def distinct(cells: Sequence[str]) -> list[str]:
    """Cells without the blanks around them, those that are the same as the same object: columns of words are long."""
    stripped = {cell: cell.strip() for cell in set(cells)}
    return [stripped[cell] for cell in cells]


def _decode(data: bytes, source: str) -> str:
    r"""Text of UTF-8 bytes, with or without a byte order mark, or of UTF-16 with one; lines end in ``\n``."""
    try:
        if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            text = data.decode("utf-16")  # what Excel calls "Unicode text"
        else:
            text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise MeasurementError(
            f"{source}, line {line}: this is not UTF-8 text. Save the table as CSV (UTF-8)."
        ) from error
    if "\0" in text:
        raise MeasurementError(f"{source}: this is not a text file. Save the table as CSV (UTF-8).")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _kept(text: str) -> Iterator[tuple[int, str]]:
    """The lines that are neither blank (separators aside) nor a comment, and their numbers."""
    return (
        (at, line)
        for at, line in enumerate(io.StringIO(text), 1)
        if line.strip(" \t,;\n") and not line.lstrip().startswith(("#", '"#'))
    )


def _cells(line: str, separator: str, *, strict: bool) -> list[str]:
    """The cells of one line; ``strict`` refuses quotes that do not close."""
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=strict))


def _separator(header: str) -> str:
    """The sign that splits a header line into the most cells with a unit, then the most cells."""

    def score(sign: str) -> tuple[int, int]:
        """How well a sign splits the header; most of them do it wrongly, hence not strict."""
        try:
            cells = _cells(header, sign, strict=False)
        except csv.Error:  # a cell longer than is read
            return 0, 0
        return sum(cell.rstrip().endswith("]") for cell in cells), len(cells)

    return max(SEPARATORS, key=score)  # in a tie, the first: the comma


def _is_number(cell: str) -> bool:
    """Whether a cell is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
