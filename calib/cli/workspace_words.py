"""From the words of ``calib workspace`` to values: a box in space, a voxel, margins of joints."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from calib.errors import CalibError, choices

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from calib.model.robot import Robot

_EXAMPLE = '"-600 -600 0 to 600 0 900 mm"'


def parse_within(text: str) -> NDArray[np.float64]:
    """``--within``: ``X Y Z to X Y Z UNIT``, two corners of a box, as shape (2, 3), [m].

    Raises:
        CalibError: Words of another form, or a second corner that is not greater along each axis.
    """
    from calib.cli.words import parse_point
    from calib.design.region import checked_box

    first, to, second = text.partition(" to ")
    unit = re.search(r"[A-Za-zµμ]+\s*$", second)
    if not to or unit is None:
        message = (
            f'--within was given as "{text}"; it must be two corners in the base frame and a unit, such as '
            f"{_EXAMPLE}."
        )
        raise CalibError(message)
    own_unit = re.search(r"[A-Za-zµμ]+\s*$", first)
    corners = [
        parse_point(first if own_unit else f"{first} {unit[0]}", "the first corner of --within"),
        parse_point(second, "the second corner of --within"),
    ]
    for axis, low, high in zip("xyz", *corners, strict=True):
        if not low < high:
            message = (
                f'--within was given as "{text}", whose {axis} goes from {1e3 * low:g} to {1e3 * high:g} mm; give the '
                f"corner with the smaller numbers first, such as {_EXAMPLE}."
            )
            raise CalibError(message)
    return checked_box(corners)


def parse_voxel(text: str) -> float:
    """``--voxel``: a length, such as ``20 mm`` [m].

    Raises:
        CalibError: No length greater than 0.
    """
    from calib.measure.quantities import LENGTH

    length, kind = _quantity(text, "--voxel", '"20 mm"')
    if kind != LENGTH or not length > 0.0:
        message = (
            f'--voxel was given as "{text}"; it must be a length greater than 0, such as "20 mm".'
        )
        raise CalibError(message)
    return length


def parse_margins(texts: Iterable[str], robot: Robot) -> NDArray[np.float64]:
    """``--margin``: an angle for joints that turn, a length for those that slide; shape (m,), [rad] or [m].

    Raises:
        CalibError: Another quantity, one below 0, or the same quantity twice.
    """
    import numpy as np

    from calib.measure.quantities import ANGLE, LENGTH

    found: dict[str, float] = {}
    for text in texts:
        value, kind = _quantity(text, "--margin", '"5 deg"')
        if kind not in (ANGLE, LENGTH) or value < 0.0 or kind in found:
            message = (
                f'--margin was given as "{text}"; it must be an angle, such as "5 deg", and may be given once more as '
                'a length for joints that slide, such as "10 mm"; none below 0.'
            )
            raise CalibError(message)
        found[kind] = value
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    for kind, used in ((ANGLE, not all(slides)), (LENGTH, any(slides))):
        if kind in found and not used:
            joints = choices(robot.joint_names)
            message = (
                f"--margin was given as {kind}, and none of the joints {joints} is measured in one."
            )
            raise CalibError(message)
    return np.where(slides, found.get(LENGTH, 0.0), found.get(ANGLE, 0.0))


def _quantity(text: str, option: str, example: str) -> tuple[float, str]:
    """A number with its unit, and its quantity."""
    from calib.measure.quantities import parse_quantity

    try:
        return parse_quantity(text)
    except CalibError as error:
        message = f"{option}: {error}; write {example}."
        raise CalibError(message) from error
