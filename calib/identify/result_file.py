"""The result as JSON: SI units, the unit in each key's suffix, versioned by ``schema``. See docs/result-json.md.

The file holds what is needed to use the result again: the corrected joint origins, the target and the measurement
frame. Numbers that do not exist (the error of no rows) are null.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.errors import FileError
from calib.identify.calibration import Calibration
from calib.identify.evaluation import Evaluation
from calib.identify.findings import Outlier
from calib.identify.statistics import Errors
from calib.model.files import read_bytes, write_atomically
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: The layout of a result, and of what `calib evaluate --json` writes; a word, so that one is not taken for the other.
SCHEMA = 1
EVALUATION_SCHEMA = "evaluation 1"

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
        return Robot.from_urdf(robot.urdf.with_origins(self.origins), self.base, self.tip)


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


def result_table(calibration: Calibration) -> dict[str, Any]:
    """The result as nested tables of plain values, before missing numbers become null."""
    c, m = calibration, calibration.measurements
    return {
        "schema": SCHEMA,
        "robot": {
            "name": c.nominal.name,
            "base": c.nominal.base,
            "tip": c.nominal.tip,
            "joints": list(c.nominal.joint_names),
            "origins": _origins(c.robot),
        },
        "frames": {
            "frame_base_xyz_m": c.T_frame_base[:3, 3],
            "frame_base_rpy_rad": pin.rpy.matrixToRpy(c.T_frame_base[:3, :3]),
            "frame_estimated": c.cell.estimate_frame,
            "target_m": c.target,
            "target_given_m": c.cell.target,
            "target_estimated": c.cell.estimate_target,
        },
        "errors": {
            who: {name: errors_table(errors) for name, errors in sets.items()}
            for who, sets in c.errors.items()
        },
        "cross_validation": _cross_validation(c),
        "noise": {
            "sigma_m": c.sigma,
            "freedom": c.freedom,
            "prior_length_m": c.prior_length,
            "prior_angle_rad": c.prior_angle,
        },
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "nominal": p.nominal,
                "value": p.value,
                "delta": p.delta,
                "std": p.std,
                "low": p.low,
                "high": p.high,
                "identifiable": p.identifiable,
            }
            for p in c.parameters
        ],
        "covariance": c.covariance,
        "outliers": [_outlier(o) for o in c.outliers],
        "suspects": [_outlier(o) for o in c.suspects],
        "expected": {
            "measured_rms_m": c.expected_measured,
            "everywhere_rms_m": c.expected_everywhere,
        },
        "observability": {
            "rank": c.observability.rank,
            "columns": c.observability.columns,
            "condition": c.observability.condition,
            "indices": c.observability.indices,
            "singular_values": c.observability.singular_values,
            "unidentifiable": [
                {
                    "names": list(u.names),
                    "steps": list(u.steps),
                    "units": list(u.units),
                    "text": str(u),
                }
                for u in c.observability.unidentifiable
            ],
        },
        "model": {"set": c.model.name, "frozen": list(c.cell.frozen), "candidates": []},
        "solver": {
            "name": c.solver,
            "iterations": c.solution.iterations,
            "evaluations": c.solution.evaluations,
            "seconds": c.seconds,
            "status": c.solution.status,
            "message": c.solution.message,
            "history": [
                {"cost": h.cost, "mu": h.mu, "gain": h.gain, "step": h.step, "accepted": h.accepted}
                for h in c.solution.history
            ],
        },
        "verdict": None
        if c.verdict is None
        else {"use": c.verdict.use, "reasons": list(c.verdict.reasons)},
        "rows": [
            {
                "row": row,
                "set": m.sets[i],
                "residual_nominal_m": c.residual_nominal[i],
                "residual_calibrated_m": c.residual_calibrated[i],
                "score": c.scores[i],
                "weight": c.weights[i],
            }
            for i, row in enumerate(m.rows)
        ],
        "inputs": {
            "urdf": {"name": c.nominal.urdf.source, "sha256": c.nominal.urdf.sha256},
            "measurements": {"name": m.source, "sha256": m.sha256, "rows": len(m)},
        },
        "versions": versions(),
    }


def evaluation_table(as_it_is: Evaluation, corrected: Evaluation | None = None) -> dict[str, Any]:
    """What `calib evaluate` found, as nested tables: the robot as its URDF is, and with a result's joint origins."""
    e, m = as_it_is, as_it_is.measurements
    results = {"urdf": e} if corrected is None else {"urdf": e, "calibration": corrected}
    return {
        "schema": EVALUATION_SCHEMA,
        "robot": {"name": e.robot.name, "base": e.robot.base, "tip": e.robot.tip},
        "frames": {
            "frame_base_xyz_m": e.T_frame_base[:3, 3],
            "frame_base_rpy_rad": pin.rpy.matrixToRpy(e.T_frame_base[:3, :3]),
            "target_m": e.target,
            "registered": list(e.registered),
        },
        "errors": {
            who: {name: errors_table(errors) for name, errors in result.errors.items()}
            for who, result in results.items()
        },
        "inputs": {
            "urdf": {"name": e.robot.urdf.source, "sha256": e.robot.urdf.sha256},
            "measurements": {"name": m.source, "sha256": m.sha256, "rows": len(m)},
        },
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """What computed the result."""
    packages = ("pin", "numpy", "scipy")
    return {
        "calib": calib.__version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in packages},
    }


def _origins(robot: Robot) -> list[dict[str, Any]]:
    """The origin of each joint that carries a placement of the chain."""
    return [
        {"joint": carrier, "xyz_m": T[:3, 3], "rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}
        for carrier, T in robot.origins().items()
    ]


def errors_table(errors: Errors) -> dict[str, Any]:
    """Errors of one set of rows."""
    return {
        "n": errors.n,
        "max_m": errors.max,
        "mean_m": errors.mean,
        "rms_m": errors.rms,
        "mean_xyz_m": errors.mean_axis,
        "rms_xyz_m": errors.rms_axis,
        "span_xyz_m": errors.span_axis,
    }


def _cross_validation(c: Calibration) -> dict[str, Any] | None:
    """Errors on left-out rows; those of the flagged ones included at the top, left out below."""
    if c.cross_validation is None or c.nominal_cross_validation is None:
        return None
    v, nominal = c.cross_validation, c.nominal_cross_validation
    return {
        "method": v.method,
        "folds": v.folds,
        **errors_table(v.errors),
        "without_outliers": errors_table(v.errors_without_outliers),
        "nominal": {
            **errors_table(nominal.errors),
            "without_outliers": errors_table(nominal.errors_without_outliers),
        },
    }


def _outlier(outlier: Outlier) -> dict[str, Any]:
    """One flagged row."""
    return {"row": outlier.row, "residual_m": outlier.residual, "score": outlier.score}


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
