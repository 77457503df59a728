"""The result as JSON, there and back: SI units, the unit in each key's suffix; the keys are in docs/result-json.md.

A result read back is equal to the one written, field by field, but for ``fit``: measurements and solved problem are no
part of the file. The nominal URDF is, so that a result needs no other file. Numbers that do not exist (the error of no
rows) are null.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.data.table import SETS
from calib.errors import CalibError, FileError
from calib.estimate.setup import Setup
from calib.estimate.solvers import Solution
from calib.estimate.statistics import CrossValidation
from calib.files import damage, json_bytes, read_json, write_atomically
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability
from calib.model.parameters import ErrorModel
from calib.result import calibration_fields as fields
from calib.result.calibration import Calibration, RowNames, Source
from calib.result.calibration_fields import (
    EXACT,
    FLAG,
    NUMBER,
    NUMBERS,
    ONLY,
    TEXT,
    WORDS,
    Field,
    Json,
    Part,
    many,
    numbers,
    optional,
    table,
    values,
)
from calib.result.prediction import Larger
from calib.result.support import Robustness
from calib.robot.robot import Robot, read_only
from calib.robot.urdf import Urdf
from calib.version import __version__

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: The layout of a result.
SCHEMA = 3

#: By how much correlations may be wrong.
_ROUNDING = 1e-6

_ERRORS = Part(
    table=lambda sets: {name: fields.ERRORS.table(errors) for name, errors in sets.items()}
)
_ORIGINS = Part(
    table=lambda r: [{"joint": name, **fields.pose_table(T)} for name, T in r.origins().items()]
)
_LEFT_OUT = optional(Part(table=lambda found: table(found, fields.LEFT_OUT)))
_MOTION = optional(Part(lambda found: numbers(found).reshape(6, -1)))
_TIES = Part(
    lambda found: {one["name"]: (one["other"], float(one["factor"])) for one in found},
    lambda ties: [{"name": n, "other": o, "factor": factor} for n, (o, factor) in ties.items()],
)

#: What the geometry and the larger model both have.
_SOLVED: tuple[Field, ...] = (
    ("parameters", "parameters", many(fields.PARAMETER)),
    ("x", "x", NUMBERS),
    ("base_motion", "base_motion", _MOTION),
    ("covariance", "covariance", Part(lambda found: numbers(found).reshape(len(found), -1))),
)
_LARGER: tuple[Field, ...] = (
    ("model", "", Part(table=lambda model: table(model, fields.MODEL))),
    ("model.names", "names", Part(table=list)),
    *_SOLVED,
    ("sizes", "sizes", fields.SIZES),
    ("setup", "", Part(table=fields.places_table)),
    ("cross_validation", "cross_validation", _LEFT_OUT),
    ("payload", "payload", optional(fields.PAYLOAD)),
    ("gravity", "gravity_m_s2", NUMBERS),
)
_RESULT: tuple[Field, ...] = (
    (lambda _: SCHEMA, "schema", ONLY),
    *((f"nominal.{name}", f"robot.{name}", ONLY) for name in ("name", "base", "tip")),
    ("nominal.joint_names", "robot.joints", Part(table=list)),
    (lambda c: _held_table(c.nominal), "robot.held", ONLY),
    (lambda c: _ranges_table(c), "robot.ranges", ONLY),
    ("robot", "robot.origins", _ORIGINS),
    ("nominal", "robot.nominal_origins", _ORIGINS),
    ("T_frame_base", "frames.", Part(table=lambda T: fields.pose_table(T, "frame_base_"))),
    ("frame_estimated", "frames.frame_estimated", FLAG),
    ("target", "frames.target_m", ONLY),
    (
        lambda c: c.nominal_setup.T_tip_target[0, :3, 3] if c.setup.target_given[0] else None,
        "frames.target_given_m",
        ONLY,
    ),
    ("setup.estimate_target", "frames.target_estimated", ONLY),
    (
        lambda c: list(np.array(c.setup.targets)[c.setup.target_given]),
        "frames.targets_given",
        ONLY,
    ),
    ("setup", "frames.", Part(table=fields.places_table)),
    ("nominal_setup", "frames.nominal", Part(table=fields.places_table)),
    ("errors", "errors", Part(table=lambda e: {who: _ERRORS.table(one) for who, one in e.items()})),
    (lambda c: _validated_table(c), "cross_validation", ONLY),
    ("sigma", "noise.sigma_m", NUMBER),
    ("freedom", "noise.freedom", EXACT),
    ("sigma_angle", "noise.sigma_angle_rad", NUMBER),
    ("repeats", "noise.repeats", optional(fields.REPEATS)),
    ("sizes", "noise.sizes", fields.SIZES),
    ("sizes_from", "noise.sizes_from", TEXT),
    ("flag_limit", "noise.flag_limit", EXACT),
    *_SOLVED,
    ("outliers", "outliers", many(fields.OUTLIER)),
    ("suspects", "suspects", many(fields.OUTLIER)),
    ("outside", "outside", many(fields.OUTSIDE)),
    ("robustness", "robustness", optional(Part(table=lambda r: table(r, fields.ROBUSTNESS)))),
    ("expected_measured", "expected.measured_rms_m", NUMBER),
    ("expected_everywhere", "expected.everywhere_rms_m", NUMBER),
    ("observability", "observability", Part(table=lambda o: table(o, fields.OBSERVABILITY))),
    ("model", "model.", Part(table=lambda model: table(model, fields.MODEL))),
    ("frozen", "model.frozen", WORDS),
    ("ties", "model.ties", _TIES),
    ("candidates", "model.candidates", many(fields.CANDIDATE)),
    (lambda c: _larger_table(c), "larger", ONLY),
    ("solver", "solver.name", TEXT),
    ("seconds", "solver.seconds", NUMBER),
    ("solution", "solver.", Part(table=lambda found: table(found, fields.SOLUTION))),
    ("verdict", "verdict", optional(fields.VERDICT)),
    (lambda c: _rows_table(c), "rows", ONLY),
    ("nominal.urdf.source", "inputs.urdf.name", ONLY),
    ("nominal.urdf.sha256", "inputs.urdf.sha256", ONLY),
    (
        "nominal.urdf.data",
        "inputs.urdf.text",
        Part(table=lambda data: data.decode("utf-8", "surrogateescape")),
    ),
    ("source.name", "inputs.measurements.name", ONLY),
    ("source.sha256", "inputs.measurements.sha256", ONLY),
    ("rows", "inputs.measurements.rows", Part(table=len)),
    (lambda _: fields.versions(), "versions", ONLY),
)


def result_table(c: Calibration) -> dict[str, Any]:
    """The result as nested tables of plain values, before missing numbers become null."""
    return table(c, _RESULT)


def write_result(
    c: Calibration, path: str | Path, *, overwrite: bool = False, extra: Json | None = None
) -> Path:
    """Write a calibration as JSON, with further keys if any; `FileError` where that cannot be."""
    return write_table(result_table(c) | dict(extra or {}), path, overwrite=overwrite)


def write_table(table: Json, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write nested tables of plain values and arrays as JSON, missing numbers as null; `FileError` as above."""
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
    found = read_json(path, "calibration result", SCHEMA, expected)
    try:
        return _checked(_calibration(found, Path(path).parent))
    except CalibError as error:
        why = str(error)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        why = f"{damage(error)}."
    raise FileError(
        f"{path}: the result is damaged ({why}) Write it again with 'calib fit --json'."
    )


def _calibration(found: Json, folder: Path) -> Calibration:
    """A result from its tables; meshes lie beside the URDF, where that is in a folder."""
    robot, frames, inputs, rows = (found[k] for k in ("robot", "frames", "inputs", "rows"))
    name, text = inputs["urdf"]["name"], inputs["urdf"]["text"]
    urdf = Urdf.from_bytes(text.encode("utf-8", "surrogateescape"), name, folder / name)
    held = {one["joint"]: float(one["value"]) for one in robot["held"]}
    nominal = Robot.from_urdf(urdf, robot["base"], robot["tip"], held=held)
    labels = [tuple(str(one[k]) for one in rows) for k in ("set", "kind", "group", "target")]
    names = RowNames(tuple(int(one["row"]) for one in rows), *labels)
    own = [one for one in rows if one["set"] == SETS[0]]
    used, rotation = _used_of(rows), "pose" in names.kinds

    def left_out(one: Json | None, who: str) -> CrossValidation | None:
        """A cross-validation, with its residuals from the rows."""
        if one is None:
            return None
        poses = np.array([row["pose"] for row in own], dtype=int)
        residual = _residuals_of(own, f"left_out_{who}", used[names.estimation])
        return fields.left_out_of(one, poses, residual)

    def larger_of(one: Json) -> Larger:
        """The larger model, which no URDF can hold."""
        solved, setup = values(one, _LARGER), fields.places_of(one, rotation=rotation)
        model = fields.model_of(one, one["names"])
        return Larger(
            kinematics=_kinematics(nominal, model, setup, solved["x"]),
            setup=setup,
            residual=_residuals_of(rows, "larger", used),
            cross_validation=left_out(one["cross_validation"], "larger"),
            **solved,
        )

    own_values = values(found, _RESULT)
    x, parameters = own_values["x"], own_values["parameters"]
    parameter_names = tuple(one.name for one in parameters)
    setup = fields.places_of(frames, rotation=rotation)
    model = fields.model_of(found["model"], parameter_names)
    validated, robust, larger = (found[k] for k in ("cross_validation", "robustness", "larger"))
    ends = numbers([(one["low"], one["high"]) for one in robot["ranges"]]).reshape(-1, 2)
    return Calibration(
        nominal=nominal,
        robot=model.apply(nominal, x),
        source=Source(inputs["measurements"]["name"], inputs["measurements"]["sha256"]),
        rows=names,
        nominal_setup=fields.places_of(frames["nominal"], rotation=rotation),
        setup=setup,
        kinematics=_kinematics(nominal, model, setup, x),
        solution=Solution(x=x, **values(found["solver"], fields.SOLUTION)),
        residual_nominal=_residuals_of(rows, "nominal", used),
        residual_calibrated=_residuals_of(rows, "calibrated", used),
        used=used,
        scores=numbers([one["score"] for one in rows]),
        weights=numbers([one["weight"] for one in rows]),
        ranges=read_only(np.where(np.isnan(ends), [np.inf, -np.inf], ends)),
        robustness=robust
        and Robustness(names=parameter_names, **values(robust, fields.ROBUSTNESS)),
        cross_validation=left_out(validated, "calibrated"),
        nominal_cross_validation=left_out(validated and validated["nominal"], "nominal"),
        observability=Observability(
            identifiable=np.array([one.identifiable for one in parameters], dtype=bool),
            **values(found["observability"], fields.OBSERVABILITY),
        ),
        larger=None if larger is None else larger_of(larger),
        **own_values,
    )


def _checked(c: Calibration) -> Calibration:
    """The same; a `ValueError` where numbers are missing or contradict each other."""
    C, p = c.covariance, len(c.x)
    std = np.sqrt(np.where(np.diag(C) > 0.0, np.diag(C), 1.0))
    R = C / std[:, None] / std
    push = np.array([one.push for one in c.parameters])
    names = tuple(one.name for one in c.parameters)
    parts = [c] if c.larger is None else [c, c.larger]
    for wrong, what in (
        (any(one.covariance.shape != one.x.shape * 2 for one in parts), "'covariance' is none"),
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


def _kinematics(nominal: Robot, model: ErrorModel, setup: Setup, x: Array) -> Kinematics:
    """The nominal robot under a model, with frames and targets where x counts from."""
    back = np.linalg.inv(model.displacements(x)[0])
    frames, targets = back[: len(setup.groups)], back[-len(setup.targets) :]
    return Kinematics(nominal, model, setup.T_frame_base @ frames, setup.T_tip_target @ targets)


def _held_table(robot: Robot) -> list[dict[str, Any]]:
    """The joints that were not measured, with the values that they were held at."""
    slides = {joint.name for joint in robot.urdf.joints if joint.type == "prismatic"}
    return [
        {"joint": name, "value": value, "unit": "m" if name in slides else "rad"}
        for name, value in robot.held.items()
    ]


def _ranges_table(c: Calibration) -> list[dict[str, Any]]:
    """The measured range of each joint; infinite ends where no row was fitted."""
    return [
        {"joint": j.name, "low": low, "high": high, "unit": "m" if j.type == "prismatic" else "rad"}
        for j, (low, high) in zip(c.nominal.inputs, c.ranges, strict=True)
    ]


def _validated_table(c: Calibration) -> dict[str, Any] | None:
    """Errors on left-out rows, those of the nominal robot below."""
    if c.cross_validation is None:
        return None
    nominal = _LEFT_OUT.table(c.nominal_cross_validation)
    return {**table(c.cross_validation, fields.LEFT_OUT), "nominal": nominal}


def _larger_table(c: Calibration) -> dict[str, Any] | None:
    """The larger model and its errors."""
    if c.larger is None:
        return None
    return {**table(c.larger, _LARGER), "errors": _ERRORS.table(c.errors["larger"])}


def _rows_table(c: Calibration) -> list[dict[str, Any]]:
    """What each row is, and what is left over in it: nominal, calibrated, larger, and left out of the fit."""
    every = {"nominal": c.residual_nominal, "calibrated": c.residual_calibrated}
    left = {"nominal": c.nominal_cross_validation, "calibrated": c.cross_validation}
    if c.larger is not None:
        every["larger"], left["larger"] = c.larger.residual, c.larger.cross_validation
    seen, names, result = np.cumsum(c.rows.estimation) - 1, c.rows, []
    labels = zip(names.numbers, names.sets, names.kinds, names.groups, names.targets, strict=True)
    for i, of_row in enumerate(labels):
        row: dict[str, Any] = dict(
            zip(("row", "set", "kind", "group", "target"), of_row, strict=True)
        )
        found = {who: residual[i] for who, residual in every.items()}
        if c.cross_validation is not None and names.estimation[i]:
            row["pose"] = c.cross_validation.poses[seen[i]]
            found |= {
                f"left_out_{w}": v.residual[seen[i]] for w, v in left.items() if v is not None
            }
        for who, residual in found.items():
            row[f"residual_{who}_m"] = residual[:3][c.used[i, :3]]
            if np.any(c.used[i, 3:]):
                row[f"residual_{who}_rad"] = residual[3:][c.used[i, 3:]]
        result.append(row | {"score": c.scores[i], "weight": c.weights[i]})
    return result


def _used_of(rows: Sequence[Json]) -> Mask:
    """Which scalars were measured, shape (N, D): a row's lengths stand in the first columns."""
    lengths = np.array([len(one["residual_nominal_m"]) for one in rows])[:, None]
    angles = np.array([len(one.get("residual_nominal_rad", ())) for one in rows])[:, None]
    column = np.arange(6)
    used = np.where(column < 3, column < lengths, column - 3 < angles)
    return used[:, : max([1, *(1 + np.flatnonzero(used.any(axis=0)))])]


def _residuals_of(rows: Sequence[Mapping[str, Any]], who: str, used: Mask) -> Array:
    """What is left over, shape (N, D), zero where nothing was measured."""
    result = np.zeros(used.shape)
    for i, one in enumerate(rows):
        result[i, :3][used[i, :3]] = one[f"residual_{who}_m"]
        if np.any(used[i, 3:]):
            result[i, 3:][used[i, 3:]] = one[f"residual_{who}_rad"]
    return read_only(result)
