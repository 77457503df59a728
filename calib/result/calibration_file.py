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

import calib.basics.plugins as plugins
from calib.basics.arrays import Array, read_only
from calib.basics.channels import Channels, residual_unit
from calib.basics.files import write_atomically
from calib.basics.json_files import Json, JsonLayout, Key, damage, json_bytes, nested, read_json
from calib.diagnosis.coverage import OutsideRow
from calib.diagnosis.reasons import Reason
from calib.errors import CalibError, FileError, PluginError
from calib.fit.registration.setup import Setup
from calib.fit.selection.candidates import Candidate
from calib.fit.selection.robustness import Robustness
from calib.model.families import FAMILIES, Factor, factor_of
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability
from calib.model.parameters import SETUP, ErrorModel, Parameter
from calib.numerics.correlated_noise import PoseNoise
from calib.numerics.errors import CrossValidation, Errors, UnitErrors
from calib.numerics.repeats import Repeats
from calib.result.calibration import Calibration, Source
from calib.result.cameras_file import boards_table, cameras_table, read_boards, read_cameras
from calib.result.prediction import FittedModel, NonGeometric
from calib.robot.coupled_readings import coupling_of_table, coupling_table
from calib.robot.gravity import Payload
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.version import __version__

#: The layout of a result.
SCHEMA = 7


def error_table(errors: Errors) -> dict[str, Any]:
    """Return the table of errors of one set of rows, see docs/result-json.md.

    Args:
        errors: Largest, mean and rms errors in each unit that was measured.

    Returns:
        A table for each unit by its symbol, such as ``"m"``: ``"n"``, the number of rows; ``"max"``, ``"mean"`` and
        ``"rms"`` of the norms, in this unit; and ``"mean_axis"``, ``"rms_axis"`` and ``"span_axis"``, shape (3,), along
        x, y, z.
    """
    tables = {}
    for unit, figures in errors.by_unit.items():
        tables[unit] = _LAYOUT.table(figures)
    return tables


def _read_errors(table: Json) -> Errors:
    """Return errors from their tables by unit in the file, as `error_table` makes them."""
    by_unit = {}
    for unit, figures in table.items():
        by_unit[unit] = UnitErrors(unit=unit, **_LAYOUT.values(UnitErrors, figures))
    return Errors(by_unit)


def _channels_table(channels: Channels) -> dict[str, Any]:
    """Return the channels of residuals' entries as a table for the file: their units, and the index of each entry's."""
    return {"units": channels.units, "vectors": channels.vectors, "index": channels.index}


def _read_channels(table: Json) -> Channels:
    """Return the channels of residuals' entries from their table in the file."""
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
        Rx(roll); both behind the prefix.
    """
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}


def _prior_std_key(family: str) -> str:
    """Return the key of a family's prior standard deviation in the file, with its unit.

    Args:
        family: Name of a family of parameters, of `calib.model.families.FAMILIES`.

    Returns:
        The family's name and the unit, such as ``"length_m"``.
    """
    return f"{family}_{FAMILIES[family].unit.key}"


def _prior_std_table(prior_std: Mapping[str, float]) -> dict[str, float]:
    """Return the table of prior standard deviations for the file.

    Args:
        prior_std: Standard deviation of the prior of a family's errors, such as of lengths, by the family's name, in
            its SI unit.

    Returns:
        The same values by the family's name with the unit behind it, such as ``"length_m"``.
    """
    return {_prior_std_key(family): std for family, std in prior_std.items()}


def _read_prior_std(table: Json) -> dict[str, float]:
    """Return prior standard deviations from their table in the file.

    Args:
        table: Values in SI units, by the family's name with the unit behind it, such as ``"length_m"``; families may be
            missing.

    Returns:
        Standard deviation of the prior of each family that the table has, by the family's name, in its SI unit.
    """
    keys = {family: _prior_std_key(family) for family in FAMILIES}
    return {family: float(table[key]) for family, key in keys.items() if key in table}


def _values_table(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the values of a verdict's reason as a list for the file, in their order.

    Args:
        values: Numbers, in SI units, and words of a reason, by name, such as ``"noise_m"``.

    Returns:
        One table ``{"name": ..., "value": ...}`` for each.
    """
    return [{"name": name, "value": value} for name, value in values.items()]


def _read_values(table: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the values of a verdict's reason from their list in the file.

    Args:
        table: Tables ``{"name": ..., "value": ...}``.

    Returns:
        Each value by its name, in the order of the list.
    """
    return {row["name"]: row["value"] for row in table}


def _ties_table(ties: Mapping[str, tuple[str, float]]) -> list[dict[str, Any]]:
    """Return tied parameters as a list for the file.

    Args:
        ties: Of each parameter that follows another one, by its name, the other's name and the factor:
            x_name = factor x_other.

    Returns:
        One table ``{"name": ..., "other": ..., "factor": ...}`` for each.
    """
    table = []
    for name, (other, factor) in ties.items():
        table.append({"name": name, "other": other, "factor": factor})
    return table


def _read_ties(table: Any) -> dict[str, tuple[str, float]]:  # noqa: ANN401
    """Return tied parameters from their list in the file.

    Args:
        table: Tables ``{"name": ..., "other": ..., "factor": ...}``.

    Returns:
        By the name of each parameter that follows another one, the other's name and the factor:
        x_name = factor x_other.
    """
    return {row["name"]: (row["other"], float(row["factor"])) for row in table}


def _read_ranges(table: Any) -> Array:  # noqa: ANN401
    """Return the ends of the joints' fitted ranges from their rows in the file.

    Args:
        table: Smallest and largest value of each of m joints, [rad] or [m]; NaN or None where no row was fitted.

    Returns:
        shape (m, 2), read-only; from infinity down to minus infinity where no row was fitted.
    """
    ends = np.array(table, dtype=np.float64)
    return read_only(np.where(np.isnan(ends), [np.inf, -np.inf], ends))


def _read_condition(value: float | None) -> float:
    """Return the condition number of an identification Jacobian from its value in the file.

    Args:
        value: Largest over smallest singular value; None, null in the file, where it is infinite.
    """
    return np.inf if value is None else float(value)


def _read_square(rows: Any) -> Array:  # noqa: ANN401
    """Return a square matrix, such as a covariance, from its rows in the file.

    Args:
        rows: p rows of p numbers each; p may be 0. None stands for a missing number.

    Returns:
        shape (p, p), read-only; NaN for a missing number.
    """
    return read_only(np.array(rows, dtype=float).reshape(len(rows), -1))


def _read_base_motion(rows: Any) -> Array | None:  # noqa: ANN401
    """Return a compensating motion of the base from its rows in the file.

    Args:
        rows: Six rows of p numbers; None or empty where there is no such motion.

    Returns:
        shape (6, p), for a unit of each of p parameters the motion of the base, linear [m] then angular [rad]; None
        where there is none. See `calib.result.prediction.FittedModel.base_motion`.
    """
    return np.reshape(rows, (6, -1)) if rows else None


#: The prior standard deviations of families.
_PRIOR_STD = Key("prior_std", _prior_std_table, _read_prior_std)

#: Where attributes stand in the file, by class; see `JsonLayout`.
_LAYOUT: JsonLayout = JsonLayout(
    {
        UnitErrors: {"unit": None},
        CrossValidation: {"errors_without_outliers": "without_outliers"},
        OutsideRow: {"beyond": "joints"},
        Reason: {
            "why": "code",
            "values": Key("values", _values_table, _read_values),
        },
        Payload: {"mass": "mass_kg", "com": "com_m"},
        PoseNoise: {
            "position": "position_m",
            "orientation": "orientation_rad",
            "joint": "joint_rad",
        },
        Repeats: {"within": "scatter", "freedoms": "freedom", "rho": "correlation"},
        Candidate: {"name": "set", "prior_std": _PRIOR_STD},
        Robustness: {
            "lowered": "weights_lowered",
            "moved_rms": "moved_rms_m",
            "moved_max": "moved_max_m",
            "errors_lowered": "lowered",
            "errors_full": "full",
        },
        Observability: {"condition": Key("condition", None, _read_condition)},
        FittedModel: {
            "kinematics": None,
            "setup": "frames",
            "covariance": Key("covariance", None, _read_square),
            "base_motion": Key("base_motion", None, _read_base_motion),
            "prior_std": _PRIOR_STD,
            "expected_measured": "expected.measured_rms_m",
            "expected_everywhere": "expected.everywhere_rms_m",
            "extrapolation": "expected.extrapolation",
        },
        NonGeometric: {"gravity": "gravity_m_s2"},
        Calibration: {
            **dict.fromkeys(("nominal", "robot", "source", "fit")),
            "setup": "frames.",
            "nominal_setup": "frames.nominal",
            "frame_estimated": "frames.frame_estimated",
            "rows": "rows.",
            **{
                name: f"rows.{name}"
                for name in ("residual_nominal", "residual_calibrated", "scores", "weights")
            },
            "channels": Key("rows.channels", _channels_table, _read_channels),
            "metres_per_pixel": "rows.metres_per_pixel",
            "nominal_cameras": Key("nominal_cameras", cameras_table, read_cameras),
            "nominal_boards": Key("nominal_boards", boards_table, read_boards),
            "ranges": Key("robot.ranges", None, _read_ranges),
            **{
                name: f"noise.{name}"
                for name in ("freedom", "repeats", "pose_noise", "prior_std_from", "flag_limit")
            },
            "prior_std": replace(_PRIOR_STD, path="noise.prior_std"),
            "sigma": "noise.sigma",
            "sigma_given": "noise.sigma_given",
            **{name: f"model.{name}" for name in ("frozen", "candidates")},
            "ties": Key("model.ties", _ties_table, _read_ties),
            "solver": "solver.name",
            "seconds": "solver.seconds",
            "solution": "solver.",
        },
    },
    {
        Errors: (error_table, _read_errors),
        Factor: (lambda factor: factor.name, factor_of),
    },
)


def versions() -> dict[str, str]:
    """Return the versions of calib, of Python, and of the packages that computed the result.

    By ``"calib"``, ``"python"``, ``"pin"``, ``"numpy"`` and ``"scipy"``.
    """
    packages = {name: importlib.metadata.version(name) for name in ("pin", "numpy", "scipy")}
    return {"calib": __version__, "python": platform.python_version(), **packages}


def result_table(c: Calibration) -> dict[str, Any]:
    """Return a result as nested tables of plain values and arrays, before missing numbers become null.

    Args:
        c: The calibration result; its measurements and fits in memory are no part of the tables.

    Returns:
        The tables of docs/result-json.md, in SI units, the unit in the suffix of each key.
    """
    table = nested(_derived_values(c))
    for key, value in _LAYOUT.table(c).items():
        if isinstance(value, dict):
            table[key] = table.get(key, {}) | value
        else:
            table[key] = value
    table["solver"]["iterations"] = c.solution.iterations
    if c.non_geometric is not None:
        table["non_geometric"] |= {
            "errors": table["errors"]["non_geometric"],
            "model": _model_table(c.non_geometric.model),
        }
    table["plugins"] = plugins.plugin_tables(_registered_names(table))
    return table


def _registered_names(table: Json) -> dict[str, set[str]]:
    """Return the names of registries that a result uses.

    Args:
        table: The tables of a result.

    Returns:
        Names of families, kinds, solvers and parameter sets, by the keys of `calib.plugins.WORDS`.
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


def _derived_values(c: Calibration) -> dict[str, Any]:
    """Return what the file has besides the attributes of a calibration result.

    Args:
        c: The result.

    Returns:
        By their path in the file, in SI units: ``"schema"``, the number of the layout; ``"robot"``, ``"robot.held"``,
        ``"robot.coupling"``, ``"robot.origins"`` and ``"robot.nominal_origins"``, names, held joint values, factors of
        coupled readings and joint origins; ``"frames"``
        with ``"frames.target_given_m"``, None if the first target was not given, and ``"frames.target_estimated"``;
        ``"errors"`` by robot and set of rows; ``"cameras"`` and ``"boards"`` as estimated; ``"model"``;
        ``"inputs.urdf"``, ``"inputs.urdf.text"``, ``"inputs.measurements"`` and ``"inputs.measurements.rows"``, names,
        hashes and number of rows; and ``"versions"``.
    """
    robot, urdf = c.nominal, c.nominal.urdf
    target_given = c.setup.target_given[0]
    errors = {}
    for name, sets in c.errors.items():
        errors[name] = {rows: error_table(of_rows) for rows, of_rows in sets.items()}
    return {
        "schema": SCHEMA,
        "robot": {
            "name": robot.name,
            "base": robot.base,
            "tip": robot.tip,
            "joints": robot.joint_names,
        },
        "robot.held": [{"joint": name, "value": value} for name, value in robot.held.items()],
        "robot.coupling": coupling_table(robot.reading_coupling),
        "robot.origins": _origins_table(c.robot),
        "robot.nominal_origins": _origins_table(robot),
        "frames": {**pose_table(c.T_frame_base, "frame_base_"), "target_m": c.target},
        "frames.target_given_m": c.nominal_setup.T_tip_target[0, :3, 3] if target_given else None,
        "frames.target_estimated": c.setup.estimate_target,
        "errors": errors,
        "cameras": cameras_table(c.cameras),
        "boards": boards_table(c.boards),
        "model": _model_table(c.model),
        "inputs.urdf": {"name": urdf.source, "sha256": urdf.sha256},
        "inputs.urdf.text": urdf.data.decode("utf-8", "surrogateescape"),
        "inputs.measurements": _source_table(c.source),
        "inputs.measurements.rows": len(c.rows),
        "versions": versions(),
    }


def _origins_table(robot: Robot) -> list[dict[str, Any]]:
    """Return the joint origins of a robot as a list for the file.

    Args:
        robot: The robot, nominal or corrected.

    Returns:
        For each joint its name and its pose in the link before it at joint value 0, as in the URDF's <origin>:
        ``{"joint": ..., "xyz_m": ..., "rpy_rad": ...}``.
    """
    return [{"joint": name, **pose_table(T)} for name, T in robot.origins().items()]


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
        overwrite: Whether a file that exists is replaced.
        extra: Further keys at the top, which win over the result's; None: no further ones.

    Returns:
        The path.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_table(result_table(c) | dict(extra or {}), path, overwrite=overwrite)


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
        The result, equal to the one written but for its measurements and fits in memory.

    Raises:
        FileError: It cannot be read, is no result, of another schema, or damaged.
        PluginError: It uses a family or a kind of a plugin that is not loaded.
    """
    expected = (
        f"a result of calib {__version__} has {SCHEMA}. Results are written by calib calibrate ROBOT DATA --json "
        "result.json"
    )
    table = read_json(path, "calibration result", SCHEMA, expected)
    try:
        plugins.check_registered(_registered_names(table), table.get("plugins", ()))
        return _calibration(table, Path(path).parent)
    except PluginError as error:
        raise PluginError(f"{path}: {error}") from error
    except (
        CalibError, KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError,
    ) as error:  # fmt: skip
        raise FileError(
            f"{path}: the result is damaged ({damage(error)}). Write it again with 'calib calibrate --json'."
        ) from error


def _calibration(table: Json, folder: Path) -> Calibration:
    """Return a calibration result from its tables.

    Args:
        table: The tables of a result file, see docs/result-json.md.
        folder: The file's folder; meshes are looked for beside the URDF, if that is in the folder.

    Returns:
        The result, without measurements and fits in memory.

    Raises:
        ValueError: The tables contradict each other, or a number is missing. A damaged table raises other errors too.
    """
    nominal, inputs = _nominal(table, folder), table["inputs"]
    values = _model_values(Calibration, table, nominal)
    lengths = len(values["ranges"]), len(values["rows"])
    if lengths != (len(nominal.joint_names), inputs["measurements"]["rows"]):
        raise ValueError("'robot.ranges' or 'rows' are not those of the result")
    non_geometric = None
    if table["non_geometric"] is not None:
        attributes = _model_values(NonGeometric, table["non_geometric"], nominal)
        non_geometric = NonGeometric(**attributes)
    return Calibration(
        **values,
        nominal=nominal,
        robot=values["kinematics"].model.apply(nominal, values["x"]),
        source=_source(inputs["measurements"]),
        non_geometric=non_geometric,
    )


def _source_table(source: Source) -> dict[str, Any]:
    """Return the name and the SHA-256 of the measurements, and the convention of their orientations, None without."""
    convention = source.orientation or None
    return {"name": source.name, "sha256": source.sha256, "orientation": convention}


def _source(table: Json) -> Source:
    """Return the file of the measurements; a result of an earlier version does not say how it gave orientations."""
    return Source(table["name"], table["sha256"], table.get("orientation") or "")


def _nominal(table: Json, folder: Path) -> Robot:
    """Return the nominal robot from the tables of a result file.

    Args:
        table: All tables of the file. Used are ``"robot"``, with base, tip, held joint values, [rad] or [m], and
            factors of coupled readings, and ``"inputs"."urdf"``, with the nominal URDF's name and text.
        folder: The folder where the URDF is looked for, if only for the meshes beside it.

    Returns:
        The robot, its base, tip, held joint values and coupled readings as stored.
    """
    robot, stored = table["robot"], table["inputs"]["urdf"]
    data = stored["text"].encode("utf-8", "surrogateescape")
    urdf = Urdf.from_bytes(data, stored["name"], folder / stored["name"])
    held = {row["joint"]: float(row["value"]) for row in robot["held"]}
    coupling = coupling_of_table(robot.get("coupling", ()))  # files of earlier versions have none
    return Robot.from_urdf(urdf, robot["base"], robot["tip"], held=held, coupling=coupling)


def _model_values(kind: type[FittedModel], table: Json, nominal: Robot) -> dict[str, Any]:
    """Return the attributes of a fitted model, by their names, from its table in a result file.

    Args:
        kind: The class whose attributes they are: `Calibration`, or `NonGeometric`.
        table: Its table: the whole file for the first, that of the non-geometric model for the second.
        nominal: The nominal robot.

    Returns:
        Arguments of the class by name: all that the table holds, such as ``"x"``, the p parameters, shape (p,), and
        ``"setup"``, frames and targets at the solution, but not ``"non_geometric"``; and ``"kinematics"``, the nominal
        robot under the error model, which follows from them.

    Raises:
        ValueError: A number that a fitted model has is missing.
    """
    values = _LAYOUT.values(kind, table, excluded=("non_geometric",))
    names = [parameter.name for parameter in values["parameters"]]
    model = _model_of(table["model"], names)
    _check_numbers(values)
    values["kinematics"] = _kinematics(nominal, model, values["setup"], values["x"])
    return values


def _check_numbers(values: Mapping[str, Any]) -> None:
    """Refuse a fitted model of whose parameters, covariance, frames or targets a number is missing.

    Args:
        values: Attributes of the model by their names, of which are used: ``"x"``, the parameters, shape (p,);
            ``"covariance"``, which must have the shape (p, p); ``"setup"``, with T_frame_base and T_tip_target, stacks
            of shape (4, 4) matrices [m]; and ``"parameters"``, whose ``data_gradient`` must be finite. A missing number
            is NaN.

    Raises:
        ValueError: One is missing or infinite, or the shapes do not fit.
    """
    x, covariance, setup = values["x"], values["covariance"], values["setup"]
    arrays = (x, covariance, setup.T_frame_base, setup.T_tip_target)
    gradients = [parameter.data_gradient for parameter in values["parameters"]]
    numbers = np.concatenate([gradients, *(np.ravel(array) for array in arrays)])
    if covariance.shape != x.shape * 2 or not np.isfinite(numbers).all():
        raise ValueError("a number is missing")


def _kinematics(nominal: Robot, model: ErrorModel, setup: Setup, x: Array) -> Kinematics:
    """Return the nominal robot under an error model, with frames and targets where the parameters count from.

        T_frame_base(0) = T_frame_base(x) D_frame(x)^-1,    T_tip_target(0) = T_tip_target(x) D_target(x)^-1

    with the displacements D that the parameters x make.

    Args:
        nominal: The nominal robot.
        model: Its error model of p parameters, those of frames and targets included.
        setup: Frames and targets at the solution: T_frame_base, pose of the base in each of F frames, and T_tip_target,
            pose of each of T targets in the tip, shapes (F, 4, 4) and (T, 4, 4), [m].
        x: The parameters at the solution, shape (p,), offsets from the start of the fit [m, rad, ...].

    Returns:
        The nominal robot with T_frame_base and T_tip_target at parameters of zero.
    """
    displacements, _ = model.displacements(x)
    back = np.linalg.inv(displacements)
    frames = setup.T_frame_base @ back[: len(setup.groups)]
    targets = setup.T_tip_target @ back[-len(setup.targets) :]
    return Kinematics(nominal, model, frames, targets)


def _model_table(model: ErrorModel) -> dict[str, Any]:
    """Return an error model as a table for the file.

    Args:
        model: The model of p parameters: its ``places``, such as frames, joints and targets, and its ``terms``, each an
            error at a place: the parameters, and errors that are tied to them.

    Returns:
        ``"set"``, its name, such as ``"dh"``; ``"places"``, their names; ``"terms"``, one table each; and ``"mixing"``,
        shape (terms, p): the values of the terms are mixing @ x with the p parameters x; None where no parameter is
        tied, so that the terms are the parameters.
    """
    mixing = None if model.terms is model.parameters else model.mixing
    terms = [_LAYOUT.table(term) for term in model.terms]
    return {"set": model.name, "places": model.places, "terms": terms, "mixing": mixing}


def _model_of(table: Json, names: Sequence[str]) -> ErrorModel:
    """Return an error model from its table in the file.

    Args:
        table: The table, as `_model_table` makes it: ``"set"``, the model's name; ``"places"``; ``"terms"``, a table
            for each error at a place; and ``"mixing"``, shape (terms, p), by which the terms follow the parameters, or
            None.
        names: Names of the p parameters in the order of the parameter vector x; the other terms are tied to these.

    Returns:
        The model: its p parameters, its terms, and how these follow the parameters.

    Raises:
        KeyError: A parameter that is no term of the table.
        ValueError: No parameter is tied, and the terms are not the parameters.
    """
    terms = tuple(_LAYOUT.read(Parameter, term) for term in table["terms"])
    by_name = {term.name: term for term in terms}
    parameters = tuple(by_name[name] for name in names)
    places = tuple(table["places"])
    if table["mixing"] is not None:
        mixing = np.array(table["mixing"], dtype=np.float64).reshape(len(terms), len(names))
        return ErrorModel(table["set"], places, parameters, terms, read_only(mixing))
    if parameters != terms:
        raise ValueError("'parameters' and 'model.terms' name other parameters")
    return ErrorModel(table["set"], places, terms)
