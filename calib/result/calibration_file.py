"""The result as JSON, there and back: SI units, the unit in each key's suffix; the keys are in docs/result-json.md.

A result read back is equal to the one written, field by field, but for ``fit``: measurements and solved problem are no
part of the file. The nominal URDF is, so that a result needs no other file. Numbers that do not exist are null.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.data.table import SETS
from calib.errors import CalibError, FileError
from calib.estimate.selection import Candidate
from calib.estimate.setup import Setup
from calib.estimate.solvers import Solution
from calib.estimate.statistics import CrossValidation, Errors, Repeats
from calib.fields import Json, Key, Layout, nested
from calib.files import damage, json_bytes, read_json, write_atomically
from calib.model.families import FAMILIES, Factor
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability
from calib.model.parameters import ErrorModel, Parameter
from calib.result.calibration import Calibration, RowNames, Source
from calib.result.prediction import Larger, Outlier, Solved
from calib.result.support import OutsideRow, Robustness
from calib.result.verdict import Reason
from calib.robot.robot import Robot, read_only
from calib.robot.torques import Payload
from calib.robot.urdf import Urdf
from calib.version import __version__

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: The layout of a result.
SCHEMA = 3

#: By how much correlations may be wrong.
_ROUNDING = 1e-6


def _square(found: Any) -> Array:  # noqa: ANN401
    """A matrix of as many rows as there are, none or more."""
    return read_only(np.array(found, dtype=np.float64).reshape(len(found), -1))


def _no_rows(found: Json) -> CrossValidation:
    """A cross-validation without what stands in the rows: poses and residuals."""
    own = _LAYOUT.values(CrossValidation, found)
    return CrossValidation(poses=np.zeros(0, dtype=int), residual=np.zeros((0, 0)), **own)


def _repeats(found: Json) -> Repeats:
    """Scatter of repeats; the sum of the degrees of freedom is not in the file."""
    own = _LAYOUT.values(Repeats, found)
    return Repeats(freedom=float(own["freedoms"].sum()), **own)


def error_table(e: Errors) -> dict[str, Any]:
    """Errors of one set of rows, see docs/result-json.md: angles only where there are any."""
    return {k: v for k, v in _LAYOUT.table(e).items() if e.n_angle or not k.endswith("_rad")}


def pose_table(T: Array, prefix: str = "") -> dict[str, Any]:
    """A pose, shape (4, 4), as position [m] and roll, pitch, yaw [rad]."""
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}


def _places_table(s: Setup) -> dict[str, Any]:
    """Frames and targets."""
    frames = zip(s.groups, s.T_frame_base, s.unknown, s.frame_given, s.own_axes, strict=True)
    targets = zip(s.targets, s.T_tip_target, s.target_unknown, s.target_given, strict=True)
    return {
        "set_ups": [
            {"group": group, **pose_table(T, "frame_base_")}
            | {"estimated": list(unknown), "given": bool(given), "own_axes": bool(own)}
            for group, T, unknown, given, own in frames
        ],
        "targets": [
            {"target": name, **pose_table(T), **({} if s.oriented else {"rpy_rad": None})}
            | {"estimated": bool(unknown), "given": bool(given)}
            for name, T, unknown, given in targets
        ],
    }


def _places_of(found: Json, *, turned: bool = False) -> Setup:
    """The same back, where orientations were measured or not; at least one frame and one target."""

    def poses(every: Sequence[Json], prefix: str = "") -> Array:
        """Of each; a missing orientation is none."""
        T = np.tile(np.eye(4), (len(every), 1, 1))
        T[:, :3, 3] = [one[f"{prefix}xyz_m"] for one in every]
        rpy = [one[f"{prefix}rpy_rad"] or [0.0] * 3 for one in every]
        T[:, :3, :3] = Rotation.from_euler("xyz", np.array(rpy, dtype=np.float64)).as_matrix()
        if not np.isfinite(T).all():
            raise ValueError("a number of a pose is missing")
        return read_only(T)

    frames, targets = found["set_ups"], found["targets"]
    return Setup(
        groups=tuple(str(one["group"]) for one in frames),
        targets=tuple(str(one["target"]) for one in targets),
        T_frame_base=poses(frames, "frame_base_"),
        T_tip_target=poses(targets),
        unknown=tuple(tuple(map(str, one["estimated"])) for one in frames),
        frame_given=np.array([one["given"] for one in frames], dtype=bool),
        target_unknown=np.array([one["estimated"] for one in targets], dtype=bool),
        target_given=np.array([one["given"] for one in targets], dtype=bool),
        rotation=turned,
        own_axes=np.array([one["own_axes"] for one in frames], dtype=bool),
        oriented=all(one["rpy_rad"] is not None for one in targets),
    )


#: The size of each family's errors, the unit in the key.
_SIZES = Key(
    "sizes",
    lambda sizes: {f"{name}_{FAMILIES[name].unit.key}": size for name, size in sizes.items()},
    lambda found: {
        name: float(found[key])
        for name, row in FAMILIES.items()
        if (key := f"{name}_{row.unit.key}") in found
    },
)
#: Where attributes stand in the file, by class; see `Layout`.
_LAYOUT: Layout = Layout(
    {
        Errors: {
            **{name: f"{name}_m" for name in ("max", "mean", "rms")},
            **{f"{name}_axis": f"{name}_xyz_m" for name in ("mean", "rms", "span")},
            **{f"{name}_angle": f"{name}_rad" for name in ("n", "max", "mean", "rms")},
        },
        CrossValidation: {
            "poses": None,
            "residual": None,
            "errors": "",
            "errors_without_outliers": "without_outliers",
        },
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
        Repeats: {"within": "scatter", "freedoms": "freedom", "freedom": None, "rho": "correlation"},
        Candidate: {"name": "set", "sizes": _SIZES},
        Robustness: {
            "lowered": "weights_lowered",
            "moved": "moved_m",
            "names": None,
            "errors_lowered": "lowered",
            "errors_full": "full",
        },
        Observability: {
            "identifiable": None,
            "condition": Key("condition", None, lambda v: np.inf if v is None else float(v)),
        },
        Solution: {"x": None},
        Solved: {
            "kinematics": None,
            "setup": "",
            "covariance": Key("covariance", None, _square),
            "base_motion": Key("base_motion", None, lambda v: v and np.reshape(v, (6, -1))),
            "sizes": _SIZES,
        },
        Larger: {"residual": None, "gravity": "gravity_m_s2"},
        Calibration: {
            **dict.fromkeys(
                ("nominal", "robot", "source", "rows", "residual_nominal", "residual_calibrated", "used", "scores",
                 "weights", "ranges", "nominal_cross_validation", "fit"),
            ),
            "setup": "frames.",
            "nominal_setup": "frames.nominal",
            "frame_estimated": "frames.frame_estimated",
            **{name: f"noise.{name}" for name in ("freedom", "repeats", "sizes_from", "flag_limit")},
            "sizes": replace(_SIZES, path="noise.sizes"),
            "sigma": "noise.sigma_m",
            "sigma_angle": "noise.sigma_angle_rad",
            "expected_measured": "expected.measured_rms_m",
            "expected_everywhere": "expected.everywhere_rms_m",
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
        CrossValidation: (None, _no_rows),
        Repeats: (None, _repeats),
        Setup: (_places_table, _places_of),
        Factor: (lambda factor: factor.name, lambda name: _FACTORS[name]),
    },
)  # fmt: skip
_FACTORS: dict[str, Factor] = {one.name: one for row in FAMILIES.values() for one in row.factors}


def versions() -> dict[str, str]:
    """What computed the result."""
    packages = {name: importlib.metadata.version(name) for name in ("pin", "numpy", "scipy")}
    return {"calib": __version__, "python": platform.python_version(), **packages}


def result_table(c: Calibration) -> dict[str, Any]:
    """The result as nested tables of plain values, before missing numbers become null."""
    r, urdf = c.nominal, c.nominal.urdf
    units = {j.name: "m" if j.type == "prismatic" else "rad" for j in urdf.joints}
    given = c.nominal_setup.T_tip_target[0, :3, 3] if c.setup.target_given[0] else None
    errors = {
        who: {name: error_table(one) for name, one in sets.items()}
        for who, sets in c.errors.items()
    }
    found = nested(
        {
            "schema": SCHEMA,
            "robot": {"name": r.name, "base": r.base, "tip": r.tip, "joints": r.joint_names},
            "robot.held": [
                {"joint": n, "value": v, "unit": units[n]} for n, v in r.held.items()
            ],
            "robot.ranges": [
                {"joint": name, "low": low, "high": high, "unit": units[name]}
                for name, (low, high) in zip(r.joint_names, c.ranges, strict=True)
            ],
            **{
                f"robot.{key}": [{"joint": n, **pose_table(T)} for n, T in robot.origins().items()]
                for key, robot in (("origins", c.robot), ("nominal_origins", r))
            },
            "frames": {**pose_table(c.T_frame_base, "frame_base_"), "target_m": c.target},
            "frames.target_given_m": given,
            "frames.target_estimated": c.setup.estimate_target,
            "errors": errors,
            **{f"model.{key}": value for key, value in _model_table(c.model).items()},
            "rows": _rows_table(c),
            "inputs.urdf": {"name": urdf.source, "sha256": urdf.sha256},
            "inputs.urdf.text": urdf.data.decode("utf-8", "surrogateescape"),
            "inputs.measurements": {"name": c.source.name, "sha256": c.source.sha256},
            "inputs.measurements.rows": len(c.rows),
            "versions": versions(),
        }
    )  # fmt: skip
    for key, value in _LAYOUT.table(c).items():
        found[key] = found.get(key, {}) | value if isinstance(value, dict) else value
    found["solver"]["iterations"] = c.solution.iterations
    if c.robustness is not None:
        found["robustness"] |= {
            f"{n}_m": getattr(c.robustness, n) for n in ("moved_rms", "moved_max")
        }
    if c.nominal_cross_validation is not None:
        found["cross_validation"]["nominal"] = _LAYOUT.table(c.nominal_cross_validation)
    if c.larger is not None:
        found["larger"] |= {"names": c.larger.model.names, "errors": errors["larger"]}
        found["larger"] |= _model_table(c.larger.model)
    return found


def write_result(
    c: Calibration, path: str | Path, *, overwrite: bool = False, extra: Json | None = None
) -> Path:
    """Write a calibration as JSON, with further keys if any; `FileError` where that cannot be."""
    return write_table(result_table(c) | dict(extra or {}), path, overwrite=overwrite)


def write_table(table: Json, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write nested tables of plain values and arrays as JSON, missing numbers as null; `FileError` as above."""
    return write_atomically(Path(path), json_bytes(table), overwrite=overwrite)


def read_result(path: str | Path) -> Calibration:
    """Read a calibration; `FileError` where it cannot be read, is no result, of another schema, or damaged."""
    expected = (
        f"a result of calib {__version__} has {SCHEMA}. Make it again from the same files: calib calibrate ROBOT DATA "
        f"--json {Path(path).name}"
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


def _calibration(found: Json, folder: Path) -> Calibration:
    """A result from its tables; meshes lie beside the URDF, where that is in a folder."""
    robot, inputs, rows = (found[k] for k in ("robot", "inputs", "rows"))
    name, text = inputs["urdf"]["name"], inputs["urdf"]["text"]
    urdf = Urdf.from_bytes(text.encode("utf-8", "surrogateescape"), name, folder / name)
    held = {one["joint"]: float(one["value"]) for one in robot["held"]}
    nominal = Robot.from_urdf(urdf, robot["base"], robot["tip"], held=held)
    labels = [tuple(str(one[k]) for one in rows) for k in ("set", "kind", "group", "target")]
    names = RowNames(tuple(int(one["row"]) for one in rows), *labels)
    used, turned = _used_of(rows), "pose" in names.kinds

    def left_out(v: CrossValidation | None, who: str) -> CrossValidation | None:
        """A cross-validation with its poses and residuals, from the rows."""
        if v is None:
            return None
        own = [row for row in rows if row["set"] == SETS[0]]
        residual = _residuals_of(own, f"left_out_{who}", used[names.estimation])
        return replace(
            v, poses=np.array([row["pose"] for row in own], dtype=int), residual=residual
        )

    def solved(
        kind: type[Solved], table: Json, model: Json, places: Json, who: str
    ) -> dict[str, Any]:
        """The attributes of the geometry, or of the larger model."""
        own = _LAYOUT.values(
            kind, table, without=("setup", "larger", "robustness", "observability", "solution")
        )
        x, C, parameters = own["x"], own["covariance"], own["parameters"]
        error_model = _model_of(model, [one.name for one in parameters])
        std = np.sqrt(np.where(np.diag(C) > 0.0, np.diag(C), 1.0))
        R = C / std[:, None] / std
        if C.shape != x.shape * 2 or not np.isfinite([*x, *(one.push for one in parameters)]).all():
            raise ValueError("a number of 'x', 'covariance' or 'parameters' is missing")
        if not np.abs(R - R.T).max(initial=0.0) < _ROUNDING or np.any(
            np.linalg.eigvalsh(R) < -_ROUNDING
        ):
            raise ValueError("'covariance' is none")
        setup, back = (
            _places_of(places, turned=turned),
            np.linalg.inv(error_model.displacements(x)[0]),
        )
        own["kinematics"] = Kinematics(
            nominal,
            error_model,
            setup.T_frame_base @ back[: len(setup.groups)],
            setup.T_tip_target @ back[-len(setup.targets) :],
        )
        return own | {"setup": setup, "cross_validation": left_out(own["cross_validation"], who)}

    own = solved(Calibration, found, found["model"], found["frames"], "calibrated")
    larger = found["larger"]
    if larger is not None:
        residual = _residuals_of(rows, "larger", used)
        larger = Larger(**solved(Larger, larger, larger, larger, "larger"), residual=residual)
    model, robust = own["kinematics"].model, found["robustness"]
    ends = np.array([(one["low"], one["high"]) for one in robot["ranges"]], dtype=np.float64)
    if len(ends) != len(nominal.joint_names) or not set(names.sets) <= set(SETS):
        raise ValueError("'robot.ranges' or 'rows[].set' are not those of a result")
    validated = found["cross_validation"] and _no_rows(found["cross_validation"]["nominal"])
    return Calibration(
        **own | {"nominal_setup": replace(own["nominal_setup"], rotation=turned)},
        nominal=nominal,
        robot=model.apply(nominal, own["x"]),
        source=Source(inputs["measurements"]["name"], inputs["measurements"]["sha256"]),
        rows=names,
        solution=Solution(x=own["x"], **_LAYOUT.values(Solution, found["solver"])),
        residual_nominal=_residuals_of(rows, "nominal", used),
        residual_calibrated=_residuals_of(rows, "calibrated", used),
        used=used,
        scores=_LAYOUT.read(Array, [one["score"] for one in rows]),
        weights=_LAYOUT.read(Array, [one["weight"] for one in rows]),
        ranges=read_only(np.where(np.isnan(ends), [np.inf, -np.inf], ends)),
        robustness=robust and Robustness(names=model.names, **_LAYOUT.values(Robustness, robust)),
        nominal_cross_validation=left_out(validated, "nominal"),
        observability=Observability(
            identifiable=np.array([one.identifiable for one in own["parameters"]], dtype=bool),
            **_LAYOUT.values(Observability, found["observability"]),
        ),
        larger=larger,
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


def _rows_table(c: Calibration) -> list[dict[str, Any]]:
    """What each row is, and its residuals: nominal, calibrated, larger, and left out of the fit."""
    every = {"nominal": c.residual_nominal, "calibrated": c.residual_calibrated}
    left = {"nominal": c.nominal_cross_validation, "calibrated": c.cross_validation}
    if c.larger is not None:
        every["larger"], left["larger"] = c.larger.residual, c.larger.cross_validation
    seen, names, result = np.cumsum(c.rows.estimation) - 1, c.rows, []
    labels = zip(names.numbers, names.sets, names.kinds, names.groups, names.targets, strict=True)
    for i, label in enumerate(labels):
        row: dict[str, Any] = dict(
            zip(("row", "set", "kind", "group", "target"), label, strict=True)
        )
        found = {who: residual[i] for who, residual in every.items()}
        if c.cross_validation is not None and names.estimation[i]:
            row["pose"] = c.cross_validation.poses[seen[i]]
            found |= {f"left_out_{w}": v.residual[seen[i]] for w, v in left.items() if v}
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
    """Residuals, shape (N, D), zero where nothing was measured."""
    result = np.zeros(used.shape)
    for i, one in enumerate(rows):
        result[i, :3][used[i, :3]] = one[f"residual_{who}_m"]
        if np.any(used[i, 3:]):
            result[i, 3:][used[i, 3:]] = one[f"residual_{who}_rad"]
    return read_only(result)
