"""Measurements as the text of a CSV table, in degrees and millimetres."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.measure.columns import COMMON, POINT, QUATERNION, TORQUE
from calib.measure.orientation import to_quaternions
from calib.units import UNITS, Quantity

Array = NDArray[np.float64]


def table_text(
    words: Mapping[str, Sequence[object]],
    *,
    joints: Sequence[tuple[str, bool, Array]],
    torques: Array | None,
    points: Array | None,
    rotations: Array | None,
    readings: Mapping[str, tuple[Quantity, Array]],
    sigma: Array | None,
    sigma_angle: Array | None,
) -> str:
    """A table that `Measurements.read` gives back.

    Numbers come back to the last bit where they came from a table in these units, to 1e-15 of them where not, as for
    hardly any number of radians are there degrees that are it exactly. Orientations come back to 1e-15.

    Args:
        words: The columns of words, by their header.
        joints: Of each joint its name, whether it slides, and its values.
        torques: shape (n, N), NaN for joints without any.
        points: shape (N, 3).
        rotations: shape (N, 3, 3).
        readings: By name, each with what it measures.
        sigma: shape (N,).
        sigma_angle: shape (N,).
    """
    columns: dict[str, Sequence[object]] = dict(words)

    def add(name: str, quantity: Quantity | None, values: Array | None) -> None:
        """Add a column; its cells are empty where nothing was measured."""
        if values is None:
            return
        unit = "" if quantity is None else COMMON[quantity]
        written = (_in_unit(values, UNITS[unit].to_si) if unit else values).tolist()
        cells = ["" if math.isnan(number) else number for number in written]
        columns[f"{name} [{unit}]" if unit else name] = cells

    for i, (name, slides, values) in enumerate(joints):
        add(name, "length" if slides else "angle", values)
        if torques is not None and np.isfinite(torques[i]).all():
            add(name + TORQUE, "force" if slides else "torque", torques[i])
    for i, name in enumerate(POINT):
        add(name, "length", None if points is None else points[:, i])
    if rotations is not None:
        for name, part in zip(QUATERNION, to_quaternions(rotations).T, strict=True):
            add(name, None, part)
    for name, (quantity, values) in readings.items():
        add(name, quantity, values)
    add("sigma", "length", sigma)
    add("sigma_angle", "angle", sigma_angle)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))  # csv writes a float as its repr
    return text.getvalue()


def _in_unit(values: Array, to_si: float) -> Array:
    """The numbers that, times ``to_si``, are the values to the last bit where any are, else next to them."""
    found = values / to_si
    for end in (np.inf, -np.inf):
        beside = np.nextafter(found, end)
        better = (found * to_si != values) & (beside * to_si == values)
        found = np.where(better, beside, found)
    return found
