"""From the words of a command line to the cell about a robot: tracker and noise, reflector, boxes, ranges, start."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from calib.cli.setup import parse_point
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.data.cell import Cell
    from calib.data.surroundings import Box, Reflector, Tracker
    from calib.robot.robot import Robot

#: A joint may stand beyond a limit by this, for rounding [rad or m].
_ROUNDING = 1e-4

_NUMBER = r"[+-]?[\d.]+(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*([A-Za-z]*)\s*\.\.\s*({_NUMBER})\s*([A-Za-z]+)\s*")


def add_surroundings(
    cell: Cell,
    *,
    tracker: str | None = None,
    reflector: str | None = None,
    boxes: Iterable[str] = (),
    ranges: Iterable[str] = (),
    noise: str | None = None,
) -> Cell:
    """The cell with what the command line says of its surroundings on top of it.

    A tracker or a reflector that the cell has already is moved or turned and keeps the rest; boxes and ranges are
    added to the cell's, and win where a name is given in both. A noise is a tracker's by its distance, or one length
    for every pose.

    Raises:
        CalibError: Words that cannot be read, or a noise by distance without a tracker.
    """
    from calib.data.surroundings import parse_noise

    named = {box.name: box for box in (*cell.boxes, *parse_boxes(boxes))}
    said: dict[str, Any] = {"boxes": tuple(named.values())}
    said["ranges"] = {**cell.ranges, **parse_ranges(ranges)}
    if reflector is not None:
        said["reflector"] = parse_reflector(reflector, cell.reflector)
    seen = cell.tracker if tracker is None else parse_tracker(tracker, cell.tracker)
    found = None if noise is None else parse_noise(noise, "--noise")
    if found is not None and seen is not None:
        own = replace(found, repeatability=seen.noise.repeatability)
        seen, said["sigma"] = replace(seen, noise=own), None
    elif found is not None and found.per_length:
        raise CalibError(
            f'--noise was given as "{noise}", which grows with the distance, and nothing says where the tracker '
            'stands; add --tracker "X Y Z UNIT", or give one length such as "0.05 mm".'
        )
    elif found is not None:
        said["sigma"] = found.constant
    return replace(cell, tracker=seen, **said)


def parse_tracker(text: str, given: Tracker | None = None) -> Tracker:
    """``--tracker``: a position in the robot's base, such as ``2500 0 500 mm``; the rest is the given one's."""
    from calib.data.surroundings import Tracker

    position = parse_point(text, "--tracker")
    return Tracker(position) if given is None else replace(given, position=position)


def parse_reflector(text: str, given: Reflector | None = None) -> Reflector:
    """``--reflector``: the direction in the tip that it faces, such as ``0 0 1``; the rest is the given one's."""
    from calib.data.surroundings import Reflector
    from calib.robot.robot import read_only

    numbers = _floats(text.replace(",", " ").split())
    if len(numbers) != 3 or not any(numbers):
        raise CalibError(
            f'--reflector was given as "{text}"; it must be a direction in the tip, three numbers without a unit, such '
            'as "0 0 1".'
        )
    normal = read_only(numbers)
    return Reflector(normal) if given is None else replace(given, normal=normal)


def parse_boxes(texts: Iterable[str]) -> tuple[Box, ...]:
    """Each ``--box``: ``NAME: X Y Z SX SY SZ UNIT``, centre in the robot's base and edges along its axes."""
    import numpy as np

    from calib.data.surroundings import Box, checked_boxes
    from calib.units import UNITS, symbols

    boxes = []
    for text in texts:
        name, _, rest = (part.strip() for part in text.rpartition(":"))
        # "40mm" is as clear as "40 mm".
        words = re.sub(r"(?<=[\d.])(?=[a-z]+\s*$)", " ", rest.replace(",", " ")).split()
        numbers, units = _floats(words[:6]), symbols("length")
        known = len(words) == 7 and words[6] in units
        if not name or not known or len(numbers) != 6 or min(numbers[3:]) <= 0.0:
            raise CalibError(
                f'--box was given as "{text}"; it must be a name, the centre x y z in the base, three edges above '
                f'0, and a unit of length: "table: 0 0 -20 1200 800 40 mm". The units are {choices(units)}.'
            )
        metres = UNITS[words[6]].to_si * np.array(numbers)
        T = np.eye(4)
        T[:3, 3] = metres[:3]
        boxes.append(Box(name, metres[3:], T))
    return checked_boxes(boxes)


def parse_ranges(texts: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Each ``--range``: ``JOINT=LOW..HIGH UNIT``, such as ``elbow_joint=-90..90 deg`` [rad] or [m]."""
    from calib.units import parse_joint_range

    ranges: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, _, rest = (part.strip() for part in text.rpartition("="))
        match = _RANGE.fullmatch(rest)
        if not name or match is None or name in ranges:
            raise CalibError(
                f'--range was given as "{text}"; it must be a joint, its least and its largest value and a unit, such '
                'as "elbow_joint=-90..90 deg", and each joint once.'
            )
        low, high = f"{match[1]} {match[2] or match[4]}", f"{match[3]} {match[4]}"
        ranges[name] = parse_joint_range((low, high), f'--range "{text}"')
    return ranges


def parse_start(texts: Iterable[str], robot: Robot) -> NDArray[np.float64] | None:
    """``--start``: ``home`` (all joints at zero), or ``JOINT=VALUE UNIT`` for those that are not, shape (m,)."""
    from calib.cli.setup import parse_held
    from calib.compensation.inverse import start_values
    from calib.data.ranges import column_limits, range_text

    said = list(texts)
    if not said:
        return None
    named = parse_held((text for text in said if text.strip() != "home"), "--start")
    start = start_values(robot, named, others=0.0)
    for name, value, limits in zip(robot.joint_names, start, column_limits(robot), strict=True):
        if not limits[0] - _ROUNDING <= value <= limits[1] + _ROUNDING:
            raise CalibError(
                f"--start: '{name}' would stand beyond its limits in the URDF, {range_text(robot, name, limits)}. Say "
                f'where it stands, --start "{name}=VALUE UNIT", or leave --start out.'
            )
    return start


def _floats(words: Iterable[str]) -> list[float]:
    """Finite numbers; none where one of the words is no number."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []
