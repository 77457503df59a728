"""The columns of a table of DH rows: which there are, what their headings say of the convention, and their cells."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from calib.errors import CalibError, MeasurementError, choices, did_you_mean
from calib.robot.dh.rows import CONVENTIONS, HAYATI, MODIFIED, STANDARD
from calib.tables.table import Column, Table
from calib.units import ANGLE, LENGTH, PLAIN, parse_quantity, split_header

POSE = ("x", "y", "z", "roll", "pitch", "yaw")
"""Columns of a constant pose, R = Rz(yaw) Ry(pitch) Rx(roll)."""

#: Columns of numbers: a length, an angle, or either by the type of the joint.
_LENGTHS = ("d", "a", "x", "y", "z")
_ANGLES = ("theta", "alpha", "beta", "roll", "pitch", "yaw")
_EITHER = ("offset", "lower", "upper")

#: Columns of words.
_WORDS = (
    "table",
    "row",
    "joint",
    "type",
    "direction",
    "coupling",
    "convention",
    "added to",
    "value added",
)

#: Columns that are for people.
_REMARKS = ("note", "remark", "comment")

#: Other spellings of headings.
_SPELLINGS = {"θ": "theta", "α": "alpha", "β": "beta", "name": "joint", "sign": "direction"}

#: A heading with the index of the row before: ``a(i-1)``, ``alpha_{i-1}``, ``a_i-1``.
_BEFORE = re.compile(r"(.+?)\s*_?\s*[({]?\s*i\s*[-−]\s*1\s*[)}]?")

#: The index of a heading's own row: ``a_i``, ``d(i)``.
_INDEX = re.compile(r"\s*_?[({]?i[)}]?$")

#: Words for the conventions.
_CONVENTIONS = {
    STANDARD: STANDARD,
    "distal": STANDARD,
    MODIFIED: MODIFIED,
    "craig": MODIFIED,
    "proximal": MODIFIED,
    HAYATI: HAYATI,
}


@dataclass(frozen=True, slots=True, eq=False)
class DHColumns:
    """The columns of a table of DH rows by name; of ``offset``, ``lower`` and ``upper`` there may be two."""

    #: The table.
    table: Table
    #: The columns of each name.
    by_name: Mapping[str, tuple[Column, ...]]
    #: The convention.
    convention: str

    def text(self, row: int, name: str) -> str:
        """Return the cell of a row, from 0, and a column; empty where there is none."""
        for column in self.by_name.get(name, ()):
            text = self.table.cells[row][column.index]
            if text:
                return text
        return ""

    def fail(self, row: int, name: str, what: str) -> MeasurementError:
        """Return the error of a cell, of a row from 0, which names file, line and column."""
        column = self.by_name[name][0]
        for other in self.by_name[name]:
            if self.table.cells[row][other.index]:
                column = other
                break
        try:
            self.table.fail(row, column, what)
        except MeasurementError as error:
            return error

    def number(self, row: int, name: str, *, slides: bool = False) -> float | None:
        """Return the number of a cell in SI units; None where it is empty.

        Args:
            row: The row, from 0.
            name: Name of the column.
            slides: True if the row's joint slides: its offset and limits are lengths.

        Raises:
            MeasurementError: It is no number, has no unit, or that of another quantity.
        """
        filled = [c for c in self.by_name.get(name, ()) if self.table.cells[row][c.index]]
        if not filled:
            return None
        if len(filled) > 1:
            what = f"the row has a number in '{filled[1].label}', too. Keep one of them."
            raise self.fail(row, name, what)
        column = filled[0]
        text = self.table.cells[row][column.index]
        wanted = LENGTH if name in _LENGTHS or (name in _EITHER and slides) else ANGLE
        if self.table.separator != ",":
            text = text.replace(",", ".")
        example = "10 mm" if wanted == LENGTH else "90 deg"
        try:
            value, quantity = parse_quantity(
                text if column.symbol is None else f"{text} {column.symbol}"
            )
        except CalibError as error:
            what = f"'{text}' is no number: {error}. Leave the cell empty for 0."
            raise self.fail(row, name, what) from error
        if quantity == PLAIN and value == 0.0:
            return value
        if quantity == PLAIN:
            symbol = example.split()[1]
            what = f"the number {text} has no unit. Write it into the heading: '{column.label} [{symbol}]'."
            raise self.fail(row, name, what)
        if quantity != wanted:
            reason = ""
            if name in _EITHER:
                reason = f", for the joint {'slides' if slides else 'turns'}"
            what = f"'{text}' is {quantity}; {wanted} is wanted{reason}, such as '{example}'."
            raise self.fail(row, name, what)
        return value


def is_dh_table(table: Table) -> bool:
    """Return True if the headings of a table are those of DH rows: it has columns of alpha and of d."""
    names = {_plain(split_header(label)[0])[0] for label in table.header}
    return {"alpha", "d"} <= names


def dh_columns(table: Table, stated: str | None) -> DHColumns:
    """Name the columns of a table of DH rows, and find the convention.

    Args:
        table: The table.
        stated: The convention that a comment of the file states; None: none does.

    Raises:
        MeasurementError: A column is missing, unknown or there twice, its unit is wrong, or the convention is not one.
    """
    by_name: dict[str, tuple[Column, ...]] = {}
    before = set()
    for index, label in enumerate(table.header):
        heading, symbol = split_header(label)
        name, is_before = _plain(heading)
        if not name or name in _REMARKS:
            continue
        column = Column(index, label, name, symbol)
        _check_column(table, column, by_name)
        by_name[name] = (*by_name.get(name, ()), column)
        if is_before:
            before.add(name)
    missing = [name for name in ("d", "a", "alpha") if name not in by_name]
    if missing:
        raise MeasurementError(
            f"{table.source}: DH rows need columns of theta, d, a and alpha; {choices(missing)} is missing. The "
            f"headings found: {choices(table.header, 30)}."
        )
    convention = _by_headings(table, before, has_beta="beta" in by_name)
    found = DHColumns(table, by_name, convention or STANDARD)
    words = {stated} if stated else set()
    if "convention" in by_name:
        for i in range(len(table.cells)):
            word = found.text(i, "convention")
            if word and word.lower() not in _CONVENTIONS:
                raise found.fail(i, "convention", _no_convention(word))
            words |= {word} if word else set()
    return DHColumns(table, by_name, _agreed(table, convention, words))


def _plain(heading: str) -> tuple[str, bool]:
    """Return the name of a column by its heading, and True if it has the index i - 1."""
    text = " ".join(heading.split())
    is_before = _BEFORE.fullmatch(text)
    text = is_before[1] if is_before else _INDEX.sub("", text)
    text = text.casefold().strip(" _")
    return _SPELLINGS.get(text, text), is_before is not None


def _check_column(table: Table, column: Column, by_name: Mapping[str, tuple[Column, ...]]) -> None:
    """Refuse a column that is unknown, of another unit than it must be, or there twice."""
    name = column.name
    known = (*_LENGTHS, *_ANGLES, *_EITHER, *_WORDS)
    place = f"{table.source}, column '{column.label}'"
    if name not in known:
        raise MeasurementError(
            f"{place}: no column of DH rows has this name{did_you_mean(name, known)}; they are "
            f"{choices((*known, *_REMARKS), 40)}. Rename it, or call it 'remark'."
        )
    quantities = {"length"} if name in _LENGTHS else {"angle"}
    if name in _EITHER:
        quantities = {"length", "angle"}
    if column.symbol is not None:
        unit = column.unit
        if name in _WORDS or unit is None or unit.quantity not in quantities:
            wanted = "no unit"
            if name not in _WORDS:
                wanted = " or ".join(
                    "[mm]" if q == "length" else "[deg]" for q in sorted(quantities)
                )
            raise MeasurementError(
                f"{place}: '{column.symbol}' is no unit for it; {wanted} is wanted."
            )
    for other in by_name.get(name, ()):
        if (
            name not in _EITHER
            or other.unit is None
            or other.unit is column.unit
            or column.unit is None
        ):
            raise MeasurementError(
                f"{place}: there is another column '{other.label}'; keep one of them."
            )


def _by_headings(table: Table, before: set[str], *, has_beta: bool) -> str | None:
    """Return the convention that the headings state; None where they state none."""
    if before and has_beta:
        raise MeasurementError(
            f"{table.source}: headings of two conventions: 'beta' is Hayati's, and (i-1) of the modified one. Keep one."
        )
    if before and not {"a", "alpha"} <= before:
        raise MeasurementError(
            f"{table.source}: headings of two conventions: of a and alpha one has the index (i-1) of the modified one, "
            "the other has not. Give it to both, or to none."
        )
    if before:
        return MODIFIED
    return HAYATI if has_beta else None


def _agreed(table: Table, by_headings: str | None, words: set[str]) -> str:
    """Return the convention that headings and words of a table state; standard where nothing does."""
    found = {by_headings} if by_headings else set()
    for word in sorted(words):
        if word.lower() not in _CONVENTIONS:
            raise MeasurementError(f"{table.source}: {_no_convention(word)}")
        found.add(_CONVENTIONS[word.lower()])
    if len(found) > 1:
        stated = f"its headings say '{by_headings}', and " if by_headings else ""
        raise MeasurementError(
            f"{table.source}: two conventions: {stated}it states {choices(sorted(words))}. Keep one."
        )
    return found.pop() if found else STANDARD


def _no_convention(word: str) -> str:
    """Return the fault of a word that is no convention."""
    return f"'{word}' is no convention of DH rows; it must be one of {choices(CONVENTIONS)}."
