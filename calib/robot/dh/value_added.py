"""The value that is added to a DH row: of its joint, of other joints whose readings are coupled, and a constant.

A table of DH rows states it in the columns ``direction``, ``offset`` and ``coupling``, or, as calib writes it, in one
formula under ``value added``: ``-1 * joint_3 + joint_2 - 90 deg``. The value is

    direction (reading_i + sum_j coupling_ij reading_j) + offset
"""

from __future__ import annotations

import re

from calib.basics.units import ANGLE, LENGTH, NUMBER, parse_quantity
from calib.errors import CalibError
from calib.robot.dh.columns import DHColumns

#: Directions by the text of a cell.
_DIRECTIONS = {"": 1, "1": 1, "+1": 1, "+": 1, "-1": -1, "-": -1, "1.0": 1, "-1.0": -1}

#: The signs between the terms of a sum.
_SIGNS = re.compile(r"\s+([+-])\s+")

#: The key of a sum's constant, among the names of joints.
_CONSTANT = ""


def value_added(
    columns: DHColumns, i: int, joint: str, *, slides: bool
) -> tuple[int, float, dict[str, float]]:
    """Read what is added to a row.

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
    """Return the factors of joints in a sum such as ``-1 * joint_3 + joint_2 - 90 deg``, by name.

    The constant [rad or m] has the key `_CONSTANT`.
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
    """Return the joint and factor of ``-0.5 * joint_2`` or ``joint_2``, or the constant [rad or m] without a joint."""
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
