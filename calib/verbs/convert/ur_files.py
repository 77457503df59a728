"""Files of Universal Robots: ``calibration.conf`` and ``urcontrol.conf`` of a controller, ``kinematics.yaml`` for ROS.

``calibration.conf`` has the deltas of an arm in ``[mounting]``, ``urcontrol.conf`` its nominal rows in ``[DH]``: lists
``key = [six numbers]``, in metres and radians.

``kinematics.yaml`` of the ROS driver has the poses of six links under ``kinematics``, and the calibration's hash. Each
link has x, y, z [m] and roll, pitch, yaw [rad], R = Rz(yaw) Ry(pitch) Rx(roll): the pose of its joint in the previous
link, the first in the controller's base, ``base_link_inertia``. Joints turn about z; ``tool0`` is the last one's frame.
"""

from __future__ import annotations

import configparser
import os
import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import yaml

from calib.basics.arrays import Array, read_only
from calib.basics.files import read_bytes
from calib.errors import FileError, choices
from calib.robot.ur_models import COLUMNS, LINKS
from calib.verbs.convert.format import parse_yaml
from calib.verbs.convert.kinematics_tables import (
    POSE_KEYS,
    find_table,
    pose_entry,
    pose_of,
    robot_number,
)

PathLike = str | os.PathLike[str]

#: Keys of the deltas, one for each column of the rows.
_DELTAS = tuple(f"delta_{name}" for name in COLUMNS)

#: Largest deltas that are in metres and radians [rad], [m]. Between nearly parallel axes d is huge, and so is theta.
_LARGEST_DELTA = dict(zip(_DELTAS, (8.0 * np.pi, 10.0, 1e9, 0.5), strict=True))

#: Largest nominal numbers of an arm in metres and radians [rad], [m].
_LARGEST_NOMINAL = dict(zip(COLUMNS, (2.0 * np.pi, 10.0, 10.0, 2.0 * np.pi), strict=True))

#: The ``calibration_status`` of deltas that the controller uses.
LINEARISED = "2"

#: Longest text of a file that a message quotes.
_QUOTED = 40

#: Pattern of a hash.
_HASH = re.compile(r"[\w.+-]+")

_YAML = "kinematics.yaml"


# calibration.conf and urcontrol.conf


class Conf(NamedTuple):
    """A ``calibration.conf``."""

    #: Shape (6, 4), ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha`` [rad], [m].
    deltas: Array
    #: The other keys of ``[mounting]``, such as ``joint_checksum``.
    others: tuple[str, ...]
    #: Its ``calibration_status``, see `LINEARISED`.
    status: str
    #: The whole file, a character for each byte.
    text: str

    @classmethod
    def read(cls, path: PathLike, data: bytes | None = None) -> Conf:
        """Read a ``calibration.conf``.

        Args:
            path: The file, for messages if ``data`` is given.
            data: The bytes of a file that is not written yet; None: they are read from ``path``.

        Returns:
            Its deltas, (6, 4) [rad], [m], its status, and the rest of the file.

        Raises:
            FileError: The file cannot be read, or lacks these numbers.
        """
        content = read_bytes(path, "calibration.conf") if data is None else data
        text = content.decode("latin-1")
        values = _section(path, text, "mounting")
        others = tuple(key for key in values if key not in _DELTAS)
        deltas = _columns(path, values, _LARGEST_DELTA)
        status = values.get("calibration_status", LINEARISED)
        return cls(deltas, others, status, text)

    def with_deltas(self, deltas: Array) -> bytes:
        """Return the bytes of the file with other deltas, (6, 4) [rad], [m], and all else as it was."""
        text = self.text
        for key, old, new in zip(_DELTAS, self.deltas.T, deltas.T, strict=True):
            if (old != new).any():  # else it stays, digit for digit
                text = re.sub(rf"(?m)^(\s*{key}\s*=\s*)\[[^\]]*\]", rf"\g<1>{_list(new)}", text)
        return text.encode("latin-1")


def conf_bytes(deltas: Array) -> bytes:
    """Return the bytes of a ``calibration.conf`` with nothing but deltas, shape (6, 4) [rad], [m]."""
    lines = [f"{key} = {_list(values)}" for key, values in zip(_DELTAS, deltas.T, strict=True)]
    return "\n".join(["[mounting]", *lines, ""]).encode()


def _list(values: Array) -> str:
    """Return six numbers in brackets that read back exactly."""
    return "[ " + ", ".join(repr(float(value) + 0.0) for value in values) + "]"


def read_nominal(path: PathLike) -> Array:
    """Read the nominal DH rows of a ``urcontrol.conf``.

    Args:
        path: The file, with ``a``, ``d``, ``alpha`` and perhaps ``theta`` in ``[DH]``.

    Returns:
        theta (0 if it is not given), a, d, alpha, shape (6, 4), [rad] and [m].

    Raises:
        FileError: The file cannot be read, or lacks these numbers.
    """
    text = read_bytes(path, "urcontrol.conf").decode("latin-1")
    values = {"theta": "0, 0, 0, 0, 0, 0", **_section(path, text, "DH")}
    return _columns(path, values, _LARGEST_NOMINAL)


def _section(path: PathLike, text: str, name: str) -> dict[str, str]:
    """Return the values of a section by key, as texts; the section may be in several parts of the file, or in none.

    A file that does not have the form of sections raises `FileError`.
    """
    parser = configparser.ConfigParser(
        strict=False, interpolation=None, inline_comment_prefixes=("#", ";"), default_section=""
    )
    try:
        parser.read_string(text)
    except configparser.Error as error:
        reason = " ".join(str(error).split())
        raise FileError(f"{path} cannot be read as sections of keys: {reason}") from error
    return dict(parser[name]) if parser.has_section(name) else {}


def _columns(path: PathLike, values: Mapping[str, str], largest: Mapping[str, float]) -> Array:
    """Return the lists of six numbers that are the values of the keys of ``largest``, as columns of an array (6, keys).

    Numbers are in m and rad. If a key has no such list, or a number is larger than ``largest`` allows, it raises
    `FileError`.
    """
    columns = []
    for key, most in largest.items():
        words = values.get(key, "").strip("[] ").split(",")
        if len(words) != 6:
            raise FileError(
                f"{path}: {key} is not a list of six numbers in brackets, one for each joint; the file must have "
                f"{choices(largest)}."
            )
        where = f"{path}: {key}"
        columns.append([robot_number(where, word.strip(), most) for word in words])
    return read_only(np.transpose(columns))


# kinematics.yaml


class KinematicsYaml(NamedTuple):
    """A ``kinematics.yaml``."""

    #: x, y, z [m], roll, pitch and yaw [rad] of the six links, shape (6, 6).
    numbers: Array
    #: The hash; None if there is none.
    hash: str | None

    @classmethod
    def read(
        cls, path: PathLike, data: bytes | None = None, section: str | None = None
    ) -> KinematicsYaml:
        """Read a ``kinematics.yaml``, or the dump of parameters that have the same table.

        Args:
            path: The file, for messages if ``data`` is given.
            data: The bytes of a file that is not written yet; None: they are read from ``path``.
            section: Which of several robots, see `find_table`; None: the file has one.

        Returns:
            Its numbers as they are in the file, and the hash.

        Raises:
            FileError: The file cannot be read, lacks these numbers, or has those of several robots.
        """
        content = read_bytes(path, _YAML) if data is None else data
        table = find_table(path, parse_yaml(content, str(path), _YAML), section)
        for link in LINKS:
            if table is None or not table.has(link):
                raise FileError(
                    f"{path}: under 'kinematics' there is no '{link}' with {choices(POSE_KEYS)}; a "
                    f"kinematics.yaml has {choices(LINKS)}."
                )
        assert table is not None  # LINKS is not empty
        hash = table.entries.get("hash")
        numbers = [table.numbers(path, link) for link in LINKS]
        return cls(read_only(numbers), str(hash) if hash else None)

    @property
    def chain(self) -> Array:
        """Placements of the six joints and of the flange, shape (7, 4, 4) [m]; that of the flange is the identity."""
        return read_only([*map(pose_of, self.numbers), np.eye(4)])


def kinematics_bytes(chain: Array, hash: str, like: KinematicsYaml | None = None) -> bytes:
    """Return the bytes of a ``kinematics.yaml``.

    Its numbers read back exactly, except that rounding errors are written as 0.

    Args:
        chain: Placements, shape (7, 4, 4) [m]; the first six are written.
        hash: The hash of the robot's own calibration.
        like: The robot's own file: a number that differs from its number by rounding is written as that one. None:
            there is no such file.

    Returns:
        The bytes of the file.

    Raises:
        FileError: The hash is malformed.
    """
    if not _HASH.fullmatch(hash):
        raise FileError(
            f"The hash is '{hash[:_QUOTED]}', not one such as 'calib_12788084448423163542'. Take the "
            "line from the robot's own kinematics.yaml or calibration.conf."
        )
    table: dict[str, object] = {}
    for i, (link, T) in enumerate(zip(LINKS, chain, strict=False)):
        table[link] = pose_entry(T, None if like is None else like.numbers[i])
    table["hash"] = hash
    text = yaml.safe_dump({"kinematics": table}, sort_keys=False)
    return f"# Lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll).\n{text}".encode()
