"""The columns of a table of DH rows by their headings, the convention that these state, and the cells as numbers.

The value that is added to a row is that of its joint, of other joints whose readings are coupled, and a constant,

    direction (reading_i + sum_j coupling_ij reading_j) + offset

in the columns ``direction``, ``offset`` and ``coupling``, or, as calib writes it, in one formula under ``value added``:
``-1 * joint_3 + joint_2 - 90 deg``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from calib.basics.tables import Column, Table
from calib.basics.units import ANGLE, LENGTH, NUMBER, PLAIN, parse_quantity, split_header
from calib.errors import CalibError, MeasurementError, choices, did_you_mean
from calib.robot.dh_rows import CONVENTIONS, HAYATI, MODIFIED, STANDARD

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

#: Columns that are ignored.
_REMARKS = ("note", "remark", "comment")

#: Other spellings of headings.
_SPELLINGS = {"θ": "theta", "α": "alpha", "β": "beta", "name": "joint", "sign": "direction"}

#: A heading with the index of the previous row: ``a(i-1)``, ``alpha_{i-1}``, ``a_i-1``.
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


#: Directions by the text of a cell.
_DIRECTIONS = {"": 1, "1": 1, "+1": 1, "+": 1, "-1": -1, "-": -1, "1.0": 1, "-1.0": -1}

#: The signs between the terms of a sum.
_SIGNS = re.compile(r"\s+([+-])\s+")

#: The key of a sum's constant, among the names of joints.
_CONSTANT = ""


@dataclass(frozen=True, slots=True, eq=False)
class DHColumns:
    """The columns of a table of DH rows by name; ``offset``, ``lower`` and ``upper`` may have two each."""

    #: The table.
    table: Table
    #: The columns of each name.
    by_name: Mapping[str, tuple[Column, ...]]
    #: The convention.
    convention: str

    def text(self, row: int, name: str) -> str:
        """Return the text of a cell, by its row, from 0, and the name of its column; empty if there is none."""
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
        """Return the number of a cell in SI units; None if it is empty.

        Args:
            row: The row, from 0.
            name: Name of the column.
            slides: True if the row's joint slides: its offset and limits are lengths.

        Raises:
            MeasurementError: It is not a number, has no unit or one of another quantity, or two columns have a number.
        """
        filled = [c for c in self.by_name.get(name, ()) if self.table.cells[row][c.index]]
        if not filled:
            return None
        if len(filled) > 1:
            what = f"the row has a number in '{filled[1].label}', too. Keep one of them."
            raise self.error(row, name, what)
        column = filled[0]
        text = self.table.cells[row][column.index]
        if self.table.separator != ",":
            text = text.replace(",", ".")
        try:
            value, quantity = parse_quantity(
                text if column.symbol is None else f"{text} {column.symbol}"
            )
        except CalibError as error:
            what = f"'{text}' is not a number: {error}. Leave the cell empty for 0."
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


def is_dh_table(table: Table) -> bool:
    """Return True if the headings of a table are those of DH rows: it has columns of alpha and of d."""
    names = {_name_of(split_header(label)[0])[0] for label in table.header}
    return {"alpha", "d"} <= names


def dh_columns(table: Table, stated: str | None) -> DHColumns:
    """Name the columns of a table of DH rows, and find the convention.

    Args:
        table: The table.
        stated: The convention that a comment of the file states; None if none does.

    Raises:
        MeasurementError: A column is missing, unknown or there twice, its unit is wrong, or the convention is not one.
    """
    by_name: dict[str, tuple[Column, ...]] = {}
    known = (*_LENGTHS, *_ANGLES, *_EITHER, *_WORDS)
    of_row_before = set()  # names of columns whose headings have the index i - 1
    for index, label in enumerate(table.header):
        heading, symbol = split_header(label)
        name, is_of_row_before = _name_of(heading)
        if not name or name in _REMARKS:
            continue
        column = Column(index, label, name, symbol)
        place = f"{table.source}, column '{label}'"
        if name not in known:
            raise MeasurementError(
                f"{place}: no column of DH rows has this name{did_you_mean(name, known)}; they are "
                f"{choices((*known, *_REMARKS), 40)}. Rename it, or call it 'remark'."
            )

        # Its unit is that of lengths, of angles, or, of some columns, of either.
        usual_units = {}  # by quantity
        if name in _ANGLES or name in _EITHER:
            usual_units["angle"] = "[deg]"
        if name in _LENGTHS or name in _EITHER:
            usual_units["length"] = "[mm]"
        unit = column.unit
        if symbol is not None and (unit is None or unit.quantity not in usual_units):
            wanted = " or ".join(usual_units.values()) or "no unit"
            raise MeasurementError(f"{place}: '{symbol}' is not a unit for it; {wanted} is wanted.")

        # No column is there twice, except those of either quantity in two units.
        others = by_name.get(name, ())
        for other in others:
            has_two_units = other.unit is not None and unit is not None and other.unit is not unit
            if name not in _EITHER or not has_two_units:
                raise MeasurementError(
                    f"{place}: there is another column '{other.label}'; keep one of them."
                )
        by_name[name] = (*others, column)
        if is_of_row_before:
            of_row_before.add(name)
    missing = [name for name in ("d", "a", "alpha") if name not in by_name]
    if missing:
        raise MeasurementError(
            f"{table.source}: DH rows need columns of theta, d, a and alpha; {choices(missing)} is missing. The "
            f"headings found: {choices(table.header, 30)}."
        )
    columns = DHColumns(table, by_name, STANDARD)
    return replace(columns, convention=_find_convention(columns, of_row_before, stated))


def _name_of(heading: str) -> tuple[str, bool]:
    """Return the name of a column by its heading, and True if it has the index i - 1."""
    text = " ".join(heading.split())
    is_before = _BEFORE.fullmatch(text)
    text = is_before[1] if is_before else _INDEX.sub("", text)
    text = text.casefold().strip(" _")
    return _SPELLINGS.get(text, text), is_before is not None


def _find_convention(columns: DHColumns, of_row_before: set[str], stated: str | None) -> str:
    """Return the convention that headings, the column ``convention`` and a comment state; standard if none does.

    ``of_row_before`` are the columns whose headings have the index i - 1, ``stated`` is the comment's word, or None.
    MeasurementError if two are stated, or a word is not a convention.
    """
    table = columns.table
    by_headings = None
    has_beta = "beta" in columns.by_name
    if of_row_before:
        if has_beta:
            raise MeasurementError(
                f"{table.source}: headings of two conventions: 'beta' is Hayati's, and (i-1) of the modified one. "
                "Keep one."
            )
        if not {"a", "alpha"} <= of_row_before:
            raise MeasurementError(
                f"{table.source}: headings of two conventions: of a and alpha one has the index (i-1) of the modified "
                "one, the other has not. Give it to both, or to none."
            )
        by_headings = MODIFIED
    elif has_beta:
        by_headings = HAYATI

    words = set()
    for i in range(len(table.cells)):
        word = columns.text(i, "convention")
        if word and word.lower() not in _CONVENTIONS:
            raise columns.error(i, "convention", _unknown_convention(word))
        words.add(word)
    words.discard("")
    if stated:
        if stated.lower() not in _CONVENTIONS:
            raise MeasurementError(f"{table.source}: {_unknown_convention(stated)}")
        words.add(stated)

    conventions = {by_headings} if by_headings else set()
    conventions |= {_CONVENTIONS[word.lower()] for word in words}
    if len(conventions) > 1:
        says = f"its headings say '{by_headings}', and " if by_headings else ""
        raise MeasurementError(
            f"{table.source}: two conventions: {says}it states {choices(sorted(words))}. Keep one."
        )
    return conventions.pop() if conventions else STANDARD


def _unknown_convention(word: str) -> str:
    """Return the text of a message on a word that is not a convention of DH rows."""
    return f"'{word}' is not a convention of DH rows; it must be one of {choices(CONVENTIONS)}."


def value_added(
    columns: DHColumns, i: int, joint: str, *, slides: bool
) -> tuple[int, float, dict[str, float]]:
    """Read the value that is added to a row: direction, offset, and factors of other joints' readings.

    Args:
        columns: The columns of the table.
        i: Index of the row in the table, from 0, the heading not counted.
        joint: Name of the row's joint.
        slides: True if the joint slides: constants are lengths.

    Returns:
        The direction, 1 or -1, by which the joint's value is multiplied; the offset that is added to it [rad], or [m]
        for a joint that slides; and the factors of other joints' readings in the joint's value, before the direction,
        by name. They are 1, 0 and none if the cells are empty.

    Raises:
        MeasurementError: A cell has a fault, or the joint has no value of its own; the text names row and column.
    """
    formula = columns.text(i, "value added")
    if not formula:
        word = columns.text(i, "direction")
        if word not in _DIRECTIONS:
            what = f"'{word}' is not a direction; it must be 1 or -1."
            raise columns.error(i, "direction", what)
        stated_offset = columns.number(i, "offset", slides=slides)
        coupling = {}
        if columns.text(i, "coupling"):
            coupling = _factors(columns, i, "coupling", slides=slides)
        if coupling.pop(_CONSTANT, 0.0):
            raise columns.error(i, "coupling", "a number without a joint. Write '1 * joint_2'.")
        return _DIRECTIONS[word], stated_offset or 0.0, coupling

    for other in ("direction", "offset", "coupling"):
        if columns.text(i, other):
            what = f"the column 'value added' says it already. Leave '{other}' empty."
            raise columns.error(i, other, what)
    factors = _factors(columns, i, "value added", slides=slides)
    offset = factors.pop(_CONSTANT, 0.0)
    direction = factors.pop(joint, 0.0)
    if direction not in (1.0, -1.0):
        what = (
            f"'{formula}' is not 1 or -1 times the value of '{joint}': a joint that follows another one, or is held, "
            "has no row of its own here. Give such a robot as a URDF (calib convert -o robot.urdf)."
        )
        raise columns.error(i, "value added", what)
    coupling = {name: direction * factor for name, factor in factors.items()}
    return int(direction), offset, coupling


def _factors(columns: DHColumns, i: int, column: str, *, slides: bool) -> dict[str, float]:
    """Return the factors of joints in a cell's sum, such as ``-1 * joint_3 + joint_2 - 90 deg``, by name.

    The constant, [rad], or [m] for a joint that slides, has the key `_CONSTANT`. MeasurementError for a joint named
    twice, or a constant with a wrong unit.
    """
    text = columns.text(i, column)
    terms = _SIGNS.split(text)
    signs = ["+", *terms[1::2]]
    factors: dict[str, float] = {}
    for sign, term in zip(signs, terms[::2], strict=True):
        name, factor = _term(columns, i, column, term.strip(), slides=slides)
        if name in factors:
            twice = name or term.strip()
            raise columns.error(i, column, f"'{text}' names '{twice}' twice. Add them up.")
        factors[name] = factor if sign == "+" else -factor
    return factors


def _term(columns: DHColumns, i: int, column: str, term: str, *, slides: bool) -> tuple[str, float]:
    """Return the joint and factor of ``-0.5 * joint_2`` or ``joint_2``, or `_CONSTANT` and its value [rad or m].

    MeasurementError for a constant with a wrong unit; any other word counts as a joint, which the caller checks.
    """
    before_star, star, after_star = (part.strip() for part in term.partition("*"))
    if star and NUMBER.fullmatch(before_star):
        return after_star, float(before_star)
    joints = {columns.text(row, "joint") for row in range(len(columns.table.cells))} - {""}
    for sign, factor in (("", 1.0), ("-", -1.0), ("+", 1.0)):
        if term.startswith(sign) and term.removeprefix(sign) in joints:
            return term.removeprefix(sign), factor
    try:
        constant, quantity = parse_quantity(term)
    except CalibError:
        return term, 1.0  # to be refused as the name of an unknown joint
    wanted = LENGTH if slides else ANGLE
    if quantity != wanted:
        what = f"'{term}' is {quantity}; {wanted} is wanted, with its unit."
        raise columns.error(i, column, what)
    return _CONSTANT, constant
