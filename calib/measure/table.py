"""A table as text: its separator, its header, its rows of cells."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from calib.errors import FileError, MeasurementError
from calib.model.files import read_bytes

MAX_BYTES = 500_000_000
SEPARATORS = (",", ";", "\t")


class Row(NamedTuple):
    """One data row: its line in the file, its number among the data rows (from 1), its cells."""

    line: int
    ordinal: int
    cells: list[str]


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
            data = read_bytes(path, "The table", MAX_BYTES)
        except FileError as error:
            raise MeasurementError(str(error)) from error
        text = _decode(data, source)
        line = next((line for _, line in _lines(text)), None)
        if line is None:
            message = f"{path}: the file is empty. A table begins with a header line, {_EXAMPLE}"
            raise MeasurementError(message)
        separator = _separator(line, source)
        header = tuple(next(_cells(iter([line]), separator, source)))
        if all(_is_number(cell) for cell in header):
            message = (
                f"{source}: the first line holds numbers where the header should stand (a line "
                f"that begins with # is a comment). A table begins with a header line, {_EXAMPLE}"
            )
            raise MeasurementError(message)
        return cls(source, hashlib.sha256(data).hexdigest(), text, separator, header)

    def rows(self) -> Iterator[Row]:
        """The data rows, in order, cells stripped.

        Raises:
            MeasurementError: a quote is not closed.
        """
        line = 0

        def kept() -> Iterator[str]:
            """The lines that count, leaving the number of the last one in ``line``."""
            nonlocal line
            for number, content in _lines(self.text):
                line = number
                yield content

        for ordinal, cells in enumerate(_cells(kept(), self.separator, self.source)):
            if ordinal:  # 0 is the header
                yield Row(line, ordinal, cells)


_EXAMPLE = "such as: set,joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]"


def _decode(data: bytes, source: str) -> str:
    """Text from UTF-8 bytes, with or without a byte order mark."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"{source}, line {line}: this is not UTF-8 text. Save the table as CSV (UTF-8)."
        raise MeasurementError(message) from error
    if "\0" in text:
        message = f"{source}: this is not a text file. Save the table as CSV (UTF-8)."
        raise MeasurementError(message)
    return text


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """The lines that are neither blank (separators aside) nor a comment, and their numbers."""
    for number, line in enumerate(io.StringIO(text, newline=None), 1):
        if line.strip(" \t\n,;") and not line.lstrip().startswith(("#", '"#')):
            yield number, line


def _cells(
    lines: Iterator[str], separator: str, source: str, *, strict: bool = True
) -> Iterator[list[str]]:
    """The stripped cells of each line; ``strict`` refuses quotes that do not close."""
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=strict)
    try:
        for cells in reader:
            yield [cell.strip() for cell in cells]
    except csv.Error as error:
        message = f'{source}: not a CSV table ({error}). Check the double quotes (") in it.'
        raise MeasurementError(message) from error


def _separator(header: str, source: str) -> str:
    """The sign that splits a header line into the most cells with a unit, then the most cells."""

    def score(sign: str) -> tuple[int, int]:
        """How well a sign splits the header; most of them do it wrongly, hence not strict."""
        cells = next(_cells(iter([header]), sign, source, strict=False))
        return sum(cell.endswith("]") for cell in cells), len(cells)

    return max(SEPARATORS, key=score)  # in a tie, the first: the comma


def _is_number(cell: str) -> bool:
    """Whether a cell is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
