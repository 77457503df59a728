"""The result as JSON: SI units, the unit in each key's suffix, versioned by ``schema``. See docs/result-json.md.

The file holds what is needed to use the result again: the corrected joint origins, the target and the measurement
frame. Numbers that do not exist (the error of no rows) are null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.errors import FileError
from calib.identify.result import Calibration
from calib.identify.result_tables import SCHEMA, evaluation_table, result_table
from calib.model.files import read_bytes, write_atomically
from calib.model.robot import Robot, read_only

__all__ = [
    "StoredResult",
    "evaluation_table",
    "read_result",
    "result_table",
    "write_result",
    "write_table",
]

Array = NDArray[np.float64]

_LARGEST_BYTES = 500_000_000


@dataclass(frozen=True, slots=True, eq=False)
class StoredResult:
    """What a result file says of robot and set-up.

    Attributes:
        base: Base link.
        tip: Tip link.
        T_frame_base: shape (4, 4), [m].
        target: shape (3,), in the tip [m].
        origins: Corrected ``<origin>`` of each joint that carries a placement of the chain, shape (4, 4), [m].
    """

    base: str
    tip: str
    T_frame_base: Array
    target: Array
    origins: Mapping[str, Array]

    def corrected(self, robot: Robot) -> Robot:
        """A robot with this result's origins; the same robot where it has them already.

        Raises:
            UrdfError: The robot lacks one of the joints.
        """
        return robot.rebuilt(robot.urdf.with_origins(self.origins), self.base, self.tip)


def write_result(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a calibration as JSON.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_table(result_table(calibration), path, overwrite=overwrite)


def write_table(table: Mapping[str, Any], path: str | Path, *, overwrite: bool = False) -> Path:
    """Write nested tables of plain values and arrays as JSON, missing numbers as null.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    text = json.dumps(_clean(table), indent=1, allow_nan=False, ensure_ascii=False)
    return write_atomically(Path(path), (text + "\n").encode(), overwrite=overwrite)


def read_result(path: str | Path) -> StoredResult:
    """Read what a result file says of robot and set-up.

    Raises:
        FileError: It cannot be read, is no JSON, no result of calib, or of a newer schema.
    """
    data = read_bytes(Path(path), "calibration result", _LARGEST_BYTES)
    try:
        table = json.loads(data)
    except (ValueError, RecursionError) as error:
        message = f"{path}: this is not a JSON file: {error}"
        raise FileError(message) from error
    schema = table.get("schema") if isinstance(table, dict) else None
    if schema != SCHEMA:
        message = (
            f"{path}: its 'schema' is {schema!r}; a result of calib {calib.__version__} has {SCHEMA}. Give the file "
            "that 'calib fit --json' wrote, by the same version."
        )
        raise FileError(message)
    try:
        robot, frames = table["robot"], table["frames"]
        return StoredResult(
            base=str(robot["base"]),
            tip=str(robot["tip"]),
            T_frame_base=_pose(frames["frame_base_xyz_m"], frames["frame_base_rpy_rad"]),
            target=_numbers(frames["target_m"]),
            origins={o["joint"]: _pose(o["xyz_m"], o["rpy_rad"]) for o in robot["origins"]},
        )
    except (KeyError, TypeError, ValueError) as error:
        message = (
            f"{path}: the result is incomplete or damaged ({error!r}). Write it again with "
            "'calib fit --json'."
        )
        raise FileError(message) from error


def _pose(xyz: Any, rpy: Any) -> Array:  # noqa: ANN401  JSON values are of any kind
    """A pose from its JSON form."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", _numbers(rpy)).as_matrix()
    T[:3, 3] = _numbers(xyz)
    return read_only(T)


def _numbers(value: Any) -> Array:  # noqa: ANN401
    """Three finite numbers of a JSON file."""
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)):
        message = f"three finite numbers expected, {value!r} found"
        raise ValueError(message)
    return read_only(numbers)


def _clean(value: Any) -> Any:  # noqa: ANN401
    """Arrays as lists, numbers that do not exist as null."""
    if isinstance(value, Mapping):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return _clean(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_clean(entry) for entry in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
