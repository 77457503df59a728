"""A table as text: its separator, its header, its rows of cells."""

from __future__ import annotations

import codecs
import csv
import hashlib
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from calib.errors import FileError, MeasurementError
from calib.model.files import read_bytes

if TYPE_CHECKING:
    from _csv import Reader as _Reader

SEPARATORS = (",", ";", "\t")

#: Characters of the text that are looked at together: a few thousand rows.
_PIECE = 300_000

# Where a line begins that may be blank but for separators.
_BLANK = ("\n\n", "\n ", "\n\t", "\n,", "\n;")


class Row(NamedTuple):
    """One data row: its line in the file, its number among the data rows (from 1), its cells."""

    line: int
    ordinal: int
    cells: list[str]


@dataclass(frozen=True, slots=True)
class Block:
    """Some data rows that follow one another.

    Attributes:
        table: whose rows they are.
        lines: of the file, where each row ends.
        first: the number of the first of them among the data rows, from 1.
        text: the rows, one a line, where none has a quote; else "".
        cells: of each row, with the blanks around them, where some have quotes; else none.
    """

    table: Table
    lines: Sequence[int]
    first: int
    text: str
    cells: Sequence[list[str]]

    def rows(self) -> Iterator[Row]:
        """The rows one by one, cells stripped.

        Raises:
            MeasurementError: a cell is too long.
        """
        for ordinal, (line, cells) in enumerate(
            zip(self.lines, self._cells(), strict=True), self.first
        ):
            yield Row(line, ordinal, [cell.strip() for cell in cells])

    def columns(self) -> list[Sequence[str]] | None:
        """The cells of each column, with the blanks and line ends around them; None if rows differ in length."""
        width, sign = len(self.table.header), self.table.separator
        if not self.text:
            same = set(map(len, self.cells)) == {width}
            return list(zip(*self.cells, strict=True)) if same else None
        # All cells in a row; the end of a line goes with the cell behind it, and shows whether lines are equally long.
        flat = self.text.replace("\n", sign + "\n").split(sign)
        begins = flat[width::width]
        if len(flat) != width * len(self.lines) or not all(cell[:1] == "\n" for cell in begins):
            return None
        return [flat[i::width] for i in range(width)]

    def _cells(self) -> Iterator[list[str]]:
        """The cells of each row."""
        if not self.text:
            yield from self.cells
            return
        reader = _reader(self.text.split("\n"), self.table.separator)
        try:
            yield from reader
        except csv.Error as error:
            line = self.lines[reader.line_num - 1]
            raise MeasurementError(_no_csv(self.table.source, line, error)) from error


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
        text, sha256 = _decode(data, source), hashlib.sha256(data).hexdigest()
        del data  # the text is as large
        line = next((content for piece in _pieces(text) for _, content in _kept(*piece)), None)
        if line is None:
            message = f"{path}: the file is empty. A table begins with a header line, {_EXAMPLE}"
            raise MeasurementError(message)
        separator = _separator(line)
        header = tuple(cell.strip() for cell in _header(line, separator, source))
        if all(_is_number(cell) for cell in header):
            message = (
                f"{source}: the first line holds numbers where the header should stand (a line "
                f"that begins with # is a comment). A table begins with a header line, {_EXAMPLE}"
            )
            raise MeasurementError(message)
        return cls(source, sha256, text, separator, header)

    def rows(self) -> Iterator[Row]:
        """The data rows, in order, cells stripped.

        Raises:
            MeasurementError: a quote is not closed, or a cell is too long.
        """
        for block in self.blocks():
            yield from block.rows()

    def blocks(self) -> Iterator[Block]:
        """The data rows, in order, some thousand at a time.

        Raises:
            MeasurementError: a quote is not closed, or a cell is too long.
        """
        pieces = _pieces(self.text)
        first = 0  # the header
        for number, piece in pieces:
            lines: Sequence[int] = range(number, number + piece.count("\n") + 1)
            cells: Sequence[list[str]] = ()
            if '"' in piece:
                lines, cells = self._quoted(_kept(number, piece), pieces)
                piece = ""
            elif "#" in piece or any(sign in f"\n{piece}\n" for sign in _BLANK):
                kept = list(_kept(number, piece))
                lines, piece = [at for at, _ in kept], "\n".join(line for _, line in kept)
            if not first and lines:  # without the header
                lines, cells, first = lines[1:], cells[1:], 1
                piece = piece.partition("\n")[2]
            if lines:
                yield Block(self, lines, first, piece, cells)
                first += len(lines)

    def _quoted(
        self, kept: Iterator[tuple[int, str]], pieces: Iterator[tuple[int, str]]
    ) -> tuple[list[int], list[list[str]]]:
        """The rows of some lines; a cell in quotes may go on in the pieces that follow, which are then taken whole."""
        pending = deque(kept)
        number = 0

        def feed() -> Iterator[str]:
            """The lines, leaving the number of the last one in ``number``."""
            nonlocal number
            while True:
                while pending:
                    number, content = pending.popleft()
                    yield content + "\n"
                piece = next(pieces, None)
                if piece is None:
                    return
                pending.extend(_kept(*piece))

        lines: list[int] = []
        cells: list[list[str]] = []
        reader = _reader(feed(), self.separator)
        try:
            while pending:
                cells.append(next(reader))
                lines.append(number)
        except csv.Error as error:
            raise MeasurementError(_no_csv(self.source, number, error)) from error
        return lines, cells


_EXAMPLE = "such as: set,joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]"


def _decode(data: bytes, source: str) -> str:
    r"""Text of UTF-8 bytes, with or without a byte order mark, or of UTF-16 with one; lines end in ``\n``."""
    try:
        if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            text = data.decode("utf-16")  # what Excel calls "Unicode text"
        else:
            text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"{source}, line {line}: this is not UTF-8 text. Save the table as CSV (UTF-8)."
        raise MeasurementError(message) from error
    if "\0" in text:
        message = f"{source}: this is not a text file. Save the table as CSV (UTF-8)."
        raise MeasurementError(message)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _pieces(text: str) -> Iterator[tuple[int, str]]:
    """Pieces of some thousand whole lines, without the last one's end; and the number of their first line."""
    start, number = 0, 1
    while start < len(text):
        end = text.find("\n", start + _PIECE)
        end = len(text) if end < 0 else end
        piece = text[start : end - 1 if end == len(text) and text[end - 1] == "\n" else end]
        yield number, piece
        start, number = end + 1, number + piece.count("\n") + 1


def _kept(number: int, piece: str) -> Iterator[tuple[int, str]]:
    """The lines that are neither blank (separators aside) nor a comment, and their numbers."""
    for at, line in enumerate(piece.split("\n"), number):
        if line.strip(" \t,;") and not line.lstrip().startswith(("#", '"#')):
            yield at, line


def _reader(lines: Iterable[str], separator: str, *, strict: bool = True) -> _Reader:
    """The cells of each line; ``strict`` refuses quotes that do not close."""
    return csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=strict)


def _header(line: str, separator: str, source: str) -> list[str]:
    """The cells of the header."""
    try:
        return next(_reader([line], separator))
    except csv.Error as error:
        message = f'{source}: not a CSV table ({error}). Check the double quotes (") in its header.'
        if "field larger than field limit" in str(error):
            message = (
                f"{source}: a cell of the header is longer than {csv.field_size_limit():,} characters, and no column's "
                "name is. Check that it is the right file."
            )
        raise MeasurementError(message) from error


def _no_csv(source: str, line: int, error: csv.Error) -> str:
    """What to say of a line that cannot be taken apart."""
    if "field larger than field limit" in str(error):
        return (
            f"{source}, line {line}: a cell is longer than {csv.field_size_limit():,} characters, and no measurement is"
            '. Delete it; if it runs over several lines, a double quote (") there does not close.'
        )
    return f'{source}, line {line}: not a CSV table ({error}). Check the double quotes (") there and above.'


def _separator(header: str) -> str:
    """The sign that splits a header line into the most cells with a unit, then the most cells."""

    def score(sign: str) -> tuple[int, int]:
        """How well a sign splits the header; most of them do it wrongly, hence not strict."""
        try:
            cells = next(_reader([header], sign, strict=False))
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
