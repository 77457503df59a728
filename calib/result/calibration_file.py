"""The result as JSON, there and back: SI units, the unit in each key's suffix; the keys are in docs/result-json.md.

A result read back is equal to the one written, field by field, except for ``fit_in_memory``: measurements and solved
problem are not part of the file. The nominal URDF is, so that a result needs no other file. Numbers that do not exist
are null. ``checksums`` has the digest of every other key at the top: a file that was changed is refused, by the key.
Keys that it does not list are a user's own.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeGuard

import numpy as np
import pinocchio as pin

import calib.basics.plugins as plugins
from calib.basics.arguments import check_type
from calib.basics.arrays import Array, read_only
from calib.basics.channels import Channels, residual_unit
from calib.basics.files import write_atomically
from calib.basics.jobs import blas_kernels
from calib.basics.json_files import (
    Json,
    JsonLayout,
    Key,
    damage,
    digest,
    json_bytes,
    nested,
    plain,
    read_json,
)
from calib.basics.records import json_key
from calib.basics.values import ReadOnlyMapping
from calib.boards.board import Board
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.priors import Priors
from calib.diagnosis.coverage import OutsideRow
from calib.diagnosis.frame_drift import FrameDrift, Movement, StillTarget
from calib.diagnosis.reasons import Reason
from calib.errors import CalibError, FileError, PluginError, choices
from calib.fit.registration.setup import Setup
from calib.fit.selection.candidates import Candidate
from calib.fit.selection.row_weights import Robustness
from calib.model.error_model import SETUP, ErrorModel, Parameter
from calib.model.families import FAMILIES, Factor, factor_of
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability
from calib.numerics.correlated_noise import PoseNoise
from calib.numerics.errors import CrossValidation, Errors, UnitErrors
from calib.numerics.repeats import Repeats
from calib.result.calibration import Calibration
from calib.result.call import Call
from calib.result.file_check import check_against_itself
from calib.result.fitted_model import FittedModel, NonGeometric
from calib.result.parts import Method, ResultRows, Source
from calib.result.result_optics import ResultOptics
from calib.robot.coupled_readings import coupling_of_table, coupling_table
from calib.robot.joined_urdf import Part
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.version import __version__

#: The layout of a result.
SCHEMA = 7

#: What a file of another schema should be, for messages.
EXPECTED = (
    f"a result of calib {__version__} has {SCHEMA}. Results are written by calib calibrate ROBOT DATA --json "
    "result.json"
)

#: The key of the digests of all others; missing in files of earlier versions, as is `_RUN`.
_CHECKSUMS = "checksums"

#: The key of the run's id.
_RUN = "run"

#: Digits of a digest in `_CHECKSUMS`: a change that keeps one would be found by chance once in 3e14 tries.
_CHECKSUM_DIGITS = 12

#: A calibration result, or the path of its file.
ResultInput: TypeAlias = Calibration | str | Path

#: What to do about a file that was changed.
_TAKE_THE_ORIGINAL = (
    "Take the file as it was written, or write it again with 'calib calibrate --json': options and the cell file state "
    "what is to be different, and --accept uses a result in spite of its verdict. A program that writes the file anew "
    "has to keep all digits."
)

#: What messages call it.
RESULT = "a Calibration, or the path of a result file (.json)"


def error_table(errors: Errors) -> dict[str, Any]:
    """Return errors of one set of rows as a table by the units that were measured; see docs/result-json.md."""
    return {unit: _LAYOUT.table(figures) for unit, figures in errors.by_unit.items()}


def _read_errors(table: Json) -> Errors:
    """Return errors of one set of rows from their table by unit, as `error_table` makes it."""
    by_unit = {}
    for unit, figures in table.items():
        by_unit[unit] = UnitErrors(unit=unit, **_LAYOUT.values(UnitErrors, figures))
    return Errors(by_unit)


def _read_channels(table: Json) -> Channels:
    """Return the channels of residuals from a table of their units and of the channel of each entry, (N, D)."""
    units = tuple(residual_unit(unit).symbol for unit in table["units"])
    index = np.array(table["index"], dtype=np.int8)
    return Channels(units, tuple(table["vectors"]), index.reshape(len(index), -1))


def pose_table(T: Array, prefix: str = "") -> dict[str, Any]:
    """Return a pose as position and roll, pitch, yaw.

    Args:
        T: The pose as a homogeneous matrix, shape (4, 4), [m].
        prefix: Begins the keys, such as ``"frame_base_"``.

    Returns:
        ``"xyz_m"``, shape (3,), [m], and ``"rpy_rad"``, shape (3,), roll, pitch, yaw [rad], with R = Rz(yaw) Ry(pitch)
        Rx(roll); both after the prefix.
    """
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}


def _prior_std_key(family: str) -> str:
    """Return the key of a family's prior standard deviation, with its unit, such as ``"length_m"``."""
    return f"{family}_{FAMILIES[family].unit.key}"


def _read_prior_std(table: Json) -> dict[str, float]:
    """Return prior standard deviations by the family's name, from a table by `_prior_std_key`; no other keys."""
    keys = {family: _prior_std_key(family) for family in FAMILIES}
    return {family: float(table[key]) for family, key in keys.items() if key in table}


def _read_ranges(table: Any) -> Array:  # noqa: ANN401  any JSON
    """Return the joints' fitted ranges, shape (m, 2); from infinity down to minus infinity if no row was fitted."""
    ends = np.array(table, dtype=np.float64)
    return read_only(np.where(np.isnan(ends), [np.inf, -np.inf], ends))


def _read_intrinsics(entries: Sequence[float | None] | None) -> Array | None:
    """Return numbers of a camera, or their standard deviations, from a list; null in it is `UNKNOWN`, infinity."""
    if entries is None:
        return None
    return np.array([UNKNOWN if entry is None else float(entry) for entry in entries])


def _cameras_table(cameras: Mapping[str, Camera]) -> list[dict[str, Any]]:
    """Return cameras by the names of their stations (``""``: the only one, or that of all others) as a list."""
    table = []
    for station, camera in cameras.items():
        lens_names = LENSES[camera.lens].names
        table.append({"station": station, **_LAYOUT.table(camera), "lens_names": lens_names})
    return table


def _read_cameras(table: Iterable[Json]) -> Mapping[str, Camera]:
    """Return cameras by the names of their stations, from a list as `_cameras_table` makes it."""
    return ReadOnlyMapping({row["station"]: _LAYOUT.read(Camera, row) for row in table})


def _boards_table(boards: Mapping[str, Board]) -> list[dict[str, Any]]:
    """Return printed boards by the names of their targets (``""``: the only one, or that of all others) as a list."""
    table = []
    for target, board in boards.items():
        entries = {json_key(field): getattr(board, field.name) for field in fields(board)}
        table.append({"target": target, **entries})
    return table


def _read_boards(table: Iterable[Json]) -> Mapping[str, Board]:
    """Return printed boards by the names of their targets, from a list as `_boards_table` makes it."""
    return ReadOnlyMapping({row["target"]: _read_board(row) for row in table})


def _read_board(row: Json) -> Board:
    """Return a printed board from its table; a key with a default may be missing, any other raises KeyError."""
    arguments = {
        field.name: row[json_key(field)]
        for field in fields(Board)
        if field.default is MISSING
        or json_key(field) in row  # keys that came later are missing in older files
    }
    return Board(**arguments)


def cell_table(cell: Cell) -> dict[str, Any]:
    """Return a cell by the names of its fields, in SI units, without those that are as in the default cell."""
    default = _fields_table(Cell())
    return {name: entry for name, entry in _fields_table(cell).items() if entry != default[name]}


def _fields_table(cell: Cell) -> dict[str, Any]:
    """Return all fields of a cell by their names, in SI units."""
    return {field.name: plain(_LAYOUT.entry(getattr(cell, field.name))) for field in fields(cell)}


def read_cell(table: Json) -> Cell:
    """Return a cell from its table, as `cell_table` makes it."""
    return Cell(**_LAYOUT.values(Cell, table))


#: The prior standard deviations of families.
_PRIOR_STD = Key(
    "prior_std",
    lambda prior_std: {_prior_std_key(family): std for family, std in prior_std.items()},
    _read_prior_std,
)

#: Where attributes stand in the file, by class: each has its own name as its key unless it is listed. None: not in the
#: file by itself; a path that ends in a dot, or an empty one: the part's keys stand among the others. See `JsonLayout`.
_LAYOUT: JsonLayout = JsonLayout(
    {
        Calibration: {
            **dict.fromkeys(("nominal", "robot", "fit_in_memory")),
            "nominal_setup": "frames.nominal",
            "geometry": "",
            "rows": "",
            "noise": "noise.",
            "trust": "",
            "method": "",
            "optics": "",
            "source": "inputs.measurements.",
            "stated_uncertainty": "inputs.uncertainty",
        },
        FittedModel: {
            "kinematics": None,  # follows from the model, the setup and x
            "setup": "frames.",
            "covariance": Key(
                "covariance",
                read=lambda rows: read_only(np.array(rows, dtype=float).reshape(len(rows), -1)),
            ),
            "base_motion": Key(
                "base_motion", read=lambda rows: np.reshape(rows, (6, -1)) if rows else None
            ),
            "prior_std": replace(_PRIOR_STD, path="noise.prior_std"),
            "expected_measured": "expected.measured_rms_m",
            "expected_everywhere": "expected.everywhere_rms_m",
            "scale_measured": "expected.scale_measured_rms_m",
            "scale_everywhere": "expected.scale_everywhere_rms_m",
            "extrapolation": "expected.extrapolation",
            "board": "expected.board",
            "validation_board": "expected.validation_board",
            "undetermined": "expected.undetermined_rms_m",
            "undetermined_families": "expected.undetermined",
            "scatter": "noise.rows",
            "stated_places": "frames.stated_places",
        },
        Cell: {
            "ties": Key(
                "ties", read=lambda ties: {name: tuple(pair) for name, pair in ties.items()}
            )
        },
        Setup: {"internals": "optics"},
        Parameter: {"internal": "optic"},
        NonGeometric: {
            "prior_std": _PRIOR_STD,
            "gravity": "gravity_m_s2",
            "scatter": "scatter",
            "stated_places": "stated_places",
        },
        ResultRows: {
            "numbers": "rows.numbers",
            "sets": "rows.sets",
            "kinds": "rows.kinds",
            "groups": "rows.groups",
            "targets": "rows.targets",
            "images": "rows.images",
            "residual_nominal": "rows.residual_nominal",
            "residual_calibrated": "rows.residual_calibrated",
            "channels": Key(
                "rows.channels",
                lambda channels: {
                    "units": channels.units,
                    "vectors": channels.vectors,
                    "index": channels.index,
                },
                _read_channels,
            ),
            "scores": "rows.scores",
            "weights": "rows.weights",
            "metres_per_pixel": "rows.metres_per_pixel",
            "flag_limit": "noise.flag_limit",
            "ranges": Key("robot.ranges", read=_read_ranges),
        },
        Method: {
            "frame_estimated": "frames.frame_estimated",
            "frozen": "model.frozen",
            "ties": Key(
                "model.ties",
                lambda ties: [
                    {"name": name, "other": other, "factor": factor}
                    for name, (other, factor) in ties.items()
                ],
                lambda table: {row["name"]: (row["other"], float(row["factor"])) for row in table},
            ),
            "prior_std_from": "noise.prior_std_from",
            "candidates": "model.candidates",
            "solver": "solver.name",
            "solution": "solver.",
            "seconds": "solver.seconds",
        },
        Camera: {
            "values": Key("values", read=_read_intrinsics),
            "sigma": Key("sigma", read=_read_intrinsics),
        },
        ResultOptics: {
            "nominal_cameras": Key("nominal_cameras", _cameras_table, _read_cameras),
            "nominal_boards": Key("nominal_boards", _boards_table, _read_boards),
            "cameras": Key("cameras", _cameras_table, _read_cameras),
            "boards": Key("boards", _boards_table, _read_boards),
        },
        Source: {
            # Null without; missing in files of earlier versions.
            "orientation": Key("orientation", lambda name: name or None, lambda entry: entry or ""),
        },
        UnitErrors: {"unit": None},
        CrossValidation: {"errors_without_outliers": "without_outliers"},
        OutsideRow: {"beyond": "joints"},
        Reason: {
            "why": "code",
            "values": Key(
                "values",
                lambda values: [{"name": name, "value": value} for name, value in values.items()],
                lambda table: {row["name"]: row["value"] for row in table},
            ),
        },
        PoseNoise: {
            "position": "position_m",
            "orientation": "orientation_rad",
            "joint": "joint_rad",
        },
        Repeats: {"within": "scatter", "freedoms": "freedom", "rho": "correlation"},
        Candidate: {"name": "set", "prior_std": _PRIOR_STD},
        FrameDrift: {"scatter": "scatter_m", "left": "left_m"},
        StillTarget: {"scatter": "scatter_m"},
        Movement: {"by": "by_m", "std": "std_m", "rotation": "rotation_rad"},
        Robustness: {
            "lowered": "weights_lowered",
            "moved_rms": "moved_rms_m",
            "moved_max": "moved_max_m",
            "errors_lowered": "lowered",
            "errors_full": "full",
        },
        Observability: {
            "condition": Key(
                "condition", read=lambda value: np.inf if value is None else float(value)
            )
        },
    },
    {
        Board: (None, _read_board),
        Cell: (cell_table, read_cell),
        Errors: (error_table, _read_errors),
        Factor: (lambda factor: factor.name, factor_of),
        Priors: (
            lambda priors: {"source": priors.source, "given": dict(priors.given)},
            lambda table: Priors(table["source"], **table["given"]),
        ),
    },
)


def call_table(call: Call) -> dict[str, Any]:
    """Return what a calibration was told as a table; see docs/result-json.md."""
    return _LAYOUT.table(call)


def versions() -> dict[str, str]:
    """Return the versions of calib, of Python, and of the packages that computed the result, and what they run on.

    By ``"calib"``, ``"python"``, ``"pin"``, ``"numpy"``, ``"scipy"``; ``"blas"``, libraries of linear algebra with the
    kernels that they chose for the processor; ``"cpu"``, its instructions as NumPy uses them; ``"system"``, with the C
    library. Other kernels, instructions or C libraries round the last bits differently.
    """
    packages = {name: importlib.metadata.version(name) for name in ("pin", "numpy", "scipy")}
    # Without those that NPY_DISABLE_CPU_FEATURES names; a key that has none is missing.
    instructions = np.show_config("dicts")["SIMD Extensions"]
    highest = [*instructions.get("baseline", ()), *instructions.get("found", ())][-1:]
    return {
        "calib": __version__,
        "python": platform.python_version(),
        **packages,
        "blas": blas_kernels(),
        "cpu": " ".join([platform.machine(), *highest]),
        "system": " ".join(filter(None, [platform.system(), *platform.libc_ver()])),
    }


def result_table(c: Calibration) -> dict[str, Any]:
    """Return a result as nested tables of plain values and arrays, before missing numbers become null.

    Args:
        c: The calibration result; its measurements and fits in memory are not part of the tables.

    Returns:
        The tables of docs/result-json.md, in SI units, the unit in the suffix of each key.
    """
    robot, urdf, corrected = c.nominal, c.nominal.urdf, c.robot.urdf
    target_given = c.setup.target_given[0]
    errors = {}
    for name, sets in c.errors.items():
        errors[name] = {rows: error_table(of_rows) for rows, of_rows in sets.items()}

    # What the file has besides the attributes of a result, by its path: most of it for other programs.
    derived = {
        "schema": SCHEMA,
        _RUN: c.run,
        "robot": {
            "name": robot.name,
            "base": robot.base,
            "tip": robot.tip,
            "joints": robot.joint_names,
        },
        "robot.held": [{"joint": name, "value": value} for name, value in robot.held.items()],
        "robot.branches": [{"base": chain.base, "tip": chain.tip} for chain in robot.branches],
        "robot.coupling": coupling_table(robot.reading_coupling),
        "robot.origins": _origins_table(c.robot),
        "robot.nominal_origins": _origins_table(robot),
        "frames": {**pose_table(c.T_frame_base, "frame_base_"), "target_m": c.target},
        "frames.target_given_m": c.nominal_setup.T_tip_target[0, :3, 3] if target_given else None,
        "frames.target_estimated": c.setup.estimate_target,
        "errors": errors,
        "model": _model_table(c.model),
        "solver.iterations": c.method.solution.iterations,
        "inputs.urdf": {"name": urdf.source, "sha256": urdf.sha256},
        "inputs.urdf.text": urdf.data.decode("utf-8", "surrogateescape"),
        "inputs.robots": [
            {
                "name": part.name,
                "source": part.urdf.source,
                "estimated": part.estimated,
                "text": part.urdf.data.decode("utf-8", "surrogateescape"),
            }
            for part in robot.parts
        ],
        "inputs.measurements.rows": len(c.rows),
        "outputs.urdf.sha256": corrected.sha256,
        "versions": versions(),
    }
    table = nested(derived | _LAYOUT.entries(c))
    if c.non_geometric is not None:
        table["non_geometric"] |= {
            "errors": table["errors"]["non_geometric"],
            "model": _model_table(c.non_geometric.model),
        }
    table["plugins"] = plugins.plugin_tables(_registered_names(table))
    return table


def _forecast_table(c: Calibration) -> dict[str, Any]:
    """Return forecasts of the rms error of fresh rows by model and unit; it follows from the rest, and is not read."""
    table = {}
    for name, part in (("urdf", c.geometry), ("non_geometric", c.non_geometric)):
        forecast = None if part is None else c.forecast(non_geometric=name != "urdf")
        table[name] = None if forecast is None else forecast.table()
    return table


def uncertainty_table(c: Calibration) -> dict[str, Any] | None:
    """Return the uncertainty budget of the corrected URDF, and of the non-geometric model, over the measured ranges.

    It follows from the rest of a result, and is not read. None if nothing tells how accurate predictions are.
    """
    if c.unknown_accuracy:
        return None
    by_model = None
    if c.non_geometric is not None:
        by_model = _budget_table(c.budget(non_geometric=True))
    return {**_budget_table(c.budget(non_geometric=False)), "non_geometric": by_model}


def _budget_table(budget: Any) -> dict[str, Any]:  # noqa: ANN401  of a module above
    """Return a `calib.uncertainty.budget.Budget` as tables; missing numbers are infinite."""
    lines = [
        {
            "source": line.source.value,
            "position_std_m": line.position_std,
            "orientation_std_rad": line.orientation_std,
            "distribution": line.distribution.value,
            "freedom": line.freedom,
            "share": line.share,
            "without_m": budget.without[line.source],
        }
        for line in budget.lines
    ]
    return {
        "position_m": budget.position,
        "orientation_rad": budget.orientation,
        "position_std_m": budget.position_std,
        "orientation_std_rad": budget.orientation_std,
        "freedom": budget.freedom,
        "factor": budget.factor,
        "poses": budget.poses,
        "separated": budget.separated,
        "halving": [source.value for source in budget.halving],
        "rows_factor": budget.rows_factor,
        "lines": lines,
    }


def _registered_names(table: Json) -> dict[str, set[str]]:
    """Return the names of families, kinds, solvers and parameter sets that a result uses, by the keys of `WORDS`.

    The table is that of the whole result, as `result_table` makes it; families of frames and targets are left out.
    """
    models = [table["model"]]
    if table["non_geometric"] is not None:
        models.append(table["non_geometric"]["model"])
    families = {term["family"] for model in models for term in model["terms"]}
    return {
        "families": families - {*SETUP},
        "kinds": {*table["rows"]["kinds"]},
        "solvers": {table["solver"]["name"]},
        "models": {model["set"].partition("+")[0] for model in models},
    }


def _origins_table(robot: Robot) -> list[dict[str, Any]]:
    """Return the pose of each joint in the link before it at joint value 0, as in the URDF's <origin>."""
    return [{"joint": name, **pose_table(T)} for name, T in robot.origins().items()]


def drift_table(drift: FrameDrift) -> dict[str, Any]:
    """Return what references show as nested tables, in SI units, by the keys of a result file."""
    return _LAYOUT.table(drift)


def file_table(c: Calibration) -> dict[str, Any]:
    """Return all that a result's file has but checksums: the result, and the uncertainty and forecast that follow.

    Args:
        c: The calibration result.

    Returns:
        The tables of docs/result-json.md, in SI units.
    """
    return result_table(c) | {"uncertainty": uncertainty_table(c), "forecast": _forecast_table(c)}


def write_result(
    c: Calibration,
    path: str | Path,
    *,
    overwrite: bool = False,
    extra: Json | None = None,
) -> Path:
    """Write a calibration as JSON.

    Args:
        c: The calibration result; its measurements and fits in memory are not written.
        path: The file.
        overwrite: Whether a file that exists is replaced; else FileError is raised.
        extra: Further keys at the top, which win over the result's; None: no further ones.

    Returns:
        The path.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    table = file_table(c) | dict(extra or {})
    return write_table(table | {_CHECKSUMS: _checksums(table)}, path, overwrite=overwrite)


def _checksums(table: Json, digest_of: Callable[[Any], str] = digest) -> dict[str, str]:
    """Return the digest of each entry of a result's table by its key; `digest` says what counts."""
    return {key: digest_of(entry)[:_CHECKSUM_DIGITS] for key, entry in table.items()}


def write_table(table: Json, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write nested tables of plain values and arrays as JSON, missing numbers as null.

    Args:
        table: The tables.
        path: The file.
        overwrite: Whether a file that exists is replaced.

    Returns:
        The path.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_atomically(Path(path), json_bytes(table), overwrite=overwrite)


def read_result(path: str | Path) -> Calibration:
    """Read a calibration that `write_result` wrote.

    Args:
        path: The JSON file. Meshes that its URDF names are looked for beside the URDF, if that is in the file's folder.

    Returns:
        The result, equal to the one written except for its measurements and fits in memory.

    Raises:
        FileError: It cannot be read, is not a result, of another schema, damaged, or was changed since calib wrote it.
        PluginError: It uses a family or a kind of a plugin that is not loaded.
    """
    table = read_json(path, "calibration result", SCHEMA, EXPECTED)
    check_unchanged(table, f"{path}")
    checksums = table.pop(_CHECKSUMS, None)
    try:
        plugins.check_registered(_registered_names(table), table.get("plugins", ()))
        result = _calibration(table, Path(path).parent)
        if checksums is None:
            check_against_itself(table, result_table(result), result)
    except PluginError as error:
        raise PluginError(f"{path}: {error}") from error
    except (
        CalibError, KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError,
    ) as error:  # fmt: skip
        raise FileError(
            f"{path}: the result is damaged ({damage(error)}). Write it again with 'calib calibrate --json'."
        ) from error
    return result


def check_unchanged(table: Json, path: str, digest_of: Callable[[Any], str] = digest) -> None:
    """Refuse the tables of a result that were changed after calib wrote them.

    Args:
        table: The tables of the file; those of version 0.1.0, which have no checksums, are not checked.
        path: The path of the file, for messages.
        digest_of: `digest`, or `parsed_digest` of tables that were parsed for it.

    Raises:
        FileError: They were; the message names the key.
    """
    checksums = table.get(_CHECKSUMS)
    if checksums is None and _RUN not in table:
        return
    if not isinstance(checksums, dict):
        raise FileError(f"{path}: 'checksums' is missing. {_TAKE_THE_ORIGINAL}")
    stated = {key: entry for key, entry in table.items() if key in checksums}
    found = _checksums(stated, digest_of)
    changed = [key for key, checksum in checksums.items() if found.get(key) != checksum]
    if changed:
        was = "was" if len(changed) == 1 else "were"
        raise FileError(
            f"{path}: {choices(changed)} {was} changed after calib wrote the file. {_TAKE_THE_ORIGINAL}"
        )


def _calibration(table: Json, folder: Path) -> Calibration:
    """Return a result from its tables; meshes are looked for beside the URDF, if that is in the file's ``folder``.

    Raises ValueError, KeyError and other errors if the tables are damaged.
    """
    # The nominal robot, with its base, tip, held joint values and coupled readings.
    robot, stored = table["robot"], table["inputs"]["urdf"]
    urdf = _urdf_of(stored["text"], stored["name"], folder)
    held = {row["joint"]: float(row["value"]) for row in robot["held"]}
    coupling = coupling_of_table(robot.get("coupling", ()))  # files of earlier versions have none
    branches = [(row["base"], row["tip"]) for row in robot.get("branches", ())]
    robots = tuple(
        Part(row["name"], _urdf_of(row["text"], row["source"], folder), row["estimated"])
        for row in table["inputs"].get("robots", ())
    )
    nominal = Robot.from_urdf(
        urdf,
        robot["base"],
        robot["tip"],
        held=held,
        coupling=coupling,
        branches=branches,
        parts=robots,
    )

    geometry = FittedModel(**_model_values(FittedModel, table, nominal))
    non_geometric = None
    if table["non_geometric"] is not None:
        values = _model_values(NonGeometric, table["non_geometric"], nominal)
        non_geometric = NonGeometric(**values)

    parts = _LAYOUT.values(Calibration, table, excluded=("geometry", "non_geometric"))
    lengths = len(parts["rows"].ranges), len(parts["rows"])
    if lengths != (len(nominal.joint_names), table["inputs"]["measurements"]["rows"]):
        raise ValueError("'robot.ranges' or 'rows' are not those of the result")
    return Calibration(
        nominal=nominal,
        robot=geometry.model.apply(nominal, geometry.x),
        geometry=geometry,
        non_geometric=non_geometric,
        **parts,
    )


def _urdf_of(text: str, name: str, folder: Path) -> Urdf:
    """Return a URDF from its text in a result; its meshes are looked for beside a file of its name in a folder."""
    return Urdf.from_bytes(text.encode("utf-8", "surrogateescape"), name, folder / name)


def result_of(given: ResultInput, argument: str = "calibration") -> Calibration:
    """Return a calibration result: as given, or read from its file.

    Args:
        given: As a user gave it: the result, or the path of its JSON file.
        argument: Name of the argument, for messages.

    Returns:
        The result; one read from a file has neither measurements nor fits.

    Raises:
        ArgumentError: It is neither.
        FileError: The file cannot be read or is not a result.
    """
    check_type(argument, given, (Calibration, str, Path), RESULT)
    return given if isinstance(given, Calibration) else read_result(given)


def is_result_file(given: object) -> TypeGuard[str | Path]:
    """Return whether a path means a result, by its ending ``.json``; other paths and names mean robots."""
    return isinstance(given, (str, Path)) and Path(given).suffix.lower() == ".json"


def _model_values(kind: type[FittedModel], table: Json, nominal: Robot) -> dict[str, Any]:
    """Return the arguments of a fitted model, geometric or not, from its table; its kinematics follow from them.

    Raises ValueError if a number is missing, or parameters and terms do not belong together.
    """
    values = _LAYOUT.values(kind, table)

    # The error model, see `_model_table`; its parameters are in the order of x.
    of_model = table["model"]
    terms = tuple(_LAYOUT.read(Parameter, term) for term in of_model["terms"])
    by_name = {term.name: term for term in terms}
    parameters = tuple(by_name[estimate.name] for estimate in values["parameters"])
    name, places = of_model["set"], tuple(of_model["places"])
    if of_model["mixing"] is not None:
        mixing = np.array(of_model["mixing"], dtype=np.float64).reshape(len(terms), len(parameters))
        model = ErrorModel(name, places, parameters, terms, read_only(mixing))
    elif parameters == terms:
        model = ErrorModel(name, places, terms)
    else:
        raise ValueError("'parameters' and 'model.terms' name other parameters")

    # No number of parameters, covariance, frames or targets may be missing (NaN).
    x, covariance, setup = values["x"], values["covariance"], values["setup"]
    arrays = (x, covariance, setup.T_frame_base, setup.T_tip_target)
    gradients = [parameter.data_gradient for parameter in values["parameters"]]
    numbers = np.concatenate([gradients, *(np.ravel(array) for array in arrays)])
    if covariance.shape != x.shape * 2 or not np.isfinite(numbers).all():
        raise ValueError("a number is missing")

    values["kinematics"] = _kinematics(nominal, model, setup, x)
    return values


def _kinematics(nominal: Robot, model: ErrorModel, setup: Setup, x: Array) -> Kinematics:
    """Return the nominal robot under an error model, with frames and targets at x = 0.

        T_frame_base(0) = T_frame_base(x) D_frame(x)^-1,    T_tip_target(0) = T_tip_target(x) D_target(x)^-1

    with the displacements D that the parameters x make, and frames and targets at the solution.
    """
    displacements, _ = model.displacements(x)
    back = np.linalg.inv(displacements)
    frames = setup.T_frame_base @ back[: len(setup.groups)]
    targets = setup.T_tip_target @ back[-len(setup.targets) :]
    return Kinematics(nominal, model, frames, targets)


def _model_table(model: ErrorModel) -> dict[str, Any]:
    """Return an error model as a table: its set, its places, its terms, and how these follow the parameters.

    ``"mixing"``, shape (terms, p): the values of the terms are mixing @ x; None if no parameter is tied, so that the
    terms are the parameters.
    """
    mixing = None if model.terms is model.parameters else model.mixing
    terms = [_LAYOUT.table(term) for term in model.terms]
    return {"set": model.name, "places": model.places, "terms": terms, "mixing": mixing}
