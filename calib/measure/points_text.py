"""The text of a list of points, such as laser tracker programs write: its lines, cells, numbers and unit."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from calib.errors import MeasurementError

#: In the order in which they are tried; the last one stands for any number of blanks.
SEPARATORS = (";", "\t", ",", " ")

_COMMENT = ("#", "//", "!", "%", ";")
_RULE = re.compile(r"[-=_*+\s]+")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_DIGITS = re.compile(r"\d+")
_WORDS = re.compile(r"[^\W\d_]+")

# "in" is also a word, so it only counts where no other unit stands.
_UNIT_WORDS = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers"), "um"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("ft", "foot", "feet", "yd", "yard", "yards"), "ft"),
}


@dataclass(frozen=True, slots=True)
class Line:
    """A line of points: its number in the file and its stripped cells."""

    number: int
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PointsText:
    """The parts of such a file.

    Attributes:
        separator: one of `SEPARATORS`.
        lines: those with points.
        remarks: comment lines and header lines, without the sign of a comment.
        headings: those of them above the first point.
    """

    separator: str
    lines: tuple[Line, ...]
    remarks: tuple[str, ...]
    headings: tuple[str, ...]

    @classmethod
    def parse(cls, text: str, source: str) -> PointsText:
        """Take a text apart.

        Raises:
            MeasurementError: there are no points in it.
        """
        remarks: list[str] = []
        above, separator = 0, ""
        lines: list[Line] = []
        for number, line in enumerate(text.splitlines(), 1):
            remark = _remark(line)
            if remark is None and not lines:
                separator = _separator(line)
                if not separator:
                    remark = line.strip()
            if remark is None:
                lines.append(Line(number, split(line, separator)))
                continue
            if remark:
                remarks.append(remark)
                above += not lines
        if not lines:
            message = (
                f"{source}: no line of it holds three numbers. A list of points has lines such as "
                "'P1 100.0 200.0 300.0', separated by blanks, tabs, commas or semicolons."
            )
            raise MeasurementError(message)
        return cls(separator, tuple(lines), tuple(remarks), tuple(remarks[:above]))

    def units(self) -> tuple[str, ...]:
        """The different units of length that the remarks name, as symbols; ``"ft"`` for what calib does not know."""
        found: dict[str, None] = {}
        for remark in self.remarks:
            for symbol in _units_of(remark):
                found.setdefault(symbol)
        return tuple(found)


def decode(data: bytes, source: str) -> str:
    """Text of bytes as measuring programs write them: UTF-8, UTF-16 with its mark, else Windows' own.

    Raises:
        MeasurementError: it is no text.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = data.decode("utf-16", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
    if "\0" in text:
        message = f"{source}: this is not a text file. Export the points as text (ASCII)."
        raise MeasurementError(message)
    return text


def split(line: str, separator: str) -> tuple[str, ...]:
    """The stripped cells of a line, without the empty ones at its end."""
    plain = line.replace("\t", " ") if separator == " " else line
    reader = csv.reader([plain.strip(" \r\n")], delimiter=separator, skipinitialspace=True)
    try:
        cells = [cell.strip() for cell in chain.from_iterable(reader)]
    except csv.Error:  # a cell longer than the csv module reads: no number in any case
        return ()
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    return _NUMBER.fullmatch(cell) is not None


def has_point(cells: Sequence[str], start: int) -> bool:
    """Whether three numbers stand there."""
    three = cells[start : start + 3]
    return len(three) == 3 and all(is_number(cell) for cell in three)


def _remark(line: str) -> str | None:
    """What a comment, a blank line or a ruled one says; None for any other line."""
    plain = line.strip().strip('"').strip()
    if _RULE.fullmatch(plain) or not plain.strip(",;"):
        return ""
    for sign in _COMMENT:
        if plain.startswith(sign):
            return plain.lstrip("".join(_COMMENT)).strip()
    return None


def _separator(line: str) -> str:
    """The sign that leaves three numbers side by side; "" when none does."""
    if len(_DIGITS.findall(line)) < 3:  # most lines above the points
        return ""
    for separator in SEPARATORS:
        cells = split(line, separator)
        if any(has_point(cells, i) for i in range(len(cells) - 2)):
            return separator
    return ""


def _units_of(remark: str) -> Iterator[str]:
    """The unit of length that a remark names: behind the word unit, behind x, or alone."""
    plain = remark.casefold()
    behind = re.search(r"\bunits?\b(.*)", plain) or re.search(r"\bunit[^\W\d_]*\b(.*)", plain)
    bracket = re.search(r"\bx\s*[\[(]\s*([^\W\d_]+)\s*[\])]", plain)
    words = _WORDS.findall(behind[1]) if behind else []
    if bracket:
        words = [bracket[1]]
    elif not behind and len(_WORDS.findall(plain)) == 1:
        words = _WORDS.findall(plain)
    known = [_UNIT_WORDS[word] for word in words if word in _UNIT_WORDS]
    if known:
        yield known[0]
    elif words in (["in"], ["in", "deg"], ["in", "in"]):
        yield "in"
