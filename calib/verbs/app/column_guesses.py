"""Columns and units of a job's table, as far as its headers do not say them in calib's words.

Joints are matched by the maker's names, or by the number in a name and the order of the chain; positions by what
their names end in; units by the size of the numbers. All of it is in doubt until somebody has looked.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.basics.tables import Column, Table
from calib.basics.units import find_unit, is_unit, split_header, symbols
from calib.data.columns import POINT
from calib.data.forms.column_options import BRANDS, ColumnOptions, brands_like
from calib.data.points_file import read_points
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.app.fields import Fields, Looked, plain

#: Angles in radians are below this, apart from those of joints that turn several times.
_MOST_RADIANS = 6.6

#: Coordinates of a cell in metres are below this, and those in millimetres above.
_MOST_METRES = 12.0

#: A coordinate by its header, such as ``X``, ``pos_x``, ``TCP.x (mm)``.
_COORDINATE = re.compile(r"(?:.*[^a-z])?([xyz])(?:[\s_(\[]*([a-zµ]{1,2})[)\]]*)?", re.IGNORECASE)

#: A joint by its header, such as ``J1``, ``joint_2``, ``Axis 3``, ``q4``.
_NUMBERED = re.compile(
    r"(?:.*[^a-z])?(?:j|a|q|joint|axis|achse|gelenk)[\s_.-]*(\d)(?:\D.*)?", re.IGNORECASE
)


def add_column_fields(fields: Fields, table: Table, arm: Robot, folder: Path) -> None:
    """Add the fields of columns and units: those that the table's headers leave open.

    Args:
        fields: The fields, with that of the list of points.
        table: The table.
        arm: The chain whose joints are its columns.
        folder: The folder of the list of points.
    """
    names = [split_header(label)[0] for label in table.header]
    brand = _brand_field(fields, names, arm)
    _column_fields(fields, table, arm, brand)
    _unit_fields(fields, table, arm, folder)


def is_of_brand(fields: Fields, names: Sequence[str]) -> bool:
    """Return True if the columns have the names of a maker's axes, so that they name no joints."""
    return bool(fields.chosen("brand") or brands_like(names))


def column_choice(looked: Looked, header: Sequence[str]) -> ColumnOptions:
    """Return what the fields say of a table's columns."""
    return ColumnOptions(
        dict(word.rpartition("=")[::2] for word in column_words(looked, header)),
        looked.value("brand") or None,
        None,
        looked.value("joint_unit") or None,
    )


def column_words(looked: Looked, header: Sequence[str]) -> list[str]:
    """Return the words of ``--columns`` that map columns, such as ``"J1=joint_1"``."""
    words = []
    unit = looked.value("position_unit")
    for name, one in looked.fields.items():
        if not name.startswith("column:") or not one.value:
            continue
        wanted = name.removeprefix("column:")
        label = next((label for label in header if label == one.value), one.value)
        written, symbol = split_header(label)
        to_unit = unit if wanted in POINT and symbol is None else ""
        if written != wanted or to_unit:
            words.append(f"{written}={wanted}" + (f" [{to_unit}]" if to_unit else ""))
    return words


def _brand_field(fields: Fields, names: Sequence[str], arm: Robot) -> str:
    """Add the field of the brand whose names the columns have; return the brand, empty for none."""
    if set(arm.joint_names) <= set(names):
        guess, doubt = "", ""
    else:
        alike = brands_like(names)
        guess = alike[0].name if alike else ""
        doubt = "doubt_brand" if alike else ""
        if guess and len(alike[0].axes_in(names)) != len(arm.joint_names):
            guess = doubt = ""
    if not guess and not fields.chosen("brand"):
        return ""
    options = [("", "-"), *((brand.name, brand.title) for brand in BRANDS.values())]
    return fields.add("brand", guess, options, doubt)


def _column_fields(fields: Fields, table: Table, arm: Robot, brand: str) -> None:
    """Add a field for each column that has another name than calib's: of joints by number or order, of positions."""
    has_list = bool(fields.value("points"))
    names = [split_header(label)[0] for label in table.header]
    labels = dict(zip(names, table.header, strict=True))
    options = plain(filter(None, table.header), "-")
    free = [name for name in names if name and name not in arm.joint_names]
    if not brand:
        missing = [name for name in arm.joint_names if name not in names]
        numbered: dict[int, str] = {}
        for name in free:
            match = _NUMBERED.fullmatch(name)
            if match is not None:
                numbered.setdefault(int(match[1]), name)
        for joint in missing:
            number = arm.joint_names.index(joint) + (0 if 0 in numbered else 1)
            found = labels.get(numbered.get(number, ""), "")
            fields.add(
                f"column:{joint}", found, options, "doubt_order" if found else "doubt_column"
            )
    folded = {name.casefold(): name for name in reversed(names)}
    if has_list or brand:
        return
    if folded.keys() >= set(POINT):
        _position_unit(fields, table, [labels[folded[axis]] for axis in POINT])
        return
    found_axes: dict[str, str] = {}
    for name in free:
        match = _COORDINATE.fullmatch(name)
        if match is not None:
            found_axes.setdefault(match[1].casefold(), name)
    if len(found_axes) != len(POINT):
        return  # another kind of measurement, or a message says what lacks
    for axis in POINT:
        fields.add(f"column:{axis}", labels[found_axes[axis]], options, "doubt_name")
    _position_unit(fields, table, [labels[found_axes[axis]] for axis in POINT])


def _position_unit(fields: Fields, table: Table, labels: Sequence[str]) -> None:
    """Add the field of the unit of positions whose headers name none, by their ending or their size."""
    if all(split_header(label)[1] for label in labels):
        return
    size = _largest(table, labels)
    match = _COORDINATE.fullmatch(split_header(labels[0])[0])
    written = match[2] if match is not None and match[2] and is_unit(match[2]) else ""
    guess = find_unit(written).symbol if written else ("m" if size < _MOST_METRES else "mm")
    doubt = "doubt_unit_name" if written else "doubt_unit_size"
    options = plain(symbols("length"))
    fields.add("position_unit", guess, options, doubt, size=f"{size:.4g}", unit=guess)
    for axis, label in zip(POINT, labels, strict=True):
        if f"column:{axis}" not in fields.made:
            fields.add(f"column:{axis}", label, plain([label]))


def _unit_fields(fields: Fields, table: Table, arm: Robot, folder: Path) -> None:
    """Add the unit of joints whose headers name none, and that of a list of points that names none."""
    columns = {split_header(label)[0]: label for label in table.header}
    used = []
    for joint in arm.joint_names:
        mapped = fields.made.get(f"column:{joint}")
        label = columns.get(joint, "") if mapped is None else mapped.value
        if label and split_header(label)[1] is None:
            used.append((joint, label))
    if used:
        turning = [label for joint, label in used if arm.joint_types[joint] != "prismatic"]
        sliding = [label for joint, label in used if arm.joint_types[joint] == "prismatic"]
        size = _largest(table, turning) if turning else 0.0
        guess = "rad" if size < _MOST_RADIANS else "deg"
        if sliding:
            length = "m" if _largest(table, sliding) < _MOST_METRES else "mm"
            guess = f"{guess} {length}" if turning else length
        both = [f"{a} {b}" for a in ("deg", "rad") for b in ("mm", "m")]
        units = both if turning and sliding else ["mm", "m"] if sliding else ["deg", "rad"]
        words = {"size": f"{size:.4g}", "unit": guess}
        fields.add("joint_unit", guess, plain(units), "doubt_unit_size", **words)
    listed = fields.value("points")
    if listed and "#" not in listed:
        try:
            read_points(folder / listed)
        except CalibError:
            fields.add("points_unit", "mm", plain(symbols("length")), "doubt_points_unit")


def _largest(table: Table, labels: Sequence[str]) -> float:
    """Return the largest number of some columns, by size; 0 if they hold none."""
    columns = [
        Column(table.header.index(label), label, label, None)
        for label in labels
        if label in table.header
    ]
    try:
        numbers = np.abs(table.numbers(columns))
    except CalibError:
        return 0.0
    finite = numbers[np.isfinite(numbers)]
    return float(finite.max()) if finite.size else 0.0
