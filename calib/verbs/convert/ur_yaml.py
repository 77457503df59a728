"""``kinematics.yaml`` of Universal Robots' ROS driver: the poses of six links, and the calibration's hash.

Under ``kinematics`` each link has x, y, z [m] and roll, pitch, yaw [rad], R = Rz(yaw) Ry(pitch) Rx(roll): the pose of
its joint in the link before it, the first in the controller's base, ``base_link_inertia``. Joints turn about z;
``tool0`` is the last one's frame.
"""

from __future__ import annotations

import os
import re

import numpy as np
import pinocchio as pin
import yaml

from calib.basics.arrays import Array, read_only
from calib.basics.files import read_bytes
from calib.errors import FileError, choices
from calib.robot.generated.universal_robots import LINKS
from calib.verbs.convert.origins import parse_yaml
from calib.verbs.convert.ur_conf import robot_number

PathLike = str | os.PathLike[str]

#: The numbers of a link, and the largest of each on an arm [m], [rad].
_LARGEST = dict.fromkeys("xyz", 10.0) | dict.fromkeys(("roll", "pitch", "yaw"), 4.0 * np.pi)

#: A number, or a difference from the number that it replaces, below this is rounding [m and rad].
_ROUNDING = 1e-12

#: What a hash consists of.
_HASH = re.compile(r"[\w.+-]+")

_WHAT = "kinematics.yaml"


def read_kinematics(path: PathLike, data: bytes | None = None) -> tuple[Array, str | None]:
    """Read the chain of a ``kinematics.yaml``.

    Args:
        path: The file, for messages if ``data`` is given.
        data: The bytes of a file that is not written yet; None: they are read from ``path``.

    Returns:
        Placements of the six joints and of the flange, shape (7, 4, 4) [m]; the hash, None where
        there is none.

    Raises:
        FileError: The file cannot be read, or has not these numbers.
    """
    numbers, hash = read_numbers(path, data)
    chain = np.tile(np.eye(4), (7, 1, 1))
    for (*xyz, roll, pitch, yaw), T in zip(numbers, chain, strict=False):
        T[:3, :3] = pin.rpy.rpyToMatrix(roll, pitch, yaw)
        T[:3, 3] = xyz
    return read_only(chain), hash


def read_numbers(path: PathLike, data: bytes | None = None) -> tuple[Array, str | None]:
    """Read the numbers of a ``kinematics.yaml`` as they stand in it.

    Args:
        path: The file, for messages if ``data`` is given.
        data: The bytes of a file that is not written yet; None: they are read from ``path``.

    Returns:
        x, y, z [m], roll, pitch and yaw [rad] of the six links, shape (6, 6); the hash, None where
        there is none.

    Raises:
        FileError: The file cannot be read, or has not these numbers.
    """
    content = read_bytes(path, _WHAT) if data is None else data
    links = parse_yaml(content, str(path), _WHAT).get("kinematics")
    if not isinstance(links, dict):
        links = {}
    numbers = []
    for link in LINKS:
        values = links.get(link)
        if not isinstance(values, dict) or not _LARGEST.keys() <= values.keys():
            raise FileError(
                f"{path}: under 'kinematics' there is no '{link}' with {choices(_LARGEST)}; a "
                f"kinematics.yaml has {choices(LINKS)}."
            )
        row = []
        for key, largest in _LARGEST.items():
            row.append(robot_number(f"{path}: {key} of '{link}'", str(values[key]), largest))
        numbers.append(row)
    hash = links.get("hash")
    return read_only(numbers), str(hash) if hash else None


def kinematics_bytes(chain: Array, hash: str, like: Array | None = None) -> bytes:
    """Return the bytes of a ``kinematics.yaml``.

    Its numbers read back exactly, but for rounding, which is written as 0.

    Args:
        chain: Placements, shape (7, 4, 4) [m], of which the first six are written.
        hash: The hash of the robot's own calibration.
        like: Numbers of the robot's own file, shape (6, 6) [m], [rad], see `read_numbers`: a number
            that differs from its own by rounding is written as it. None: there is no such file.

    Returns:
        The bytes of the file.

    Raises:
        FileError: The hash is not one.
    """
    if not _HASH.fullmatch(hash):
        raise FileError(
            f"The hash is '{hash[:40]}', not one such as 'calib_12788084448423163542'. Take the "
            "line from the robot's own kinematics.yaml or calibration.conf."
        )
    table: dict[str, object] = {}
    for i, (link, T) in enumerate(zip(LINKS, chain, strict=False)):
        values = np.array([*T[:3, 3], *pin.rpy.matrixToRpy(T[:3, :3])])
        values = np.where(np.abs(values) < _ROUNDING, 0.0, values)
        if like is not None:
            is_same = np.abs(values - like[i]) < _ROUNDING
            values = np.where(is_same, like[i], values)
        table[link] = dict(zip(_LARGEST, values.tolist(), strict=True))
    table["hash"] = hash
    text = yaml.safe_dump({"kinematics": table}, sort_keys=False)
    return f"# Lengths in m, angles in rad, R = Rz(yaw) Ry(pitch) Rx(roll).\n{text}".encode()
