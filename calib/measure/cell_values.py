"""What the values of a cell file may be, as its messages say it, and what lengths and angles become in SI units."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.measure.cell_parts import is_number, is_positive

NAME = "a name in quotes"
NUMBER = "a number"
POSITIVE = "a positive number"
THREE = "three numbers"
TABLE = "a table"
NOISE = 'a text such as "15 um + 6 um/m"'
TABLES = "a list of tables, each headed "


def fits(value: Any, kind: str) -> bool:  # noqa: ANN401  TOML values are of any kind
    """Whether a TOML value is of the kind that its key wants: one of the above, or the allowed words in quotes."""
    if kind == NUMBER:
        return is_number(value)
    if kind == POSITIVE:
        return is_positive(value)
    if kind == THREE:
        return isinstance(value, list) and len(value) == 3 and all(is_number(v) for v in value)
    if kind == TABLE:
        return isinstance(value, dict)
    if kind.startswith(TABLES):
        return isinstance(value, list) and all(isinstance(v, dict) for v in value)
    if isinstance(value, list):
        return all(isinstance(v, str) for v in value) and "list of" in kind
    if kind in (NAME, NOISE):
        return isinstance(value, str)
    return isinstance(value, str) and f"'{value}'" in kind


def metres(value: list[float]) -> NDArray[np.float64]:
    """Three numbers in mm, shape (3,), [m]."""
    return np.asarray(value, dtype=np.float64) / 1e3


def rotation(rpy: list[float]) -> NDArray[np.float64]:
    """Roll, pitch, yaw about fixed axes [deg] as a matrix, shape (3, 3)."""
    return np.asarray(Rotation.from_euler("xyz", np.radians(rpy)).as_matrix())


def pose(xyz: list[float] | None, rpy: list[float] | None) -> NDArray[np.float64]:
    """A pose, shape (4, 4), from [mm] and [deg]; what is left out is zero."""
    T = np.eye(4)
    T[:3, :3] = np.eye(3) if rpy is None else rotation(rpy)
    T[:3, 3] = 0.0 if xyz is None else metres(xyz)
    return T
