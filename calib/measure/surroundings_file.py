"""The surroundings in a cell file: ``[tracker]``, ``[reflector]``, ``[[boxes]]`` and ``[ranges]``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calib.errors import CalibError
from calib.measure.cell_values import NAME, NOISE, NUMBER, POSITIVE, THREE, metres, pose
from calib.measure.noise import TrackerNoise, parse_noise
from calib.measure.quantities import parse_joint_value, parse_quantity
from calib.measure.surroundings import ACCEPTANCE, Box, Reflector, Tracker

#: The keys of each table, what their values must be, and whether they must be there.
INNER: dict[str, dict[str, tuple[str, bool]]] = {
    "tracker": {
        "xyz_mm": (THREE, True),
        "nearest_mm": (NUMBER, False),
        "farthest_mm": (NUMBER, False),
        "noise": (NOISE, False),
        "repeatability_mm": (NUMBER, False),
    },
    "reflector": {"normal": (THREE, True), "acceptance_deg": (POSITIVE, False)},
    "boxes": {
        "name": (NAME, True),
        "size_mm": (THREE, True),
        "xyz_mm": (THREE, True),
        "rpy_deg": (THREE, False),
    },
}


def read_tracker(table: Mapping[str, Any]) -> Tracker:
    """``[tracker]``, its keys and kinds checked.

    Raises:
        CalibError: A noise that cannot be read, or numbers that no tracker has.
    """
    noise = TrackerNoise()
    if "noise" in table:
        noise = parse_noise(table["noise"], "'noise' in [tracker]", noise.repeatability)
    if "repeatability_mm" in table:
        noise = replace(noise, repeatability=table["repeatability_mm"] / 1e3)
    distances = {
        name: table[f"{name}_mm"] / 1e3 for name in ("nearest", "farthest") if f"{name}_mm" in table
    }
    return Tracker(metres(table["xyz_mm"]), noise=noise, **distances)


def read_reflector(table: Mapping[str, Any]) -> Reflector:
    """``[reflector]``, its keys and kinds checked.

    Raises:
        CalibError: A normal without length, or a half angle above 180 deg.
    """
    acceptance = (
        float(np.radians(table["acceptance_deg"])) if "acceptance_deg" in table else ACCEPTANCE
    )
    return Reflector(np.asarray(table["normal"], dtype=np.float64), acceptance)


def read_boxes(tables: list[Mapping[str, Any]]) -> tuple[Box, ...]:
    """Each ``[[boxes]]``, its keys and kinds checked.

    Raises:
        CalibError: An edge that is not longer than 0, or a name twice.
    """
    return tuple(
        Box(t["name"], metres(t["size_mm"]), pose(t["xyz_mm"], t.get("rpy_deg"))) for t in tables
    )


def read_ranges(table: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """``[ranges]``: the least and the largest value of joints by name [rad] or [m].

    Raises:
        CalibError: Not two values of one quantity, with units of length or angle.
    """
    result = {}
    for name, value in table.items():
        where = f"'{name}' in [ranges]"
        if not isinstance(value, list) or len(value) != 2:
            message = (
                f'{where} is {value!r}; it must be the least and the largest value, such as ["-90 deg", "90 deg"] or '
                '["0 mm", "300 mm"].'
            )
            raise CalibError(message)
        result[name] = checked_range(value[0], value[1], where)
    return result


def checked_range(low: object, high: object, where: str) -> tuple[float, float]:
    """The least and the largest value of a joint, each with its unit beside it, [rad] or [m].

    Args:
        low: Such as ``"-90 deg"``.
        high: Such as ``"90 deg"``.
        where: Where they were given, for the message.

    Raises:
        CalibError: No value of a joint, or an angle and a length.
    """
    pair = parse_joint_value(low, where), parse_joint_value(high, where)
    if parse_quantity(low)[1] != parse_quantity(high)[1]:
        message = f"{where} is from {low!r} to {high!r}; one is an angle and one a length."
        raise CalibError(message)
    return pair
