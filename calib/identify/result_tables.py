"""The parts of a result as tables of its JSON file, each there and back; see `calib.identify.result_file`."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.families import FAMILIES, family_of
from calib.identify.findings import ParameterEstimate
from calib.identify.prediction import Larger
from calib.identify.result_rows import residuals_of
from calib.identify.robust import Repeats
from calib.identify.robustness import Robustness
from calib.identify.selection import Candidate
from calib.identify.setup import Setup
from calib.identify.statistics import CrossValidation, Errors
from calib.identify.table_fields import (
    ANGLES,
    COMBINATION,
    ERRORS,
    PARAMETER,
    TERM,
    Json,
    flags,
    from_table,
    number,
    numbers,
    to_table,
    words,
)
from calib.model.kinematics import Kinematics
from calib.model.observability import Combination, Observability
from calib.model.parameters import ErrorModel, Parameter
from calib.model.robot import Robot, read_only
from calib.model.torques import Payload
from calib.version import __version__

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def errors_table(errors: Errors) -> dict[str, Any]:
    """Errors of one set of rows."""
    return to_table(errors, ERRORS) | (to_table(errors, ANGLES) if errors.n_angle else {})


def errors_of(table: Json) -> Errors:
    """The same back."""
    return from_table(Errors, table, (*ERRORS, *(ANGLES if "n_rad" in table else ())))


def left_out_table(v: CrossValidation) -> dict[str, Any]:
    """Errors on left-out rows; those of the flagged ones included at the top, left out below."""
    return {
        "method": v.method,
        "folds": v.folds,
        **errors_table(v.errors),
        "without_outliers": errors_table(v.errors_without_outliers),
    }


def left_out_of(table: Json, poses: NDArray[np.int_], residual: Array) -> CrossValidation:
    """The same back, with what stands in the rows."""
    return CrossValidation(
        method=table["method"],
        folds=int(table["folds"]),
        poses=poses,
        residual=residual,
        errors=errors_of(table),
        errors_without_outliers=errors_of(table["without_outliers"]),
    )


def sizes_table(sizes: Mapping[str, float]) -> dict[str, float]:
    """The size of each family's errors, the unit in the key."""
    return {f"{name}_{FAMILIES[name].unit.key}": size for name, size in sizes.items()}


def sizes_of(table: Json) -> dict[str, float]:
    """The same back."""
    keys = {f"{name}_{row.unit.key}": name for name, row in FAMILIES.items()}
    return {keys[key]: float(size) for key, size in table.items()}


def origins_table(robot: Robot) -> list[dict[str, Any]]:
    """The origin of each joint that carries a placement of the chain."""
    return [{"joint": carrier, **pose_table(T)} for carrier, T in robot.origins().items()]


def held_table(robot: Robot) -> list[dict[str, Any]]:
    """The joints that were not measured, with the values that they were held at."""
    slides = {joint.name for joint in robot.urdf.joints if joint.type == "prismatic"}
    return [
        {"joint": name, "value": value, "unit": "m" if name in slides else "rad"}
        for name, value in robot.held.items()
    ]


def ranges_of(table: Sequence[Json]) -> Array:
    """The measured range of each joint, shape (m, 2); infinite ends where no row was fitted."""
    ends = [[number(one["low"]), number(one["high"])] for one in table]
    ranges = np.array(ends, dtype=np.float64).reshape(-1, 2)
    return read_only(np.where(np.isnan(ranges), [np.inf, -np.inf], ranges))


def pose_table(T: Array, prefix: str = "") -> dict[str, Any]:
    """A pose as position and roll, pitch, yaw."""
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": pin.rpy.matrixToRpy(T[:3, :3])}


def pose_of(table: Json, prefix: str = "") -> Array:
    """The same back; a missing orientation is none."""
    T, rpy = np.eye(4), table[f"{prefix}rpy_rad"]
    if rpy is not None:
        T[:3, :3] = Rotation.from_euler("xyz", np.array(rpy, dtype=np.float64)).as_matrix()
    T[:3, 3] = np.array(table[f"{prefix}xyz_m"], dtype=np.float64)
    if not np.isfinite(T).all():
        raise ValueError("a number of a pose is missing")
    return read_only(T)


def places_table(setup: Setup) -> dict[str, Any]:
    """All frames and targets; a target's orientation only where it is known."""
    return {
        "set_ups": [
            {
                "group": group,
                **pose_table(setup.T_frame_base[f], "frame_base_"),
                "estimated": list(setup.unknown[f]),
                "given": bool(setup.frame_given[f]),
                "own_axes": bool(setup.own_axes[f]),
            }
            for f, group in enumerate(setup.groups)
        ],
        "targets": [
            {
                "target": name,
                **pose_table(T),
                **({} if setup.oriented else {"rpy_rad": None}),
                "estimated": bool(unknown),
                "given": bool(given),
            }
            for name, T, unknown, given in zip(
                setup.targets,
                setup.T_tip_target,
                setup.target_unknown,
                setup.target_given,
                strict=True,
            )
        ],
    }


def places_of(table: Json, *, rotation: bool) -> Setup:
    """The same back; at least one frame and one target.

    Args:
        table: Of a geometry, its nominal robot, or a larger model.
        rotation: Whether orientations were measured.
    """
    frames, targets = table["set_ups"], table["targets"]
    if not frames or not targets:
        raise ValueError("no set-ups or no targets")
    return Setup(
        groups=words([one["group"] for one in frames]),
        targets=words([one["target"] for one in targets]),
        T_frame_base=read_only([pose_of(one, "frame_base_") for one in frames]),
        T_tip_target=read_only([pose_of(one) for one in targets]),
        unknown=tuple(words(one["estimated"]) for one in frames),
        frame_given=flags([one["given"] for one in frames]),
        target_unknown=flags([one["estimated"] for one in targets]),
        target_given=flags([one["given"] for one in targets]),
        rotation=rotation,
        own_axes=flags([one["own_axes"] for one in frames]),
        oriented=all(one["rpy_rad"] is not None for one in targets),
    )


def model_table(model: ErrorModel) -> dict[str, Any]:
    """An error model: where each of its terms acts, and which parameters they follow."""
    return {
        "set": model.name,
        "places": list(model.places),
        "terms": [
            to_table(one, TERM) | {"factor": None if one.factor is None else one.factor.name}
            for one in model.terms
        ],
        "mixing": None if model.terms is model.parameters else model.mixing,
    }


def model_of(table: Json, names: Sequence[str]) -> ErrorModel:
    """The same back.

    Args:
        table: Its table.
        names: The parameters; further terms follow them.
    """
    terms = tuple(_term_of(one) for one in table["terms"])
    if table["mixing"] is None:
        return ErrorModel(table["set"], words(table["places"]), terms)
    by_name = {one.name: one for one in terms}
    parameters = tuple(by_name[name] for name in names)
    mixing = np.array(table["mixing"], dtype=np.float64).reshape(len(terms), len(parameters))
    return ErrorModel(table["set"], words(table["places"]), parameters, terms, read_only(mixing))


def _term_of(table: Json) -> Parameter:
    """A parameter from its table; the factor is that of its family."""
    factor = table["factor"]
    if factor is not None:
        factor = next(one for one in family_of(table["family"]).factors if one.name == factor)
    return from_table(lambda **values: Parameter(**values, factor=factor), table, TERM)


def kinematics_of(nominal: Robot, model: ErrorModel, setup: Setup, x: Array) -> Kinematics:
    """The nominal robot under a model, with frames and targets where x counts from."""
    back = np.linalg.inv(model.displacements(x)[0])
    count = len(setup.groups)
    return Kinematics(
        nominal,
        model,
        setup.T_frame_base @ back[:count],
        setup.T_tip_target @ back[-len(setup.targets) :],
    )


def larger_table(larger: Larger, errors: Mapping[str, Errors]) -> dict[str, Any]:
    """The larger model, which no URDF can hold."""
    v = larger.cross_validation
    return {
        **model_table(larger.model),
        "x": larger.x,
        "names": list(larger.model.names),
        "base_motion": larger.base_motion,
        "covariance": larger.covariance,
        "sizes": sizes_table(larger.sizes),
        "parameters": [to_table(p, PARAMETER) for p in larger.parameters],
        **places_table(larger.setup),
        "errors": {name: errors_table(one) for name, one in errors.items()},
        "cross_validation": None if v is None else left_out_table(v),
        "payload": None
        if larger.payload is None
        else {"mass_kg": larger.payload.mass, "com_m": larger.payload.com},
        "gravity_m_s2": larger.gravity,
    }


def larger_of(
    table: Json,
    nominal: Robot,
    rows: Sequence[Json],
    used: Mask,
    validated: CrossValidation | None,
) -> Larger:
    """The same back."""
    x = numbers(table["x"])
    setup, payload = places_of(table, rotation=used.shape[1] > 3), table["payload"]
    return Larger(
        kinematics=kinematics_of(nominal, model_of(table, table["names"]), setup, x),
        x=x,
        covariance=square(table["covariance"], len(x)),
        sizes=sizes_of(table["sizes"]),
        parameters=tuple(from_table(ParameterEstimate, p, PARAMETER) for p in table["parameters"]),
        setup=setup,
        residual=residuals_of(rows, "larger", used),
        cross_validation=validated,
        base_motion=motion_of(table),
        payload=None
        if payload is None
        else Payload(float(payload["mass_kg"]), numbers(payload["com_m"])),
        gravity=numbers(table["gravity_m_s2"]),
    )


def motion_of(table: Json) -> Array | None:
    """What a motion of the base makes up for, shape (6, p)."""
    found = table["base_motion"]
    return None if found is None else numbers(found).reshape(6, -1)


def square(table: Any, count: int) -> Array:  # noqa: ANN401
    """A covariance, shape (count, count)."""
    return read_only(np.array(table, dtype=np.float64).reshape(count, count))


def observability_of(table: Json) -> Observability:
    """What the poses determine."""
    found, parameters = table["observability"], table["parameters"]
    condition = found["condition"]
    return Observability(
        columns=int(found["columns"]),
        rank=int(found["rank"]),
        condition=np.inf if condition is None else float(condition),
        singular_values=numbers(found["singular_values"]),
        indices={name: number(value) for name, value in found["indices"].items()},
        unidentifiable=tuple(
            from_table(Combination, one, COMBINATION) for one in found["unidentifiable"]
        ),
        identifiable=flags([one["identifiable"] for one in parameters]),
    )


def candidate_table(one: Candidate) -> dict[str, Any]:
    """One step of the ladder."""
    return {
        "set": one.name,
        "parameters": one.parameters,
        "log_likelihood": one.log_likelihood,
        "sizes": sizes_table(one.sizes),
        "cross_validation": left_out_table(one.cross_validation),
        "chosen": one.chosen,
        "needed": one.needed,
    }


def candidate_of(table: Json) -> Candidate:
    """The same back."""
    v = table["cross_validation"]
    nothing = read_only(np.zeros((0, 0)))
    return Candidate(
        name=table["set"],
        parameters=int(table["parameters"]),
        log_likelihood=number(table["log_likelihood"]),
        cross_validation=left_out_of(v, np.zeros(0, dtype=int), nothing),
        sizes=sizes_of(table["sizes"]),
        chosen=table["chosen"],
        needed=float(table["needed"]),
    )


def robustness_table(found: Robustness) -> dict[str, Any]:
    """The fit with the weights of doubtful rows lowered and the one without, compared."""
    return {
        "weights_lowered": found.lowered,
        "moved_rms_m": found.moved_rms,
        "moved_max_m": found.moved_max,
        "lowered": errors_table(found.errors_lowered),
        "full": errors_table(found.errors_full),
        "flagged": found.flagged,
        "moved_m": found.moved,
        "change": found.change,
        "std": found.std,
    }


def robustness_of(table: Json, names: tuple[str, ...]) -> Robustness:
    """The same back."""
    return Robustness(
        lowered=bool(table["weights_lowered"]),
        flagged=flags(table["flagged"]),
        moved=numbers(table["moved_m"]),
        names=names,
        change=numbers(table["change"]),
        std=numbers(table["std"]),
        errors_lowered=errors_of(table["lowered"]),
        errors_full=errors_of(table["full"]),
    )


def repeats_of(table: Json | None) -> Repeats | None:
    """Scatter of repeats."""
    if table is None:
        return None
    freedoms = numbers(table["freedom"])
    return Repeats(
        numbers(table["scatter"]), freedoms, float(freedoms.sum()), float(table["correlation"])
    )


def versions() -> dict[str, str]:
    """What computed the result."""
    packages = ("pin", "numpy", "scipy")
    return {
        "calib": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in packages},
    }
