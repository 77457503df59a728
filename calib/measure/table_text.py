"""Measurements as the text of a CSV table, in degrees and millimetres."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.measure.columns import DEFAULT_TARGET, POINT, QUATERNION, TORQUE
from calib.measure.kinds import LENGTHS, POSITIONS
from calib.measure.orientation import to_quaternions
from calib.units import UNITS


class _Rows(Protocol):
    """What is written: fields of `Measurements`, which imports this module."""

    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def prismatic(self) -> tuple[str, ...]: ...
    @property
    def sets(self) -> tuple[str, ...]: ...
    @property
    def targets(self) -> tuple[str, ...]: ...
    @property
    def groups(self) -> tuple[str, ...]: ...
    @property
    def kinds(self) -> tuple[str, ...]: ...
    @property
    def pairs(self) -> tuple[str, ...]: ...
    @property
    def rows(self) -> tuple[int, ...]: ...
    @property
    def joints(self) -> NDArray[np.float64]: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def sigma(self) -> NDArray[np.float64] | None: ...
    @property
    def rotations(self) -> NDArray[np.float64] | None: ...
    @property
    def distances(self) -> NDArray[np.float64] | None: ...
    @property
    def sigma_angle(self) -> NDArray[np.float64] | None: ...
    @property
    def torques(self) -> NDArray[np.float64] | None: ...
    def of_kind(self, *kinds: str) -> NDArray[np.bool_]: ...
    def __len__(self) -> int: ...


def table_text(m: _Rows) -> str:
    """A table that `Measurements.read` gives back.

    Numbers come back to the last bit where they came from a table in these units, to 1e-15 of them where not, as for
    hardly any number of radians are there degrees that are it exactly. Orientations come back to 1e-15.
    """
    columns = {**_word_columns(m), **_number_columns(m)}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))  # csv writes a float as its repr
    return text.getvalue()


def _word_columns(m: _Rows) -> dict[str, Sequence[object]]:
    """The columns of words that are needed, by their header."""
    columns: dict[str, Sequence[object]] = {"row": m.rows, "set": m.sets}
    if len(set(m.kinds)) > 1 or not set(m.kinds) <= {*POSITIONS, *LENGTHS}:
        columns["kind"] = m.kinds
    if any(target != DEFAULT_TARGET for target in m.targets):
        columns["target"] = m.targets
    if any(m.groups):
        columns["group"] = m.groups
    if any(m.pairs):
        columns["pair"] = m.pairs
    return columns


def _number_columns(m: _Rows) -> dict[str, Sequence[object]]:
    """The columns of numbers that are needed, by their header."""
    found: list[tuple[str, str, NDArray[np.float64]]] = []  # name, unit, values
    for i, name in enumerate(m.joint_names):
        sliding = name in m.prismatic
        found.append((name, "mm" if sliding else "deg", m.joints[:, i]))
        if m.torques is not None and np.isfinite(m.torques[:, i]).all():
            found.append((name + TORQUE, "N" if sliding else "Nm", m.torques[:, i]))
    if m.of_kind(*POSITIONS).any() or not len(m):
        found += [(name, "mm", m.points[:, i]) for i, name in enumerate(POINT)]
    if m.rotations is not None:
        turned = to_quaternions(m.rotations)
        found += [(name, "", turned[:, i]) for i, name in enumerate(QUATERNION)]
    for name, unit, values in (
        ("distance", "mm", m.distances),
        ("sigma", "mm", m.sigma),
        ("sigma_angle", "deg", m.sigma_angle),
    ):
        if values is not None:
            found.append((name, unit, values))
    return dict(_written(*column) for column in found)


def _written(name: str, unit: str, values: NDArray[np.float64]) -> tuple[str, list[float | str]]:
    """The header and the cells of a column of numbers; cells are empty where nothing was measured."""
    numbers = (_in_unit(values, UNITS[unit].to_si) if unit else values).tolist()
    cells = ["" if math.isnan(number) else number for number in numbers]
    return (f"{name} [{unit}]" if unit else name), cells


def _in_unit(values: NDArray[np.float64], to_si: float) -> NDArray[np.float64]:
    """The numbers that, times ``to_si``, are the values to the last bit where any are, else next to them."""
    numbers = values / to_si
    for end in (np.inf, -np.inf):
        beside = np.nextafter(numbers, end)
        better = (numbers * to_si != values) & (beside * to_si == values)
        numbers = np.where(better, beside, numbers)
    return numbers
