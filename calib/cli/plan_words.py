"""From the words of ``calib plan`` to values: the ladder, the start, the noise, the poses taken."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.design.region import Region
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

#: The word for all joints at zero.
_HOME = "home"

#: The word for no ladder.
_NONE = "none"

#: A joint may stand beyond a limit by this, for rounding [rad or m].
_ROUNDING = 1e-4

#: Of a larger distance between meshes coal takes half a second a pose, where 0.1 m take 6 ms [m].
_LARGEST_CLEARANCE = 0.1


def parse_ladder(text: str | None) -> list[int] | None:
    """``--ladder``: numbers of poses such as ``10,15,20``; ``none`` is an empty list.

    Raises:
        CalibError: No whole numbers above 0.
    """
    if text is None:
        return None
    words = text.replace(",", " ").split()
    if words == [_NONE]:
        return []
    if not words or not all(re.fullmatch(r"[0-9]{1,9}", word) and int(word) for word in words):
        message = f'--ladder was given as "{text}"; it must be numbers of poses such as "10,15,20,30", or \'{_NONE}\'.'
        raise CalibError(message)
    return [int(word) for word in words]


def parse_start(texts: Iterable[str], robot: Robot) -> NDArray[np.float64] | None:
    """``--start``: ``home`` (all joints at zero), or ``JOINT=VALUE UNIT`` for those that are not at zero, shape (m,).

    Raises:
        CalibError: Other words, an unknown joint, or a value in a unit that does not fit it or beyond its limits.
    """
    from calib.cli.words import parse_held
    from calib.measure.quantities import ANGLE, LENGTH, parse_quantity

    given = [text for text in texts if text.strip() != _HOME]
    if not given:
        return _within_limits([0.0] * len(robot.joint_names), robot) if list(texts) else None
    values = parse_held(given, "--start")
    for text in given:
        name, _, value = (part.strip() for part in text.rpartition("="))
        if name not in robot.joint_names:
            message = (
                f"--start was given '{text}', and no joint '{name}' is planned for. These are: "
                f"{choices(robot.joint_names, limit=30)}."
            )
            raise CalibError(message)
        slides = robot.joint_types[name] == "prismatic"
        if parse_quantity(value)[1] != (LENGTH if slides else ANGLE):
            wanted = 'a length, such as "0.3 m"' if slides else 'an angle, such as "30 deg"'
            message = f"--start was given '{text}'; the value of '{name}' is {wanted}."
            raise CalibError(message)
    return _within_limits([values.get(name, 0.0) for name in robot.joint_names], robot)


def _within_limits(values: list[float], robot: Robot) -> NDArray[np.float64]:
    """Where the robot stands before, shape (m,), [rad] or [m].

    Raises:
        CalibError: A joint beyond its limits: no robot stands there.
    """
    from calib.measure.ranges import column_limits, range_text
    from calib.model.robot import read_only
    from calib.units import UNITS

    for name, value, limits in zip(robot.joint_names, values, column_limits(robot), strict=True):
        if not limits[0] - _ROUNDING <= value <= limits[1] + _ROUNDING:
            unit = UNITS["mm" if robot.joint_types[name] == "prismatic" else "deg"]
            message = (
                f"--start: '{name}' would stand at {value / unit.to_si:g} {unit.symbol}; its limits in the URDF are "
                f'{range_text(robot, name, limits)}. Say where it stands, --start "{name}=VALUE UNIT", or leave '
                "--start out."
            )
            raise CalibError(message)
    return read_only(values)


def parse_clearance(text: str) -> float:
    """``--clearance``, a length [m].

    Raises:
        CalibError: No length, below 0, or more than the distance between meshes can be asked for.
    """
    from calib.cli.simulate_words import parse_size

    clearance = parse_size(text, "--clearance")
    if clearance > _LARGEST_CLEARANCE:
        message = (
            f'--clearance was given as "{text}"; it must be {1e3 * _LARGEST_CLEARANCE:g} mm or less, for links of an '
            "arm pass each other closer than that. To keep more distance to a box make the box larger."
        )
        raise CalibError(message)
    return clearance


def parse_holder(text: str) -> float:
    """``--holder``, a radius above 0 [m].

    Raises:
        CalibError: No length, or not above 0.
    """
    from calib.cli.simulate_words import parse_size

    radius = parse_size(text, "--holder")
    if not radius > 0.0:
        message = f'--holder was given as "{text}"; it must be a radius above 0, such as "20 mm".'
        raise CalibError(message)
    return radius


def with_noise(cell: Cell, text: str | None) -> Cell:
    """The cell with ``--noise``: a tracker's by its distance, or one length for every pose.

    Raises:
        CalibError: Words that cannot be read, or a noise by distance without a tracker.
    """
    from dataclasses import replace

    from calib.measure.noise import parse_noise

    if text is None:
        return cell
    noise = parse_noise(text, "--noise")
    if cell.tracker is not None:
        own = replace(noise, repeatability=cell.tracker.noise.repeatability)
        return replace(cell, sigma=None, tracker=replace(cell.tracker, noise=own))
    if noise.per_length:
        message = (
            f'--noise was given as "{text}", which grows with the distance, and nothing says where the tracker stands; '
            'add --tracker "X Y Z UNIT", or give one length such as "0.05 mm".'
        )
        raise CalibError(message)
    return replace(cell, sigma=noise.constant)


def checked_columns(columns: dict[str, str], taken: Path | None) -> dict[str, str]:
    """Refuse names for the columns of a table that there is not.

    Raises:
        CalibError: There is none.
    """
    if columns and taken is None:
        message = "--columns renames the columns of a table of poses taken; name it with --taken."
        raise CalibError(message)
    return columns


def load_for_plan(robot: str, cell: Cell, taken: Path | None, columns: dict[str, str]) -> Robot:
    """The robot; a tip that was not named is chosen by the columns of the table taken, as ``calib fit`` does."""
    from calib.measure.table import Table
    from calib.model.robot import Robot
    from calib.units import split_header

    names = None
    if taken is not None:
        names = {split_header(label)[0] for label in Table.read(taken).header}
        names |= {split_header(wanted)[0] for wanted in columns.values()}
    return Robot.load(robot, cell.base, cell.tip, measured=names, held=cell.held)


def read_region(path: Path | None, robot: Robot, cell: Cell) -> tuple[Region | None, list[str]]:
    """The region of a file, and sentences on what of it does not quite fit the robot.

    Raises:
        CalibError: It cannot be read, or is another robot's.
    """
    from calib.design.region_file import RegionFile

    if path is None:
        return None, []
    file = RegionFile.read(path)
    target = next(iter(cell.targets.values()), cell.target)
    return file.region, list(file.check_fits(robot, target))
