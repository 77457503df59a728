"""A calibration, or an evaluation, as nested tables: SI units, with the unit in each key; see docs/result-json.md."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping
from itertools import compress
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.families import FAMILIES
from calib.identify.data_alone import prior_stds, pushes
from calib.identify.evaluation import Evaluation
from calib.identify.findings import Outlier, ParameterEstimate
from calib.identify.result import Calibration
from calib.identify.selection import Candidate
from calib.identify.setup import Setup
from calib.identify.statistics import Errors
from calib.model.robot import Robot
from calib.version import __version__

Array = NDArray[np.float64]

#: The layout of a result, and of what `calib evaluate --json` writes; a word, so that one is not taken for the other.
SCHEMA = 1
EVALUATION_SCHEMA = "evaluation 1"


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
            "held": _held(c.nominal),
            "ranges": _ranges(c),
            "origins": _origins(c.robot),
            "nominal_origins": _origins(c.nominal),
        },
        "frames": {
            "frame_base_xyz_m": c.T_frame_base[:3, 3],
            "frame_base_rpy_rad": pin.rpy.matrixToRpy(c.T_frame_base[:3, :3]),
            "frame_estimated": c.cell.estimate_frame,
            "target_m": c.target,
            "target_given_m": c.fitted.task.setup.T_tip_target[0, :3, 3]
            if c.fitted.task.setup.target_given[0]
            else None,
            "target_estimated": c.cell.estimate_target,
            "targets_given": list(
                compress(c.setup.targets, c.fitted.task.setup.target_given.tolist())
            ),
            **_places(c, c.setup),
            "nominal": _places(c, c.nominal_setup),
        },
        "errors": {
            who: {name: errors_table(errors) for name, errors in sets.items()}
            for who, sets in c.errors.items()
        },
        "cross_validation": _cross_validation(c),
        "noise": {
            "sigma_m": c.sigma,
            "freedom": c.freedom,
            "sigma_angle_rad": c.sigma_angle,
            "repeats": None
            if c.repeats is None
            else {
                "scatter": c.repeats.within,
                "freedom": c.repeats.freedoms,
                "correlation": c.repeats.rho,
            },
            "sizes": _sizes(c.sizes),
        },
        "parameters": [
            {**_parameter(p), "prior_std": std, "push": push}
            for p, std, push in zip(c.parameters, prior_stds(c), pushes(c), strict=True)
        ],
        "covariance": c.covariance,
        "outliers": [_outlier(o) for o in c.outliers],
        "suspects": [_outlier(o) for o in c.suspects],
        "robustness": _robustness(c),
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
        "model": {
            "set": c.model.name,
            "frozen": list(c.cell.frozen),
            "ties": [
                {"name": name, "other": other, "factor": factor}
                for name, (other, factor) in c.cell.ties.items()
            ],
            "candidates": [_candidate(one) for one in c.candidates],
        },
        "larger": _larger(c),
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
                "kind": m.kinds[i],
                **_residual("nominal", c.residual_nominal[i], c.used[i]),
                **_residual("calibrated", c.residual_calibrated[i], c.used[i]),
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


def evaluation_table(
    as_it_is: Evaluation,
    corrected: Evaluation | None = None,
    larger: Evaluation | None = None,
    nominal: Evaluation | None = None,
) -> dict[str, Any]:
    """What `calib evaluate` found, as nested tables.

    Args:
        as_it_is: Of the robot as its URDF is.
        corrected: Of the robot with a result's joint origins.
        larger: Of the robot with a result's larger model.
        nominal: Of the robot that a result began with.
    """
    e, m = as_it_is, as_it_is.measurements
    every = {"nominal": nominal, "urdf": e, "calibration": corrected, "larger": larger}
    results = {who: result for who, result in every.items() if result is not None}
    rpy = pin.rpy.matrixToRpy
    return {
        "schema": EVALUATION_SCHEMA,
        "robot": {"name": e.robot.name, "base": e.robot.base, "tip": e.robot.tip},
        "frames": {
            "frame_base_xyz_m": e.T_frame_base[:3, 3],
            "frame_base_rpy_rad": pin.rpy.matrixToRpy(e.T_frame_base[:3, :3]),
            "target_m": e.target,
            "registered": list(e.registered),
            "set_ups": [
                {"group": group, "frame_base_xyz_m": T[:3, 3], "frame_base_rpy_rad": rpy(T[:3, :3])}
                for group, T in zip(e.setup.groups, e.setup.T_frame_base, strict=True)
            ],
            "targets": [
                {"target": name, "xyz_m": T[:3, 3], "rpy_rad": rpy(T[:3, :3])}
                for name, T in zip(e.setup.targets, e.setup.T_tip_target, strict=True)
            ],
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
        "calib": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in packages},
    }


def _origins(robot: Robot) -> list[dict[str, Any]]:
    """The origin of each joint that carries a placement of the chain."""
    return [
        {"joint": carrier, "xyz_m": T[:3, 3], "rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}
        for carrier, T in robot.origins().items()
    ]


def _ranges(c: Calibration) -> list[dict[str, Any]]:
    """The smallest and the largest value of each measured joint in the rows that were fitted."""
    fitted = c.measurements.joints_for(c.nominal.joint_names)[c.weights > 0.0]
    return [
        {
            "joint": joint.name,
            "low": fitted[:, column].min(initial=np.inf),
            "high": fitted[:, column].max(initial=-np.inf),
            "unit": "m" if joint.type == "prismatic" else "rad",
        }
        for column, joint in enumerate(c.nominal.inputs)
    ]


def _sizes(sizes: Mapping[str, float]) -> dict[str, float]:
    """The size of each family's errors, the unit in the key."""
    return {f"{name}_{FAMILIES[name].unit.key}": size for name, size in sizes.items()}


def _held(robot: Robot) -> list[dict[str, Any]]:
    """The joints that were not measured, with the values that they were held at."""
    slides = {joint.name for joint in robot.urdf.joints if joint.type == "prismatic"}
    return [
        {"joint": name, "value": value, "unit": "m" if name in slides else "rad"}
        for name, value in robot.held.items()
    ]


def errors_table(errors: Errors) -> dict[str, Any]:
    """Errors of one set of rows."""
    table = {
        "n": errors.n,
        "max_m": errors.max,
        "mean_m": errors.mean,
        "rms_m": errors.rms,
        "mean_xyz_m": errors.mean_axis,
        "rms_xyz_m": errors.rms_axis,
        "span_xyz_m": errors.span_axis,
    }
    if errors.n_angle:
        table |= {
            "n_rad": errors.n_angle,
            "max_rad": errors.max_angle,
            "mean_rad": errors.mean_angle,
            "rms_rad": errors.rms_angle,
        }
    return table


def _parameter(p: ParameterEstimate) -> dict[str, Any]:
    """One parameter; at a bound it has no uncertainty, and that of the hold on it is none."""
    uncertain = not p.at_bound
    return {
        "name": p.name,
        "unit": p.unit,
        "nominal": p.nominal,
        "value": p.value,
        "delta": p.delta,
        "std": p.std if uncertain else None,
        "low": p.low if uncertain else None,
        "high": p.high if uncertain else None,
        "identifiable": p.identifiable,
        "at_bound": p.at_bound,
    }


def _candidate(one: Candidate) -> dict[str, Any]:
    """One step of the ladder."""
    v = one.cross_validation
    return {
        "set": one.name,
        "parameters": one.parameters,
        "log_likelihood": one.log_likelihood,
        "sizes": _sizes(one.sizes),
        "cross_validation": {
            "method": v.method,
            "without_outliers": errors_table(v.errors_without_outliers),
        },
        "chosen": one.chosen,
        "needed": one.needed,
    }


def _larger(c: Calibration) -> dict[str, Any] | None:
    """The larger model, which no URDF can hold: all that `StoredResult` needs to predict with it."""
    if c.larger is None:
        return None
    larger, found = c.larger, c.larger.fitted.placed()
    v = larger.cross_validation
    return {
        "set": larger.name,
        "x": larger.fitted.estimate.x,
        "names": list(larger.fitted.kinematics.model.names),
        "sizes": _sizes(larger.fitted.estimate.sizes),
        "parameters": [_parameter(p) for p in larger.parameters],
        **_places(c, found),
        "errors": {name: errors_table(errors) for name, errors in c.errors["larger"].items()},
        "cross_validation": None
        if v is None
        else {"method": v.method, "without_outliers": errors_table(v.errors_without_outliers)},
        "payload": None
        if c.cell.payload is None
        else {"mass_kg": c.cell.payload.mass, "com_m": c.cell.payload.com},
        "gravity_m_s2": c.cell.gravity,
    }


def _places(c: Calibration, setup: Setup) -> dict[str, Any]:
    """All frames and targets; a target's orientation only where it is known."""
    turned = setup.rotation or c.cell.target_rotation is not None
    rpy = pin.rpy.matrixToRpy
    return {
        "set_ups": [
            {
                "group": group,
                "frame_base_xyz_m": T[:3, 3],
                "frame_base_rpy_rad": rpy(T[:3, :3]),
                "estimated": list(directions),
            }
            for group, T, directions in zip(
                setup.groups, setup.T_frame_base, setup.unknown, strict=True
            )
        ],
        "targets": [
            {"target": name, "xyz_m": T[:3, 3], "rpy_rad": rpy(T[:3, :3]) if turned else None}
            for name, T in zip(setup.targets, setup.T_tip_target, strict=True)
        ],
    }


def _residual(who: str, residual: Array, used: NDArray[np.bool_]) -> dict[str, Any]:
    """What is left over in one row: lengths, and angles where an orientation was measured."""
    table: dict[str, Any] = {f"residual_{who}_m": residual[:3][used[:3]]}
    if np.any(used[3:]):
        table[f"residual_{who}_rad"] = residual[3:]
    return table


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


def _robustness(c: Calibration) -> dict[str, Any] | None:
    """The fit with the weights of doubtful rows lowered and the one without compared, where a row is flagged."""
    found = c.robustness
    if found is None:
        return None
    return {
        "weights_lowered": found.lowered,
        "moved_rms_m": found.moved_rms,
        "moved_max_m": found.moved_max,
        "lowered": errors_table(found.errors_lowered),
        "full": errors_table(found.errors_full),
    }
