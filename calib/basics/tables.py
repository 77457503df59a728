"""A table as text: separator, header and rows of cells.

One reader for all tables of calib: comma, semicolon, tab, bar or blanks between the cells, units in the header, blank
lines and those that begin with # or % skipped; or a sheet of an Excel file. The header is found by
`calib.basics.table_header`.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import read_bytes
from calib.basics.table_header import (
    BLANK,
    FRAMED,
    Line,
    cells_of,
    find_header,
    is_row,
    trimmed,
    unit_in,
)
from calib.basics.units import NUMBER, Unit, find_unit, is_unit, split_header
from calib.basics.workbook import read_sheet, split_sheet
from calib.errors import CalibError, FileError, MeasurementError

#: A line of a text with its end.
_LINE = re.compile(r"[^\n]*\n|[^\n]+")

#: A line before the header that tells Excel the separator: ``sep=;``.
_SEPARATOR_LINE = re.compile(r'"?sep=([,;\t|])"?[\s,;]*$', re.IGNORECASE)

#: Characters of a line without content.
_BLANKS = " \t,;|\n"

#: A line that is skipped: a comment, but not a cell of Excel such as #N/A; a rule between header and rows.
_COMMENT = re.compile(r'\s*"?(?:#(?!N/A|REF!|VALUE!|DIV/0!|NAME\?|NUM!|NULL!)|%)(?P<text>[^\n]*)')
_RULE = re.compile(r"[-=_+|:\s]*[-=]{3}[-=_+|:\s]*")

#: Cells that stand for no number, in lower case.
_MISSING = frozenset(
    (
        "",
        "nan",
        "na",
        "n/a",
        "n.a.",
        "#n/a",
        *("#ref!", "#value!", "#div/0!", "#name?", "#num!", "#null!"),
        "<na>",
        "null",
        "none",
        "-",
        "--",
        "\N{EN DASH}",
        "\N{EM DASH}",
    )
)

#: Signs that people and text processors write in place of the minus.
_MINUS = str.maketrans(
    dict.fromkeys("\N{MINUS SIGN}\N{EN DASH}\N{HYPHEN}\N{NON-BREAKING HYPHEN}", "-")
)

_EXAMPLE = "such as: set,joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]"


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table: its position, its header, and the name and unit that calib reads it by."""

    #: Position in the table, from 0.
    index: int
    #: The header cell as written, for messages.
    label: str
    #: Name that calib reads it by, after ``--columns`` was applied.
    name: str
    #: Symbol of the unit as written; None without brackets.
    symbol: str | None

    @property
    def unit(self) -> Unit | None:
        """The unit; None without one, or for an unknown one, which may not matter."""
        if self.symbol is None:
            return None
        try:
            return find_unit(self.symbol)
        except CalibError:
            return None

    @property
    def is_angle(self) -> bool:
        """True if the column is in a unit of angle."""
        return self.unit is not None and self.unit.quantity == "angle"

    @property
    def to_si(self) -> float:
        """Factor from the numbers as written to SI units; 1 without a unit, as for quaternions."""
        unit = self.unit
        return 1.0 if unit is None else unit.to_si


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A text table; a line ``sep=;`` before the header names the separator, as it does for Excel."""

    #: The file's name, for messages.
    source: str
    #: Hash of the file's bytes.
    sha256: str
    #: One of `SEPARATORS`, or `BLANK`.
    separator: str
    #: The header's cells.
    header: tuple[str, ...]
    #: Line of the file at which each row ends, from 1.
    lines: tuple[int, ...]
    #: The stripped cells of each row, as many as the header has.
    cells: tuple[list[str], ...]
    #: Line of the file with the header, from 1; 0: the table is of no file.
    header_line: int = 0

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a table from a file.

        Args:
            path: A text file in UTF-8, UTF-16 or Windows' own encoding; or an Excel file, see `read_text`.

        Returns:
            The table; the numbers in its cells are not read yet.

        Raises:
            MeasurementError: The file does not exist, is not text, has no header, or a row has another number of cells
                than the header.
        """
        source, sha256, text = read_text(path, "The table")
        return cls.parse(text, source, sha256)

    @classmethod
    def parse(cls, text: str, source: str, sha256: str = "") -> Table:
        r"""Read a table from its text.

        Args:
            text: The text, with lines that end in ``\n``.
            source: The file's name, for messages.
            sha256: Hash of the file's bytes.

        Returns:
            The table; the numbers in its cells are not read yet.

        Raises:
            MeasurementError: The text has no header, or a row has another number of cells than the header.
        """
        content, comments = _lines_of(text)
        named = _SEPARATOR_LINE.match(content[0][1]) if content else None
        if named is not None:
            del content[0]
        if not content:
            raise MeasurementError(
                f"{source}: the file is empty. A table begins with a header line, {_EXAMPLE}"
            )
        found = find_header(content, comments)
        header_line = found.lines[0][0]
        separator = found.separator
        if named is not None and named[1] in found.lines[0][1]:
            separator = named[1]

        lines, cells = _rows(found.lines, separator, source)
        header = cells[0]
        if is_row(header):
            raise MeasurementError(
                f"{source}, line {lines[0]}: the first line holds numbers where the header should be, {_EXAMPLE}"
            )
        first_row = 1
        if found.has_units_below:
            first_row = 2
            units = [unit_in(cell) for cell in cells[1]]
            for i, unit in enumerate(units):
                if unit and split_header(header[i])[1] is None:
                    header[i] = f"{header[i]} [{unit}]"
        named_cells = max((i + 1 for i, label in enumerate(header) if label), default=0)
        width = len(header)
        for i in range(first_row, len(cells)):
            row = cells[i]
            if len(row) == width:
                continue
            while len(row) > width and not row[-1]:  # separators at the end of a line
                row.pop()
            if named_cells <= len(row) < width:  # they are at the end of the header alone
                row.extend([""] * (width - len(row)))
            if len(row) != width:
                hint = ""
                if separator == "," and len(row) > width:
                    hint = " A decimal comma needs semicolons between the columns."
                elif separator == BLANK:
                    hint = " Between blanks no cell can be empty: write nan, or separate them by commas."
                raise MeasurementError(
                    f"{source}, line {lines[i]} (row {i - first_row + 1}): the row has {len(row)} cells, the "
                    f"header has {width}. Make them as many.{hint}"
                )
        rows = slice(first_row, None)
        return cls(
            source,
            sha256,
            separator,
            tuple(header),
            tuple(lines[rows]),
            tuple(cells[rows]),
            header_line,
        )

    @property
    def place(self) -> str:
        """The file's name and the line of the header, for messages."""
        return f"{self.source}, line {self.header_line}" if self.header_line else self.source

    def column(self, column: Column) -> list[str]:
        """Return the cells of a column, one a row."""
        return [row[column.index] for row in self.cells]

    def numbers(self, columns: Sequence[Column]) -> Array:
        """Read the numbers of c columns, in the units as written.

        Returns:
            Numbers, shape (rows, c); NaN for a cell that is empty or holds a word for it (`is_blank`), infinite for
            one that holds anything but a number.

        Raises:
            MeasurementError: Some numbers have decimal points, others decimal commas: one of the two may separate
                thousands.
        """
        texts = [self.column(column) for column in columns]
        if self.separator != ",":
            first_lines: dict[str, int] = {}
            for column_texts in texts:
                for sign in ".,":
                    row = next(
                        (
                            i
                            for i, text in enumerate(column_texts)
                            if sign in text and not is_blank(text)
                        ),
                        None,
                    )
                    if row is not None:
                        first_lines.setdefault(sign, self.lines[row])
            if len(first_lines) == 2:
                raise MeasurementError(
                    f"{self.source}: numbers have a decimal point in line {first_lines['.']} and a "
                    f"decimal comma in line {first_lines[',']}. Write all in one way, without a sign "
                    "between thousands."
                )
            texts = [[text.replace(",", ".") for text in column_texts] for column_texts in texts]
        result = np.empty((len(self.cells), len(columns)))
        for k, column_texts in enumerate(texts):
            result[:, k] = _parse_numbers(column_texts)
        return result

    def fail(
        self,
        row: int,
        column: Column,
        what: str,
        row_numbers: Column | None = None,
    ) -> NoReturn:
        """Refuse a cell.

        Args:
            row: The cell's row, from 0.
            column: The cell's column.
            what: What is wrong with it and how to mend it, for the message.
            row_numbers: The column with the table's own row numbers, for the message; None: rows are counted from 1.

        Raises:
            MeasurementError: Always.
        """
        written = self.cells[row][row_numbers.index] if row_numbers else ""
        number = written or str(row + 1)
        place = f"{self.source}, row {number}"  # of a frame
        if self.header_line:
            place = f"{self.source}, line {self.lines[row]} (row {number})"
        raise MeasurementError(f"{place}, column '{column.label}': {what}")


def has_header(text: str) -> bool:
    r"""Return True if a text, with lines that end in ``\n``, has a header with units as calib's tables have."""
    content, comments = _lines_of(text)
    if not content:
        return False
    found = find_header(content, comments)
    lines = [line for _, line in found.lines]
    names = cells_of(lines[0], found.separator)
    return found.has_units_below or any(is_unit(split_header(name)[1] or "") for name in names)


def is_blank(text: str) -> bool:
    """Return True if a cell of a column of numbers holds none: it is empty, or has a word for that, such as NaN."""
    return text.casefold() in _MISSING


def _lines_of(text: str) -> tuple[list[Line], list[Line]]:
    """Return the lines of a text that are not skipped, and the comments above the first of them without their sign."""
    content: list[Line] = []
    comments: list[Line] = []
    for number, found in enumerate(_LINE.finditer(text), 1):
        line = found.group()
        if line[0].isalnum():  # the usual line
            content.append((number, line))
            continue
        comment = _COMMENT.match(line)
        if comment is not None:
            if not content:
                comments.append((number, comment["text"].strip()))
        elif not _is_blank_line(line):
            content.append((number, line))
    return content, comments


def _is_blank_line(line: str) -> bool:
    """Return True if a line has no content: empty cells only, perhaps in quotes, or a rule below a header."""
    empty_cells = not line.strip(_BLANKS + '"') and line.count('"') % 2 == 0
    return empty_cells or _RULE.fullmatch(line.strip()) is not None


def _rows(
    content: Sequence[Line], separator: str, source: str
) -> tuple[list[int], list[list[str]]]:
    """Return the line at which each row of a table ends, and its stripped cells; the header is the first row.

    MeasurementError, with the file's name ``source``, if double quotes are not in pairs.
    """
    lines: list[int] = []
    cells: list[list[str]] = []
    content = list(content)
    if separator == BLANK:
        number, header = content.pop(0)
        lines.append(number)
        cells.append(cells_of(header, separator))
    texts = [line for _, line in content]
    if separator in FRAMED:
        texts = [trimmed(line, separator) for line in texts]
    reader = csv.reader(
        texts,
        delimiter=separator,
        skipinitialspace=True,
        strict=True,
    )
    try:
        for row in reader:
            lines.append(content[reader.line_num - 1][0])
            cells.append([cell.strip() for cell in row])
    except csv.Error as error:
        raise MeasurementError(
            f"{source}, line {content[reader.line_num - 1][0]}: not a CSV table ({error}). Check "
            'the double quotes (") there and above.'
        ) from error
    return lines, cells


def _parse_numbers(texts: Sequence[str]) -> Array:
    """Return the numbers in cells, shape (rows,): NaN for a missing one, infinite for one that holds anything else."""
    try:  # the usual column at once: ten times as fast
        numbers = np.array(list(map(float, texts)), dtype=np.float64)
    except ValueError:
        numbers = np.array([np.nan])
    # float() also reads nan, inf and 1_000, which no cell may hold.
    if np.isfinite(numbers).all() and not any("_" in text for text in texts):
        return numbers

    numbers = np.full(len(texts), np.inf)
    for row, text in enumerate(texts):
        plain = text.translate(_MINUS)
        if NUMBER.fullmatch(plain):
            numbers[row] = float(plain)
        elif is_blank(text):
            numbers[row] = np.nan
    return numbers


def read_text(path: str | Path, what: str) -> tuple[str, str, str]:
    r"""Read a text file.

    Args:
        path: A file in UTF-8 with or without its mark, in UTF-16 with one (Excel's "Unicode text"), else in Windows'
            own encoding; or an Excel file, perhaps with one of its sheets, ``"table.xlsx#Sheet"``.
        what: What the file should be, for messages: ``"The table"``.

    Returns:
        The file's name for messages, the SHA-256 of its bytes (for a sheet: of its text), and the text, with lines that
        end in ``\n``.

    Raises:
        MeasurementError: The file does not exist, or is not text.
    """
    file, sheet = split_sheet(str(path))
    source = (Path(file).name or str(path)) + (f"#{sheet}" if sheet else "")
    try:
        data = read_bytes(path if sheet is None else file, what)
    except FileError as error:
        raise MeasurementError(str(error)) from error
    if sheet is not None:
        text, name = read_sheet(data, source, sheet)
        if name and not sheet:
            source = f"{source}#{name}"
        # Two sheets of one file are two tables.
        return source, hashlib.sha256(text.encode()).hexdigest(), text
    return source, hashlib.sha256(data).hexdigest(), decoded(data, source)


def is_utf16(data: bytes) -> bool:
    """Return True if bytes begin with the mark of UTF-16."""
    return data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))


def decoded(data: bytes, source: str) -> str:
    r"""Return the text of a file, with lines that end in ``\n``.

    Args:
        data: Its bytes, in UTF-8, in UTF-16 with a mark, else in Windows' own encoding.
        source: Its name, for messages.

    Raises:
        MeasurementError: It is not text.
    """
    try:
        text = data.decode("utf-16" if is_utf16(data) else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if "\0" in text:
        raise MeasurementError(
            f"{source}: this is not a text file. Save it as text (CSV, UTF-8) or as .xlsx."
        )
    return text.replace("\r\n", "\n").replace("\r", "\n")
