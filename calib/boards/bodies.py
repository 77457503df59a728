"""Tags on bodies that are not flat, such as the faces of a cube: their corners in the frame of the body.

A tag is described by its four corners, clockwise from the top left as OpenCV has it; or by the pose of its middle, with
x to the right on it, y down and z into it, and its side s, so that its corners are

    p + R (-+ s/2, -+ s/2, 0)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.units import is_number
from calib.basics.value_forms import Form, Place
from calib.errors import CalibError

#: A tag: its id, and its corners [m].
Tag = tuple[int, tuple[tuple[float, float, float], ...]]

#: Keys of a tag that is described by its pose.
_POSE = ("id", "xyz_mm", "rpy_deg", "side_mm")

#: Largest distance of a tag's corners from a square, in its side: another is a mistake in the numbers.
_SQUARE = 0.05

_WORDS = (
    "a list of tags, each [ID, [X, Y, Z], [X, Y, Z], [X, Y, Z], [X, Y, Z]] with its corners clockwise from the top "
    "left [mm], or { id = ID, xyz_mm = [X, Y, Z], rpy_deg = [R, P, Y], side_mm = S } with the pose of its middle"
)


def tag_of_corners(number: int, corners: Array) -> Tag:
    """Return a tag of its id and its corners, shape (4, 3) [m].

    Raises:
        CalibError: The corners are not those of a square.
    """
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1) / np.sqrt(2.0)
    lengths = np.concatenate([sides, diagonals])
    side = float(lengths.mean())
    if side <= 0.0 or np.ptp(lengths) > _SQUARE * side:
        written = ", ".join(f"{1e3 * length:.4g}" for length in sides)
        raise CalibError(
            f"the corners of the tag {number} are not those of a square: its sides are {written} mm. They are listed "
            "clockwise from the top left."
        )
    return number, tuple((float(x), float(y), float(z)) for x, y, z in corners)


def tag_at(number: int, position: Array, rpy: Array, side: float) -> Tag:
    """Return a tag of its id, the position of its middle (3,) [m], its roll, pitch and yaw (3,) [rad] and its side [m].

    The angles are those of URDF: about the fixed x, then y, then z axis of the body.
    """
    flat = (
        0.5
        * side
        * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    )
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    return tag_of_corners(number, position + flat @ R.T)


def _read(value: Any, place: Place) -> tuple[Tag, ...]:  # noqa: ANN401
    """Read the tags of a file; CalibError names the one that is wrong."""
    if not isinstance(value, list) or not value:
        raise CalibError(f"{place} is {value!r}; it must be {_WORDS}.")
    tags = []
    for k, entry in enumerate(value, 1):
        try:
            tags.append(_tag(entry))
        except (TypeError, ValueError, KeyError):  # noqa: PERF203  the entry is named
            raise CalibError(f"entry {k} of {place} is {entry!r}; it must be {_WORDS}.") from None
        except CalibError as error:
            raise CalibError(f"entry {k} of {place}: {error}") from None
    return tuple(tags)


def _tag(entry: Any) -> Tag:  # noqa: ANN401
    """Read one tag; ValueError, TypeError or KeyError if it is none."""
    if isinstance(entry, Mapping):
        if set(entry) != set(_POSE):
            raise ValueError
        number, side = entry["id"], entry["side_mm"]
        position, rpy = _points([entry["xyz_mm"], entry["rpy_deg"]])
        if not is_number(side) or not side > 0.0:
            raise ValueError
        return tag_at(_whole(number), position / 1e3, np.radians(rpy), side / 1e3)
    number, *corners = entry
    if len(corners) != 4:
        raise ValueError
    return tag_of_corners(_whole(number), _points(corners) / 1e3)


def _whole(value: Any) -> int:  # noqa: ANN401
    """Return an id; ValueError if it is not a whole number from 0."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError
    return value


def _points(lists: list[Any]) -> Array:
    """Return lists of three numbers as an array (n, 3); ValueError for other lists."""
    if not all(len(point) == 3 and all(map(is_number, point)) for point in lists):
        raise ValueError
    return np.array(lists, dtype=np.float64)


def _write(tags: tuple[Tag, ...]) -> list[Any]:
    """Return tags as a file has them, in millimetres."""
    written: list[Any] = []
    for number, corners in tags:
        in_mm = [[float(f"{1e3 * value:.12g}") for value in corner] for corner in corners]
        written.append([number, *in_mm])
    return written


#: The form of the tags of a body.
TAGS_OF_BODY = Form(_WORDS, _read, _write)
