"""From the words of a command line to what stands around the robot: tracker, reflector, boxes, ranges of joints."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from calib.cli.words import parse_point
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from calib.measure.cell import Cell
    from calib.measure.surroundings import Box, Reflector, Tracker

_NUMBER = r"[+-]?[\d.]+(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*([A-Za-z]*)\s*\.\.\s*({_NUMBER})\s*([A-Za-z]+)\s*")


def add_surroundings(
    cell: Cell,
    *,
    tracker: str | None = None,
    reflector: str | None = None,
    acceptance: str | None = None,
    boxes: Iterable[str] | None = None,
    ranges: Iterable[str] | None = None,
) -> Cell:
    """The cell with what the command line says of its surroundings on top of it.

    A tracker or a reflector that the cell has already is moved or turned and keeps the rest; boxes and ranges are
    added to the cell's, and win where a name is given in both.

    Raises:
        CalibError: Words that cannot be read, or an acceptance without a reflector.
    """
    from dataclasses import replace

    named = {box.name: box for box in cell.boxes}
    for box in parse_boxes(boxes or ()):
        named[box.name] = box
    facing = cell.reflector
    if reflector is not None:
        facing = parse_reflector(reflector, facing)
    if acceptance is not None:
        if facing is None:
            message = (
                "--acceptance was given without a reflector that has a direction; say where it faces in the tip, "
                'such as --reflector "0 0 1".'
            )
            raise CalibError(message)
        facing = replace(facing, acceptance=parse_acceptance(acceptance))
    return replace(
        cell,
        tracker=cell.tracker if tracker is None else parse_tracker(tracker, cell.tracker),
        reflector=facing,
        boxes=tuple(named.values()),
        ranges={**cell.ranges, **parse_ranges(ranges or ())},
    )


def parse_tracker(text: str, given: Tracker | None = None) -> Tracker:
    """``--tracker``: a position in the robot's base, such as ``2500 0 500 mm``.

    Args:
        text: The words.
        given: A tracker whose range and noise are kept.

    Raises:
        CalibError: No three numbers and a unit of length.
    """
    from dataclasses import replace

    from calib.measure.surroundings import Tracker

    position = parse_point(text, "--tracker")
    return Tracker(position) if given is None else replace(given, position=position)


def parse_reflector(text: str, given: Reflector | None = None) -> Reflector:
    """``--reflector``: the direction in the tip that the reflector faces, such as ``0 0 1``.

    Args:
        text: The words.
        given: A reflector whose acceptance is kept.

    Raises:
        CalibError: No three numbers, or all of them zero.
    """
    from dataclasses import replace

    from calib.measure.surroundings import Reflector
    from calib.model.robot import read_only

    numbers = _floats(text.replace(",", " ").split())
    if len(numbers) != 3 or not any(numbers):
        message = (
            f'--reflector was given as "{text}"; it must be a direction in the tip, three numbers without a unit, such '
            'as "0 0 1".'
        )
        raise CalibError(message)
    normal = read_only(numbers)
    return Reflector(normal) if given is None else replace(given, normal=normal)


def parse_acceptance(text: str) -> float:
    """``--acceptance``: the half angle of the cone that the reflector is seen in, such as ``30 deg`` [rad].

    Raises:
        CalibError: No angle above 0 and up to 180 deg with its unit.
    """
    from calib.measure.quantities import ANGLE, parse_quantity

    try:
        angle, kind = parse_quantity(text)
    except CalibError:
        angle, kind = math.nan, ""
    if kind != ANGLE or not 0.0 < angle <= math.pi:
        message = (
            f'--acceptance was given as "{text}"; it must be a half angle above 0 and at most 180 deg with its unit, '
            'such as "30 deg".'
        )
        raise CalibError(message)
    return angle


def parse_boxes(texts: Iterable[str]) -> tuple[Box, ...]:
    """Each ``--box``: ``NAME: X Y Z SX SY SZ UNIT``, centre in the robot's base and edges along its axes.

    Raises:
        CalibError: Words of another form, or a name twice.
    """
    import numpy as np

    from calib.measure.surroundings import Box, checked_boxes
    from calib.units import UNITS, symbols

    boxes = []
    for text in texts:
        name, _, rest = (part.strip() for part in text.rpartition(":"))
        # "40mm" is as clear as "40 mm".
        words = re.sub(r"(?<=[\d.])(?=[a-z]+\s*$)", " ", rest.replace(",", " ")).split()
        numbers = _floats(words[:6])
        if not name or len(words) != 7 or len(numbers) != 6 or min(numbers[3:]) <= 0.0:
            message = (
                f'--box was given as "{text}"; it must be a name, the centre x y z in the base, three edges above '
                '0, and a unit: "table: 0 0 -20 1200 800 40 mm".'
            )
            raise CalibError(message)
        if words[6] not in symbols("length"):
            message = (
                f"--box was given as \"{text}\"; '{words[6]}' is no unit of length. Choose one of "
                f"{choices(symbols('length'))}."
            )
            raise CalibError(message)
        metres = UNITS[words[6]].to_si * np.array(numbers)
        T = np.eye(4)
        T[:3, 3] = metres[:3]
        boxes.append(Box(name, metres[3:], T))
    return checked_boxes(boxes)


def parse_ranges(texts: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Each ``--range``: ``JOINT=LOW..HIGH UNIT``, such as ``elbow_joint=-90..90 deg`` [rad] or [m].

    Raises:
        CalibError: Words of another form, a joint twice, or a low end that is not below the high one.
    """
    from calib.measure.surroundings_file import checked_range

    ranges: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, _, rest = (part.strip() for part in text.rpartition("="))
        match = _RANGE.fullmatch(rest)
        if not name or match is None or name in ranges:
            message = (
                f'--range was given as "{text}"; it must be a joint, its least and its largest value and a unit, such '
                'as "elbow_joint=-90..90 deg", and each joint once.'
            )
            raise CalibError(message)
        low, high = f"{match[1]} {match[2] or match[4]}", f"{match[3]} {match[4]}"
        pair = checked_range(low, high, f'--range "{text}"')
        if not pair[0] < pair[1]:
            message = (
                f'--range was given as "{text}", where {low} is not less than {high}. Give the least value first; hold '
                "a joint that stays where it is (--hold)."
            )
            raise CalibError(message)
        ranges[name] = pair
    return ranges


def _floats(words: Iterable[str]) -> list[float]:
    """Finite numbers; none where one of the words is no number."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []
