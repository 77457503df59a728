"""The columns of a table of DH rows by their headings, the convention that these state, and the cells as numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from calib.basics.tables import Column, Table
from calib.basics.units import ANGLE, LENGTH, PLAIN, parse_quantity, split_header
from calib.errors import CalibError, MeasurementError, choices, did_you_mean
from calib.robot.dh.rows import CONVENTIONS, HAYATI, MODIFIED, STANDARD

POSE = ("x", "y", "z", "roll", "pitch", "yaw")
"""Columns of a constant pose, R = Rz(yaw) Ry(pitch) Rx(roll)."""

#: Columns of lengths.
_LENGTHS = ("d", "a", "x", "y", "z")

#: Columns of angles.
_ANGLES = ("theta", "alpha", "beta", "roll", "pitch", "yaw")

#: Columns of lengths for a joint that slides, of angles for one that turns.
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
        """Return the text of a cell; empty where there is none.

        Args:
            row: The row, from 0.
            name: Name of the column.
        """
        for column in self.by_name.get(name, ()):
            text = self.table.cells[row][column.index]
            if text:
                return text
        return ""

    def error(self, row: int, name: str, what: str) -> MeasurementError:
        """Return the error of a cell, which names file, line and column.

        Args:
            row: The row, from 0.
            name: Name of a column that the table has.
            what: What is wrong with the cell and how to mend it, for the message.
        """
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
        column = self._filled_column(row, name)
        if column is None:
            return None
        text = self.table.cells[row][column.index]
        if self.table.separator != ",":
            text = text.replace(",", ".")
        try:
            value, quantity = parse_quantity(
                text if column.symbol is None else f"{text} {column.symbol}"
            )
        except CalibError as error:
            what = f"'{text}' is no number: {error}. Leave the cell empty for 0."
            raise self.error(row, name, what) from error
        if quantity == PLAIN and value == 0.0:
            return value
        wanted = LENGTH if name in _LENGTHS or (name in _EITHER and slides) else ANGLE
        if quantity == PLAIN:
            symbol = "mm" if wanted == LENGTH else "deg"
            what = f"the number {text} has no unit. Write it into the heading: '{column.label} [{symbol}]'."
            raise self.error(row, name, what)
        if quantity != wanted:
            example = "10 mm" if wanted == LENGTH else "90 deg"
            reason = ""
            if name in _EITHER:
                reason = f", for the joint {'slides' if slides else 'turns'}"
            what = f"'{text}' is {quantity}; {wanted} is wanted{reason}, such as '{example}'."
            raise self.error(row, name, what)
        return value

    def _filled_column(self, row: int, name: str) -> Column | None:
        """Return the column of a name that has a number in a row, of which there may be one; None if there is none."""
        filled = [c for c in self.by_name.get(name, ()) if self.table.cells[row][c.index]]
        if len(filled) > 1:
            what = f"the row has a number in '{filled[1].label}', too. Keep one of them."
            raise self.error(row, name, what)
        return filled[0] if filled else None


def is_dh_table(table: Table) -> bool:
    """Return True if the headings of a table are those of DH rows: it has columns of alpha and of d."""
    names = {_name_of(split_header(label)[0])[0] for label in table.header}
    return {"alpha", "d"} <= names


def dh_columns(table: Table, stated: str | None) -> DHColumns:
    """Name the columns of a table of DH rows, and find the convention.

    Args:
        table: The table.
        stated: The convention that a comment of the file states; None: none does.

    Raises:
        MeasurementError: A column is missing, unknown or there twice, its unit is wrong, or the convention is not one.
    """
    by_name, of_row_before = _columns_by_name(table)
    missing = [name for name in ("d", "a", "alpha") if name not in by_name]
    if missing:
        raise MeasurementError(
            f"{table.source}: DH rows need columns of theta, d, a and alpha; {choices(missing)} is missing. The "
            f"headings found: {choices(table.header, 30)}."
        )
    by_headings = _by_headings(table, of_row_before, has_beta="beta" in by_name)
    columns = DHColumns(table, by_name, by_headings or STANDARD)
    words = _words_for_conventions(columns)
    if stated:
        words.add(stated)
    return replace(columns, convention=_agreed(table, by_headings, words))


def _columns_by_name(table: Table) -> tuple[dict[str, tuple[Column, ...]], set[str]]:
    """Return the columns of each name, and the names of those whose headings have the index i - 1."""
    by_name: dict[str, tuple[Column, ...]] = {}
    of_row_before = set()
    for index, label in enumerate(table.header):
        heading, symbol = split_header(label)
        name, is_of_row_before = _name_of(heading)
        if not name or name in _REMARKS:
            continue
        column = Column(index, label, name, symbol)
        _check_unit(table, column)
        _check_single(table, column, by_name.get(name, ()))
        by_name[name] = (*by_name.get(name, ()), column)
        if is_of_row_before:
            of_row_before.add(name)
    return by_name, of_row_before


def _words_for_conventions(columns: DHColumns) -> set[str]:
    """Return the words, as written, in the column ``convention``; none if the table has no such column."""
    words = set()
    for i in range(len(columns.table.cells)):
        word = columns.text(i, "convention")
        if word and word.lower() not in _CONVENTIONS:
            raise columns.error(i, "convention", _no_convention(word))
        if word:
            words.add(word)
    return words


def _name_of(heading: str) -> tuple[str, bool]:
    """Return the name of a column by its heading, and True if it has the index i - 1."""
    text = " ".join(heading.split())
    is_before = _BEFORE.fullmatch(text)
    text = is_before[1] if is_before else _INDEX.sub("", text)
    text = text.casefold().strip(" _")
    return _SPELLINGS.get(text, text), is_before is not None


def _check_unit(table: Table, column: Column) -> None:
    """Refuse a column that is unknown, or of another unit than it must be."""
    name = column.name
    known = (*_LENGTHS, *_ANGLES, *_EITHER, *_WORDS)
    place = f"{table.source}, column '{column.label}'"
    if name not in known:
        raise MeasurementError(
            f"{place}: no column of DH rows has this name{did_you_mean(name, known)}; they are "
            f"{choices((*known, *_REMARKS), 40)}. Rename it, or call it 'remark'."
        )
    if column.symbol is None:
        return
    units = _units_of(name)
    unit = column.unit
    if unit is None or unit.quantity not in units:
        wanted = " or ".join(units.values()) or "no unit"
        raise MeasurementError(f"{place}: '{column.symbol}' is no unit for it; {wanted} is wanted.")


def _units_of(name: str) -> dict[str, str]:
    """Return the usual unit of each quantity that a column may have; none for a column of words."""
    units = {}
    if name in _ANGLES or name in _EITHER:
        units["angle"] = "[deg]"
    if name in _LENGTHS or name in _EITHER:
        units["length"] = "[mm]"
    return units


def _check_single(table: Table, column: Column, others: Sequence[Column]) -> None:
    """Refuse a second column of one name, but for `_EITHER` in two units, one of lengths and one of angles."""
    for other in others:
        has_two_units = (
            other.unit is not None and column.unit is not None and other.unit is not column.unit
        )
        if column.name not in _EITHER or not has_two_units:
            raise MeasurementError(
                f"{table.source}, column '{column.label}': there is another column '{other.label}'; keep one of them."
            )


def _by_headings(table: Table, of_row_before: set[str], *, has_beta: bool) -> str | None:
    """Return the convention that the headings state; None where they state none."""
    if of_row_before and has_beta:
        raise MeasurementError(
            f"{table.source}: headings of two conventions: 'beta' is Hayati's, and (i-1) of the modified one. Keep one."
        )
    if of_row_before and not {"a", "alpha"} <= of_row_before:
        raise MeasurementError(
            f"{table.source}: headings of two conventions: of a and alpha one has the index (i-1) of the modified one, "
            "the other has not. Give it to both, or to none."
        )
    if of_row_before:
        return MODIFIED
    return HAYATI if has_beta else None


def _agreed(table: Table, by_headings: str | None, words: set[str]) -> str:
    """Return the convention that headings and words of a table state; standard where nothing does."""
    conventions = {by_headings} if by_headings else set()
    for word in sorted(words):
        if word.lower() not in _CONVENTIONS:
            raise MeasurementError(f"{table.source}: {_no_convention(word)}")
        conventions.add(_CONVENTIONS[word.lower()])
    if len(conventions) > 1:
        stated = f"its headings say '{by_headings}', and " if by_headings else ""
        raise MeasurementError(
            f"{table.source}: two conventions: {stated}it states {choices(sorted(words))}. Keep one."
        )
    return conventions.pop() if conventions else STANDARD


def _no_convention(word: str) -> str:
    """Return the fault of a word that is no convention."""
    return f"'{word}' is no convention of DH rows; it must be one of {choices(CONVENTIONS)}."
