"""Tables of poses in the ``kinematics`` YAML of several makers: one pose for each link or joint, by its name.

    kinematics:
      shoulder: {x: 0.0, y: 0.0, z: 0.1519, roll: 0.0, pitch: 0.0, yaw: 0.0}      # [m], [rad]

R = Rz(yaw) Ry(pitch) Rx(roll), as in the ``<origin>`` of a URDF. Dumps of ROS parameters have the same table below the
names of nodes and robots, and several of them if there are several robots. Its keys may be joined by points or slashes:

    /left/ur_hardware_interface/kinematics/shoulder/x: 0.0
    kinematics.shoulder.x: 0.0
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only
from calib.basics.units import NUMBER
from calib.errors import FileError, choices

PathLike = str | os.PathLike[str]

POSE_KEYS: Mapping[str, float] = dict.fromkeys("xyz", 10.0) | dict.fromkeys(
    ("roll", "pitch", "yaw"), 4.0 * np.pi
)
"""The numbers of a pose, in their order, and the largest of each on an arm [m], [rad]."""

#: Keys that say nothing of the robot.
_GENERIC = frozenset({"", "/", "**", "kinematics", "ros__parameters"})

#: Levels of tables in a file that are looked at.
_DEEPEST = 12

#: Longest text of a file that a message quotes.
_QUOTED = 40

#: A number, or a difference from the number that it replaces, below this is rounding [m and rad].
_ROUNDING = 1e-12


class KinematicsTable(NamedTuple):
    """One table of poses."""

    #: Keys that lead to it.
    where: tuple[str, ...]
    #: What it has by name: poses, and other things such as a hash.
    entries: Mapping[str, Any]

    @property
    def robot(self) -> str:
        """The keys on the way to it that may name its robot, with ``/`` between them; empty if there are none."""
        return "/".join(key for key in self.where if key not in _GENERIC)

    def has(self, name: str) -> bool:
        """Return True if there is a complete pose of this name."""
        return _is_pose(self.entries.get(name))

    def numbers(self, path: PathLike, name: str) -> Array:
        """Return the numbers of a pose, shape (6,) [m], [rad].

        Args:
            path: The file, for messages.
            name: The name of the pose, which the table has.

        Raises:
            FileError: A number is none, or too large for metres or radians.
        """
        pose = self.entries[name]
        where = {key: f"{path}: {key} of '{name}'" for key in POSE_KEYS}
        row = [robot_number(where[key], str(pose[key]), most) for key, most in POSE_KEYS.items()]
        return read_only(row)


def tables_in(content: Mapping[Any, Any]) -> tuple[KinematicsTable, ...]:
    """Return all tables with at least one pose in the content of a YAML file, in its order."""
    return tuple(_tables(_nested(content), ()))


def find_table(
    path: PathLike, content: Mapping[Any, Any], section: str | None
) -> KinematicsTable | None:
    """Return the table of one robot.

    Args:
        path: The file, for messages.
        content: The content of the file.
        section: A key on the way to the table, or several with ``/`` between them; None: the file has one table.

    Returns:
        The table; None if there is none.

    Raises:
        FileError: There are several tables, or none of this section.
    """
    tables = tables_in(content)
    fitting = tables
    if section is not None:
        names_none = len(tables) == 1 and not tables[0].robot
        if not names_none:
            wanted = section.strip("/")
            fitting = tuple(t for t in tables if wanted in (t.robot, "/".join(t.where), *t.where))
    if len(fitting) == 1 or not tables:
        return fitting[0] if fitting else None
    robots = choices((table.robot or "kinematics" for table in tables), 20)
    fault = f"no kinematics of '{section}'" if section is not None else "kinematics of several arms"
    raise FileError(
        f"{path}: it has {fault}; say which by --section, with one of {robots}, or a key that only one of them has."
    )


def names_in(content: Mapping[Any, Any]) -> tuple[str, ...]:
    """Return the names in all tables of a YAML file, by which its kind is told; none if it has no table."""
    return tuple(name for table in tables_in(content) for name in ("kinematics", *table.entries))


def pose_of(numbers: Array) -> Array:
    """Return the pose, shape (4, 4) [m], of six numbers x, y, z [m], roll, pitch, yaw [rad]."""
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*numbers[3:])
    T[:3, 3] = numbers[:3]
    return T


def pose_entry(T: Array, like: Array | None = None) -> dict[str, float]:
    """Return the entry of a pose, which reads back exactly except that rounding errors are written as 0.

    Args:
        T: The pose, shape (4, 4) [m].
        like: The numbers of the robot's own file, shape (6,): one that differs from it by rounding is written as that
            one, and if they are the same pose by other angles, they are kept. None: there is no such file.
    """
    numbers = np.array([*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3])])
    if like is not None and np.abs(pose_of(like) - T).max() < _ROUNDING:
        numbers = np.array(like)
    numbers = np.where(np.abs(numbers) < _ROUNDING, 0.0, numbers)
    if like is not None:
        numbers = np.where(np.abs(numbers - like) < _ROUNDING, like, numbers)
    return dict(zip(POSE_KEYS, numbers.tolist(), strict=True))


def robot_number(where: str, word: str, largest: float) -> float:
    """Read a number of a robot's file.

    Args:
        where: File and key, for the message.
        word: The number as written.
        largest: Its largest absolute value in metres or radians.

    Returns:
        The number [m or rad].

    Raises:
        FileError: It is not a number, or too large for metres or radians.
    """
    number = float(word) if NUMBER.fullmatch(word) else np.inf
    if not abs(number) <= largest:
        raise FileError(
            f"{where}: '{word[:_QUOTED]}' is not a number up to {largest:.4g}. Lengths are in metres, "
            "angles in radians."
        )
    return number


def _tables(content: Mapping[str, Any], where: tuple[str, ...]) -> Iterator[KinematicsTable]:
    """Yield the tables in a part of a file, whose keys are ``where``."""
    if any(map(_is_pose, content.values())):
        yield KinematicsTable(where, content)
        return
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _tables(value, (*where, key))


def _is_pose(value: object) -> bool:
    """Return True for a table with all numbers of a pose."""
    return isinstance(value, dict) and POSE_KEYS.keys() <= value.keys()


def _nested(content: Mapping[Any, Any], depth: int = 0) -> dict[str, Any]:
    """Return a table with its keys as texts, and those of a dump, which points or slashes join, taken apart.

    Tables at `_DEEPEST` and below are left out: an alias of YAML can name a table in itself.
    """
    result: dict[str, Any] = {}
    for key, value in content.items():
        name = str(key)
        is_dump = name.startswith("/") or not isinstance(value, dict)
        levels = [part for part in re.split(r"[./]", name) if part] if is_dump else [name]
        if isinstance(value, dict) and depth == _DEEPEST:
            continue
        inside = _nested(value, depth + 1) if isinstance(value, dict) else value
        _put(result, levels or [name], inside)
    return result


def _put(table: dict[str, Any], levels: list[str], value: object) -> None:
    """Put a value into a table below several keys; tables of the same keys are joined."""
    *outer, last = levels
    for key in outer:
        inner = table.setdefault(key, {})
        if not isinstance(inner, dict):  # a number that also has parts: no dump has this
            return
        table = inner
    held = table.get(last)
    if isinstance(held, dict) and isinstance(value, dict):
        for key, part in value.items():
            _put(held, [key], part)
    else:
        table[last] = value
