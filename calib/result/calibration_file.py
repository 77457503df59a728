"""The result as JSON, there and back: SI units, the unit in each key's suffix; the keys are in docs/result-json.md.

A result read back is equal to the one written, field by field, but for ``fit``: measurements and solved problem are no
part of the file. The nominal URDF is, so that a result needs no other file. Numbers that do not exist are null.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib.diagnosis.coverage import OutsideRow
from calib.diagnosis.reasons import Reason
from calib.errors import CalibError, FileError
from calib.files import write_atomically
from calib.json_files import Json, JsonLayout, Key, damage, json_bytes, nested, read_json
from calib.model.families import FAMILIES, Factor, factor_of
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability
from calib.model.parameters import ErrorModel, Parameter
from calib.numerics.errors import CrossValidation, Errors
from calib.numerics.repeats import Repeats
from calib.result.calibration import CalibrationValues, Source
from calib.result.prediction import FittedModel, NonGeometric, Outlier
from calib.robot.payload import Payload
from calib.robot.robot import Robot, read_only
from calib.robot.urdf import Urdf
from calib.selection.candidates import Candidate
from calib.selection.robustness import Robustness
from calib.units import Array
from calib.version import __version__

#: The layout of a result.
SCHEMA = 6


def _ranges(found: Any) -> Array:  # noqa: ANN401
    """Ends of the joints' ranges, from infinity down to minus infinity where no row was fitted."""
    ends = np.array(found, dtype=np.float64)
    return read_only(np.where(np.isnan(ends), [np.inf, -np.inf], ends))


def error_table(e: Errors) -> dict[str, Any]:
    """Errors of one set of rows, see docs/result-json.md: angles only where there are any."""
    return {k: v for k, v in _LAYOUT.table(e).items() if e.n_angle or not k.endswith("_rad")}


def pose_table(T: Array, prefix: str = "") -> dict[str, Any]:
    """A pose, shape (4, 4), as position [m] and roll, pitch, yaw [rad]."""
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}


#: The size of each family's errors, the unit in the key.
_SIZES = Key(
    "prior_std",
    lambda prior_std: {
        f"{name}_{FAMILIES[name].unit.key}": size for name, size in prior_std.items()
    },
    lambda found: {
        name: float(found[key])
        for name, row in FAMILIES.items()
        if (key := f"{name}_{row.unit.key}") in found
    },
)
#: Where attributes stand in the file, by class; see `JsonLayout`.
_LAYOUT: JsonLayout = JsonLayout(
    {
        Errors: {
            **{name: f"{name}_m" for name in ("max", "mean", "rms")},
            **{f"{name}_axis": f"{name}_xyz_m" for name in ("mean", "rms", "span")},
            **{f"{name}_angle": f"{name}_rad" for name in ("n", "max", "mean", "rms")},
        },
        CrossValidation: {"errors": "", "errors_without_outliers": "without_outliers"},
        Outlier: {"residual": "residual_m"},
        OutsideRow: {"beyond": "joints"},
        Reason: {
            "why": "code",
            "values": Key(
                "values",
                lambda values: [{"name": name, "value": value} for name, value in values.items()],
                lambda found: {one["name"]: one["value"] for one in found},
            ),
        },
        Payload: {"mass": "mass_kg", "com": "com_m"},
        Repeats: {"within": "scatter", "freedoms": "freedom", "rho": "correlation"},
        Candidate: {"name": "set", "prior_std": _SIZES},
        Robustness: {
            "lowered": "weights_lowered",
            "moved_rms": "moved_rms_m",
            "moved_max": "moved_max_m",
            "errors_lowered": "lowered",
            "errors_full": "full",
        },
        Observability: {
            "condition": Key("condition", None, lambda v: np.inf if v is None else float(v))
        },
        FittedModel: {
            "kinematics": None,
            "setup": "frames",
            "covariance": Key(
                "covariance",
                None,
                lambda v: read_only(np.array(v, dtype=float).reshape(len(v), -1)),
            ),
            "base_motion": Key("base_motion", None, lambda v: v and np.reshape(v, (6, -1))),
            "prior_std": _SIZES,
            "expected_measured": "expected.measured_rms_m",
            "expected_everywhere": "expected.everywhere_rms_m",
            "extrapolation": "expected.extrapolation",
        },
        NonGeometric: {"gravity": "gravity_m_s2"},
        CalibrationValues: {
            **dict.fromkeys(("nominal", "robot", "source", "fit")),
            "setup": "frames.",
            "nominal_setup": "frames.nominal",
            "frame_estimated": "frames.frame_estimated",
            "rows": "rows.",
            **{
                name: f"rows.{name}"
                for name in ("residual_nominal", "residual_calibrated", "used", "scores", "weights")
            },
            "ranges": Key("robot.ranges", None, _ranges),
            **{
                name: f"noise.{name}"
                for name in ("freedom", "repeats", "prior_std_from", "flag_limit")
            },
            "prior_std": replace(_SIZES, path="noise.prior_std"),
            "sigma": "noise.sigma_m",
            "sigma_angle": "noise.sigma_angle_rad",
            "sigma_given": "noise.sigma_given_m",
            "sigma_angle_given": "noise.sigma_angle_given_rad",
            **{name: f"model.{name}" for name in ("frozen", "candidates")},
            "ties": Key(
                "model.ties",
                lambda ties: [{"name": n, "other": o, "factor": f} for n, (o, f) in ties.items()],
                lambda found: {one["name"]: (one["other"], float(one["factor"])) for one in found},
            ),
            "solver": "solver.name",
            "seconds": "solver.seconds",
            "solution": "solver.",
        },
    },
    {
        Errors: (error_table, None),
        Factor: (lambda factor: factor.name, factor_of),
    },
)


def versions() -> dict[str, str]:
    """What computed the result."""
    packages = {name: importlib.metadata.version(name) for name in ("pin", "numpy", "scipy")}
    return {"calib": __version__, "python": platform.python_version(), **packages}


def result_table(c: CalibrationValues) -> dict[str, Any]:
    """The result as nested tables of plain values, before missing numbers become null."""
    r, urdf, given = c.nominal, c.nominal.urdf, c.setup.target_given[0]
    errors = {
        who: {name: error_table(one) for name, one in sets.items()}
        for who, sets in c.errors.items()
    }
    found = nested(
        {
            "schema": SCHEMA,
            "robot": {"name": r.name, "base": r.base, "tip": r.tip, "joints": r.joint_names},
            "robot.held": [{"joint": name, "value": value} for name, value in r.held.items()],
            **{
                f"robot.{key}": [{"joint": n, **pose_table(T)} for n, T in robot.origins().items()]
                for key, robot in (("origins", c.robot), ("nominal_origins", r))
            },
            "frames": {**pose_table(c.T_frame_base, "frame_base_"), "target_m": c.target},
            "frames.target_given_m": c.nominal_setup.T_tip_target[0, :3, 3] if given else None,
            "frames.target_estimated": c.setup.estimate_target,
            "errors": errors,
            "model": _model_table(c.model),
            "inputs.urdf": {"name": urdf.source, "sha256": urdf.sha256},
            "inputs.urdf.text": urdf.data.decode("utf-8", "surrogateescape"),
            "inputs.measurements": {"name": c.source.name, "sha256": c.source.sha256},
            "inputs.measurements.rows": len(c.rows),
            "versions": versions(),
        }
    )
    for key, value in _LAYOUT.table(c).items():
        found[key] = found.get(key, {}) | value if isinstance(value, dict) else value
    found["solver"]["iterations"] = c.solution.iterations
    if c.non_geometric is not None:
        found["non_geometric"] |= {
            "errors": errors["non_geometric"],
            "model": _model_table(c.non_geometric.model),
        }
    return found


def write_result(
    c: CalibrationValues, path: str | Path, *, overwrite: bool = False, extra: Json | None = None
) -> Path:
    """Write a calibration as JSON, with further keys if any; `FileError` where that cannot be."""
    return write_table(result_table(c) | dict(extra or {}), path, overwrite=overwrite)


def write_table(table: Json, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write nested tables of plain values and arrays as JSON, missing numbers as null; `FileError` as above."""
    return write_atomically(Path(path), json_bytes(table), overwrite=overwrite)


def read_result(path: str | Path) -> CalibrationValues:
    """Read a calibration; `FileError` where it cannot be read, is no result, of another schema, or damaged."""
    expected = (
        f"a result of calib {__version__} has {SCHEMA}. Results are written by calib calibrate ROBOT DATA --json "
        "result.json"
    )
    found = read_json(path, "calibration result", SCHEMA, expected)
    try:
        return _calibration(found, Path(path).parent)
    except (
        CalibError, KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError,
    ) as error:  # fmt: skip
        raise FileError(
            f"{path}: the result is damaged ({damage(error)}). Write it again with 'calib calibrate --json'."
        ) from error


def _calibration(found: Json, folder: Path) -> CalibrationValues:
    """A result from its tables; meshes lie beside the URDF, where that is in a folder."""
    robot, inputs = found["robot"], found["inputs"]
    name, text = inputs["urdf"]["name"], inputs["urdf"]["text"]
    urdf = Urdf.from_bytes(text.encode("utf-8", "surrogateescape"), name, folder / name)
    held = {one["joint"]: float(one["value"]) for one in robot["held"]}
    nominal = Robot.from_urdf(urdf, robot["base"], robot["tip"], held=held)

    def solved(kind: type[FittedModel], table: Json) -> dict[str, Any]:
        """The attributes of the geometry, or of the non-geometric model."""
        own = _LAYOUT.values(kind, table, excluded=("non_geometric",))
        x, C, setup = own["x"], own["covariance"], own["setup"]
        model = _model_of(table["model"], [one.name for one in own["parameters"]])
        arrays = x, C, setup.T_frame_base, setup.T_tip_target
        numbers = [
            *(one.data_gradient for one in own["parameters"]),
            *np.concatenate([*map(np.ravel, arrays)]),
        ]
        if C.shape != x.shape * 2 or not np.isfinite(numbers).all():
            raise ValueError("a number is missing")
        back = np.linalg.inv(model.displacements(x)[0])
        own["kinematics"] = Kinematics(
            nominal,
            model,
            setup.T_frame_base @ back[: len(setup.groups)],
            setup.T_tip_target @ back[-len(setup.targets) :],
        )
        return own

    own, non_geometric = solved(CalibrationValues, found), found["non_geometric"]
    ends = len(own["ranges"]), len(own["rows"])
    if ends != (len(nominal.joint_names), inputs["measurements"]["rows"]):
        raise ValueError("'robot.ranges' or 'rows' are not those of the result")
    return CalibrationValues(
        **own,
        nominal=nominal,
        robot=own["kinematics"].model.apply(nominal, own["x"]),
        source=Source(inputs["measurements"]["name"], inputs["measurements"]["sha256"]),
        non_geometric=None
        if non_geometric is None
        else NonGeometric(**solved(NonGeometric, non_geometric)),
    )


def _model_table(model: ErrorModel) -> dict[str, Any]:
    """Where each term of an error model acts, and which parameters the terms follow."""
    mixing = None if model.terms is model.parameters else model.mixing
    terms = [_LAYOUT.table(one) for one in model.terms]
    return {"set": model.name, "places": model.places, "terms": terms, "mixing": mixing}


def _model_of(found: Json, names: Sequence[str]) -> ErrorModel:
    """The same back, with these parameters."""
    terms = tuple(_LAYOUT.read(Parameter, one) for one in found["terms"])
    by_name, places = {one.name: one for one in terms}, tuple(found["places"])
    parameters = tuple(by_name[name] for name in names)
    if found["mixing"] is not None:
        mixing = np.array(found["mixing"], dtype=np.float64).reshape(len(terms), len(names))
        return ErrorModel(found["set"], places, parameters, terms, read_only(mixing))
    if parameters != terms:
        raise ValueError("'parameters' and 'model.terms' name other parameters")
    return ErrorModel(found["set"], places, terms)
