"""The result as JSON: SI units, the unit in each key's suffix, versioned by ``schema``. See docs/result-json.md.

The file holds what is needed to use the result again: joint origins, targets, measurement frames, held joints and the
larger model. Numbers that do not exist (the error of no rows) are null.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, FileError
from calib.identify.certainty import Certainty, certainty_of
from calib.identify.evaluation import Known
from calib.identify.result import Calibration
from calib.identify.result_tables import SCHEMA, evaluation_table, result_table
from calib.identify.stored import StoredLarger, StoredResult
from calib.model.files import write_atomically
from calib.model.json_file import damage, json_bytes, read_json
from calib.model.robot import read_only
from calib.model.torques import Payload
from calib.version import __version__

__all__ = [
    "StoredResult",
    "evaluation_table",
    "read_result",
    "read_table",
    "result_table",
    "stored_result",
    "write_result",
    "write_table",
]

Array = NDArray[np.float64]


#: By how much correlations may be wrong.
_ROUNDING = 1e-6


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
    return write_atomically(Path(path), json_bytes(table), overwrite=overwrite)


def read_result(path: str | Path) -> StoredResult:
    """Read what a result file says of robot and set-up.

    Raises:
        FileError: It cannot be read, is no JSON, no result of calib, or of a newer schema.
    """
    return stored_result(read_table(path), path)


def read_table(path: str | Path) -> dict[str, Any]:
    """The nested tables of a result file.

    Raises:
        FileError: It cannot be read, is no JSON, no result of calib, or of a newer schema.
    """
    expected = (
        f"a result of calib {__version__} has {SCHEMA}. Give the file that 'calib fit --json' wrote, by the same "
        "version."
    )
    return read_json(path, "calibration result", SCHEMA, expected)


def stored_result(table: Mapping[str, Any], source: str | Path) -> StoredResult:
    """What a result's tables say of robot and set-up.

    Args:
        table: See `read_table`, or `plain` of `result_table`.
        source: What messages call it.

    Raises:
        FileError: Something is missing or of another kind.
    """
    try:
        return _stored(table)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, CalibError) as error:
        message = (
            f"{source}: the result is incomplete or damaged ({damage(error)}). Write it again with "
            "'calib fit --json'."
        )
        raise FileError(message) from error


def _stored(table: Mapping[str, Any]) -> StoredResult:
    """The part of a result's tables that is needed to use it again.

    Raises:
        KeyError, TypeError, ValueError: Something is missing or of another kind.
    """
    robot, frames, larger = table["robot"], table["frames"], table["larger"]
    if "covariance" in table:
        _check_covariance(table["covariance"])
    return StoredResult(
        base=_text(robot["base"]),
        tip=_text(robot["tip"]),
        held={_text(one["joint"]): _number(one["value"]) for one in robot["held"]},
        known=_known(frames),
        nominal_known=_known(frames["nominal"]) if "nominal" in frames else None,
        origins=_origins(robot["origins"]),
        nominal_origins=_origins(robot["nominal_origins"]),
        larger=None if larger is None else _larger(larger, table["model"]["ties"]),
        certainty=_certainty(table),
        targets_given=_given(frames),
    )


def _check_covariance(value: Any) -> None:  # noqa: ANN401
    """Refuse what is no covariance of anything; numbers may be missing.

    Raises:
        ValueError: A variance below zero, numbers that differ across the diagonal, or correlations that contradict
            each other.
    """
    covariance = np.array(value, dtype=np.float64)
    if covariance.size == 0:
        return
    if covariance.ndim != 2 or covariance.shape[0] != covariance.shape[1]:
        message = f"'covariance' has the shape {covariance.shape}, and has as many rows as columns"
        raise ValueError(message)
    variance = np.diag(covariance)
    for k in np.flatnonzero(variance < 0.0):
        message = f"'covariance[{k}][{k}]' is {variance[k]:g}, and no variance is below zero"
        raise ValueError(message)
    std = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = covariance / std[:, None] / std
    if np.isinf(covariance).any() or np.isinf(correlation).any():
        message = "'covariance' has a number that is too large"
        raise ValueError(message)
    for i, j in np.argwhere(np.abs(correlation - correlation.T) > _ROUNDING):
        message = (
            f"'covariance[{i}][{j}]' is {covariance[i, j]:g} and 'covariance[{j}][{i}]' {covariance[j, i]:g}, and the "
            "two are the same number"
        )
        raise ValueError(message)
    if np.isfinite(correlation).all() and np.linalg.eigvalsh(correlation)[0] < -_ROUNDING:
        message = "'covariance' has an eigenvalue below zero, which no covariance has"
        raise ValueError(message)


def _given(frames: Mapping[str, Any]) -> frozenset[str]:
    """The targets whose place was stated; a file that does not name them tells it of the first."""
    if "targets_given" in frames:
        return frozenset(map(_text, frames["targets_given"]))
    stated = frames.get("target_given_m") is not None
    return frozenset(_text(one["target"]) for one in frames["targets"][: int(stated)])


def _certainty(table: Mapping[str, Any]) -> Certainty | None:
    """How far to trust a result; None where it was written before results said so, or with numbers missing."""
    try:
        return certainty_of(table)
    except (KeyError, TypeError, ValueError):
        return None


def _larger(larger: Mapping[str, Any], ties: Any) -> StoredLarger:  # noqa: ANN401  JSON values are of any kind
    """The larger model."""
    payload, names = larger["payload"], [_text(name) for name in larger["names"]]
    return StoredLarger(
        name=_text(larger["set"]),
        x=dict(zip(names, map(_number, larger["x"]), strict=True)),
        ties={_text(t["name"]): (_text(t["other"]), _number(t["factor"])) for t in ties},
        known=_known(larger),
        payload=None
        if payload is None
        else Payload(_number(payload["mass_kg"]), _numbers(payload["com_m"])),
        gravity=_numbers(larger["gravity_m_s2"]),
    )


def _known(table: Mapping[str, Any]) -> Known:
    """The frames and targets of a geometry or of a larger model; at least one of each."""
    frames = {
        _text(one["group"]): _pose(one["frame_base_xyz_m"], one["frame_base_rpy_rad"])
        for one in table["set_ups"]
    }
    unturned = [0.0, 0.0, 0.0]
    targets = {
        _text(one["target"]): _pose(
            one["xyz_m"], unturned if one["rpy_rad"] is None else one["rpy_rad"]
        )
        for one in table["targets"]
    }
    if not frames or not targets:
        message = "no set-ups or no targets"
        raise ValueError(message)
    return Known(frames, targets, all(one["rpy_rad"] is not None for one in table["targets"]))


def _origins(table: Any) -> dict[str, Array]:  # noqa: ANN401
    """Joint origins by name."""
    return {_text(one["joint"]): _pose(one["xyz_m"], one["rpy_rad"]) for one in table}


def _pose(xyz: Any, rpy: Any) -> Array:  # noqa: ANN401
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


def _number(value: Any) -> float:  # noqa: ANN401
    """One finite number of a JSON file."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        message = f"a finite number expected, {value!r} found"
        raise ValueError(message)
    return float(value)


def _text(value: Any) -> str:  # noqa: ANN401
    """One text of a JSON file."""
    if not isinstance(value, str):
        message = f"a text expected, {value!r} found"
        raise ValueError(message)  # noqa: TRY004  it is the file's fault, as a number would be
    return value
