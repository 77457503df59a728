"""The result as JSON, there and back: SI units, the unit in each key's suffix; the keys are in docs/result-json.md.

A result read back is equal to the one written, field by field, but for ``fit``: measurements and solved problem are no
part of the file. The nominal URDF is, so that a result needs no other file. Numbers that do not exist (the error of no
rows) are null. A value's fields and keys stand once, in a table that both ways read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import CalibError, FileError
from calib.identify import result_tables as tables
from calib.identify import table_fields as fields
from calib.identify.coverage import Beyond, OutsideRow
from calib.identify.findings import Outlier, ParameterEstimate
from calib.identify.reasons import Reason, Why
from calib.identify.result import Calibration, RowNames, Source
from calib.identify.result_rows import residuals_of, rows_table, used_of
from calib.identify.solvers import Iteration, Solution
from calib.identify.statistics import CrossValidation
from calib.identify.verdict import Verdict
from calib.measure.columns import SETS
from calib.model.files import damage, json_bytes, read_json, write_atomically
from calib.model.robot import Robot
from calib.model.urdf import Urdf
from calib.version import __version__

Array = NDArray[np.float64]
Json = Mapping[str, Any]

#: The layout of a result.
SCHEMA = 2

#: By how much correlations may be wrong.
_ROUNDING = 1e-6


def write_result(
    c: Calibration, path: str | Path, *, overwrite: bool = False, extra: Json | None = None
) -> Path:
    """Write a calibration as JSON.

    Args:
        c: The calibration.
        path: Where to.
        overwrite: Whether an existing file may be replaced.
        extra: Further keys, see `calib.cli.fit`.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_table({**result_table(c), **(extra or {})}, path, overwrite=overwrite)


def write_table(table: Json, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write nested tables of plain values and arrays as JSON, missing numbers as null.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_atomically(Path(path), json_bytes(table), overwrite=overwrite)


def read_result(path: str | Path) -> Calibration:
    """Read a calibration.

    Raises:
        FileError: It cannot be read, is no JSON, no result of calib, of another schema, or damaged.
    """
    expected = (
        f"a result of calib {__version__} has {SCHEMA}. Make it again from the same files: calib fit ROBOT DATA --json "
        f"{Path(path).name}"
    )
    table = read_json(path, "calibration result", SCHEMA, expected)
    try:
        return _checked(_calibration(table, Path(path).parent))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise FileError(
            f"{path}: the result is damaged ({damage(error)}). Write it again with 'calib fit --json'."
        ) from error
    except CalibError as error:
        raise FileError(
            f"{path}: the result is damaged ({error}) Write it again with 'calib fit --json'."
        ) from error


def result_table(c: Calibration) -> dict[str, Any]:
    """The result as nested tables of plain values, before missing numbers become null."""
    return {
        "schema": SCHEMA,
        "robot": {
            "name": c.nominal.name,
            "base": c.nominal.base,
            "tip": c.nominal.tip,
            "joints": list(c.nominal.joint_names),
            "held": tables.held_table(c.nominal),
            "ranges": [
                {
                    "joint": joint.name,
                    "low": low,
                    "high": high,
                    "unit": "m" if joint.type == "prismatic" else "rad",
                }
                for joint, (low, high) in zip(c.nominal.inputs, c.ranges, strict=True)
            ],
            "origins": tables.origins_table(c.robot),
            "nominal_origins": tables.origins_table(c.nominal),
        },
        "frames": {
            "frame_base_xyz_m": c.T_frame_base[:3, 3],
            "frame_base_rpy_rad": pin.rpy.matrixToRpy(c.T_frame_base[:3, :3]),
            "frame_estimated": c.frame_estimated,
            "target_m": c.target,
            "target_given_m": c.nominal_setup.T_tip_target[0, :3, 3]
            if c.setup.target_given[0]
            else None,
            "target_estimated": c.setup.estimate_target,
            "targets_given": [
                name
                for name, given in zip(c.setup.targets, c.setup.target_given, strict=True)
                if given
            ],
            **tables.places_table(c.setup),
            "nominal": tables.places_table(c.nominal_setup),
        },
        "errors": {
            who: {name: tables.errors_table(errors) for name, errors in sets.items()}
            for who, sets in c.errors.items()
        },
        "cross_validation": None
        if c.cross_validation is None
        else {
            **tables.left_out_table(c.cross_validation),
            "nominal": None
            if c.nominal_cross_validation is None
            else tables.left_out_table(c.nominal_cross_validation),
        },
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
            "sizes": tables.sizes_table(c.sizes),
            "sizes_from": c.sizes_from,
            "flag_limit": c.flag_limit,
        },
        "parameters": [fields.to_table(p, fields.PARAMETER) for p in c.parameters],
        "x": c.x,
        "base_motion": c.base_motion,
        "covariance": c.covariance,
        "outliers": [fields.to_table(o, fields.OUTLIER) for o in c.outliers],
        "suspects": [fields.to_table(o, fields.OUTLIER) for o in c.suspects],
        "outside": [
            {
                "index": row.index,
                "joints": [fields.to_table(one, fields.BEYOND) for one in row.beyond],
            }
            for row in c.outside
        ],
        "robustness": None if c.robustness is None else tables.robustness_table(c.robustness),
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
                {**fields.to_table(one, fields.COMBINATION), "text": str(one)}
                for one in c.observability.unidentifiable
            ],
        },
        "model": {
            **tables.model_table(c.model),
            "frozen": list(c.frozen),
            "ties": [
                {"name": name, "other": other, "factor": factor}
                for name, (other, factor) in c.ties.items()
            ],
            "candidates": [tables.candidate_table(one) for one in c.candidates],
        },
        "larger": None if c.larger is None else tables.larger_table(c.larger, c.errors["larger"]),
        "solver": {
            "name": c.solver,
            "iterations": c.solution.iterations,
            "evaluations": c.solution.evaluations,
            "seconds": c.seconds,
            "status": c.solution.status,
            "message": c.solution.message,
            "cost": c.solution.cost,
            "history": [fields.to_table(one, fields.STEP) for one in c.solution.history],
        },
        "verdict": None
        if c.verdict is None
        else {
            "use": c.verdict.use,
            "reasons": [
                {
                    "code": r.code,
                    "text": str(r),
                    "values": [{"name": name, "value": v} for name, v in r.values.items()],
                }
                for r in c.verdict.reasons
            ],
        },
        "rows": rows_table(c),
        "inputs": {
            "urdf": {
                "name": c.nominal.urdf.source,
                "sha256": c.nominal.urdf.sha256,
                "text": c.nominal.urdf.data.decode("utf-8", "surrogateescape"),
            },
            "measurements": {
                "name": c.source.name,
                "sha256": c.source.sha256,
                "rows": len(c.rows),
            },
        },
        "versions": tables.versions(),
    }


def _calibration(table: Json, folder: Path) -> Calibration:
    """A result from its tables; meshes lie beside the URDF, where that is in a folder.

    Raises:
        KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, CalibError: Something is missing or
            of another kind.
    """
    robot, frames, noise, inputs = (table[k] for k in ("robot", "frames", "noise", "inputs"))
    solver, verdict, model = table["solver"], table["verdict"], table["model"]
    name = inputs["urdf"]["name"]
    urdf = Urdf.from_bytes(
        inputs["urdf"]["text"].encode("utf-8", "surrogateescape"), name, folder / name
    )
    held = {one["joint"]: float(one["value"]) for one in robot["held"]}
    nominal = Robot.from_urdf(urdf, robot["base"], robot["tip"], held=held)
    rows, larger = table["rows"], table["larger"]
    names = RowNames(
        numbers=tuple(int(one["row"]) for one in rows),
        sets=fields.words([one["set"] for one in rows]),
        kinds=fields.words([one["kind"] for one in rows]),
        groups=fields.words([one["group"] for one in rows]),
        targets=fields.words([one["target"] for one in rows]),
    )
    used = used_of(rows)
    estimated, rotation = names.estimation, "pose" in names.kinds
    x, setup = fields.numbers(table["x"]), tables.places_of(frames, rotation=rotation)
    validated = table["cross_validation"]
    kinematics = tables.kinematics_of(nominal, tables.model_of(model, _names(table)), setup, x)

    def left_out(found: Json | None, who: str) -> CrossValidation | None:
        """A cross-validation, with its residuals from the rows."""
        if found is None:
            return None
        own = [one for one, chosen in zip(rows, estimated, strict=True) if chosen]
        poses = np.array([one["pose"] for one in own], dtype=int)
        residual = residuals_of(own, f"left_out_{who}", used[estimated])
        return tables.left_out_of(found, poses, residual)

    return Calibration(
        nominal=nominal,
        robot=kinematics.model.apply(nominal, x),
        source=Source(inputs["measurements"]["name"], inputs["measurements"]["sha256"]),
        rows=names,
        frame_estimated=bool(frames["frame_estimated"]),
        frozen=fields.words(model["frozen"]),
        ties={t["name"]: (t["other"], float(t["factor"])) for t in model["ties"]},
        sizes_from=noise["sizes_from"],
        nominal_setup=tables.places_of(frames["nominal"], rotation=rotation),
        setup=setup,
        kinematics=kinematics,
        solver=solver["name"],
        solution=Solution(
            x=x,
            cost=float(solver["cost"]),
            status=solver["status"],
            message=solver["message"],
            evaluations=int(solver["evaluations"]),
            history=tuple(
                fields.from_table(Iteration, one, fields.STEP) for one in solver["history"]
            ),
        ),
        seconds=fields.number(solver["seconds"]),
        x=x,
        covariance=tables.square(table["covariance"], len(x)),
        freedom=float(noise["freedom"]),
        sigma=fields.number(noise["sigma_m"]),
        sigma_angle=fields.number(noise["sigma_angle_rad"]),
        sizes=tables.sizes_of(noise["sizes"]),
        parameters=tuple(
            fields.from_table(ParameterEstimate, p, fields.PARAMETER) for p in table["parameters"]
        ),
        residual_nominal=residuals_of(rows, "nominal", used),
        residual_calibrated=residuals_of(rows, "calibrated", used),
        used=used,
        scores=fields.numbers([one["score"] for one in rows]),
        weights=fields.numbers([one["weight"] for one in rows]),
        base_motion=tables.motion_of(table),
        ranges=tables.ranges_of(robot["ranges"]),
        flag_limit=float(noise["flag_limit"]),
        outliers=tuple(
            fields.from_table(Outlier, one, fields.OUTLIER) for one in table["outliers"]
        ),
        suspects=tuple(
            fields.from_table(Outlier, one, fields.OUTLIER) for one in table["suspects"]
        ),
        robustness=None
        if table["robustness"] is None
        else tables.robustness_of(table["robustness"], _names(table)),
        repeats=tables.repeats_of(noise["repeats"]),
        outside=tuple(
            OutsideRow(
                int(one["index"]),
                tuple(fields.from_table(Beyond, far, fields.BEYOND) for far in one["joints"]),
            )
            for one in table["outside"]
        ),
        expected_measured=fields.number(table["expected"]["measured_rms_m"]),
        expected_everywhere=fields.number(table["expected"]["everywhere_rms_m"]),
        cross_validation=left_out(validated, "calibrated"),
        nominal_cross_validation=left_out(validated and validated["nominal"], "nominal"),
        observability=tables.observability_of(table),
        candidates=tuple(tables.candidate_of(one) for one in model["candidates"]),
        larger=None
        if larger is None
        else tables.larger_of(
            larger, nominal, rows, used, left_out(larger["cross_validation"], "larger")
        ),
        verdict=None
        if verdict is None
        else Verdict(
            verdict["use"],
            tuple(
                Reason(Why[r["code"].upper()], {v["name"]: v["value"] for v in r["values"]})
                for r in verdict["reasons"]
            ),
        ),
    )


def _names(table: Json) -> tuple[str, ...]:
    """The parameters of the geometry."""
    return tuple(str(one["name"]) for one in table["parameters"])


def _checked(c: Calibration) -> Calibration:
    """The same, unless what belongs together does not.

    Raises:
        ValueError: Numbers are missing or contradict each other.
    """
    C, p = c.covariance, len(c.x)
    std = np.sqrt(np.where(np.diag(C) > 0.0, np.diag(C), 1.0))
    R = C / std[:, None] / std
    push = np.array([one.push for one in c.parameters])
    names = tuple(one.name for one in c.parameters)
    for wrong, what in (
        (names != c.model.names, "'parameters' and 'model.terms' name other parameters"),
        (not np.isfinite([*c.x, *push]).all(), "a number of 'x' or 'parameters' is missing"),
        (not np.isfinite(R).all() or np.any(np.diag(C) < 0.0), "'covariance' is none"),
        (np.abs(R - R.T).max(initial=0.0) > _ROUNDING, "'covariance' is not symmetric"),
        (p and np.linalg.eigvalsh(R)[0] < -_ROUNDING, "'covariance' has an eigenvalue below zero"),
        (len(c.ranges) != len(c.nominal.joint_names), "'robot.ranges' are not those of the joints"),
        (not set(c.rows.sets) <= set(SETS), f"'rows[].set' is none of {', '.join(SETS)}"),
    ):
        if wrong:
            raise ValueError(what)
    return c
