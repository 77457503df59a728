"""What was true of a simulated table, as JSON beside it: SI units, the unit in each key's suffix.

docs/simulation.md describes the keys. The file is complete: with the nominal URDF alone, true positions follow from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import CalibError, FileError
from calib.measure.cell_parts import vector
from calib.measure.simulation import Simulated, VirtualCell
from calib.measure.truth import Truth
from calib.model.error_model import error_model
from calib.model.files import damage, json_bytes, read_json, write_atomically
from calib.model.readback import check_written, random_joint_values
from calib.model.robot import Robot, read_only
from calib.model.torques import Payload

Array = NDArray[np.float64]

SCHEMA = "truth 1"


def truth_table(cell: VirtualCell, simulated: Simulated) -> dict[str, Any]:
    """The file's content: nested dictionaries of numbers, texts and lists."""
    truth, robot = simulated.truth, simulated.truth.nominal
    return {
        "schema": SCHEMA,
        "seed": simulated.seed,
        "robot": {
            "name": robot.name,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "joints": list(robot.joint_names),
            "held": [{"joint": name, "value": value} for name, value in sorted(robot.held.items())],
        },
        "model": {"set": truth.model.name, "ties": _ties(truth)},
        "parameters": [
            {"name": p.name, "unit": p.unit, "value": float(value)}
            for p, value in zip(truth.model.parameters, truth.x, strict=True)
        ],
        "displacements": _displacements(truth),
        "origins": [
            {"joint": name, **_pose(T)} for name, T in sorted(truth.robot.origins().items())
        ],
        "targets": [
            {
                "target": name,
                **_pose(T),
                "said_xyz_m": said[:3, 3].tolist(),
                "said_rpy_rad": _rpy(said),
            }
            for name, T, said in zip(
                truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True
            )
        ],
        "set_ups": [
            {"group": name, **{f"frame_base_{key}": v for key, v in _pose(T).items()}}
            for name, T in zip(truth.groups, truth.T_frame_base, strict=True)
        ],
        "payload": None
        if truth.payload is None
        else {"mass_kg": float(truth.payload.mass), "com_m": truth.payload.com.tolist()},
        "gravity_m_s2": truth.gravity.tolist(),
        "instrument": _instrument(cell),
        "events": _events(cell, simulated),
        "rows": _rows(simulated),
    }


def write_truth(
    cell: VirtualCell, simulated: Simulated, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write what was true of a simulated table.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_atomically(path, json_bytes(truth_table(cell, simulated)), overwrite=overwrite)


def read_truth(path: str | Path, robot: Robot) -> Truth:
    """Read back the truth: robot, targets and frames.

    Args:
        path: What `write_truth` wrote.
        robot: The nominal robot, with the same base and tip.

    Raises:
        FileError: It cannot be read, is no JSON, no truth of calib, or damaged.
        CalibError: It is the truth of another robot.
    """
    expected = f"the truth of a simulated table has {SCHEMA!r}. Give the file that 'calib simulate --truth' wrote."
    table = read_json(path, "truth", SCHEMA, expected)
    damages = (KeyError, TypeError, ValueError, AttributeError, OverflowError, CalibError)
    try:
        other = _another_robot(table["robot"], robot)
        truth = None if other else _truth(table, robot)
    except damages as error:
        message = (
            f"{path}: the truth is incomplete or damaged ({damage(error)}). Simulate it again."
        )
        raise FileError(message) from error
    if truth is None:
        message = f"{path}: this is the truth of another robot: {other}"
        raise CalibError(message)
    return truth


def write_true_urdf(truth: Truth, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the URDF of the true geometry, after reading it back with Pinocchio and yourdfpy.

    Raises:
        UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
        FileError: The file exists, or cannot be written.
    """
    q = random_joint_values(truth.robot)
    check_written(truth.robot, truth.robot.poses(q), q)
    return truth.robot.urdf.write(path, overwrite=overwrite)


def _another_robot(said: Mapping[str, Any], robot: Robot) -> str:
    """What tells that a truth is not of this robot; "" if it is."""
    for what, given, found in (
        ("joints", list(said["joints"]), list(robot.joint_names)),
        ("base", said["base"], robot.base),
        ("tip", said["tip"], robot.tip),
        ("URDF's SHA-256", said["urdf_sha256"], robot.urdf.sha256),
    ):
        if given != found:
            return f"its {what} is {given!r}, that of '{robot.name}' is {found!r}."
    return ""


def _truth(table: Mapping[str, Any], robot: Robot) -> Truth:
    """The truth from its tables."""
    ties = {one["name"]: (one["other"], float(one["factor"])) for one in table["model"]["ties"]}
    model = error_model(robot, table["model"]["set"], target=False)
    own = {term.name for term in model.terms} - set(model.names)  # those that the set itself ties
    model = model.tied({name: tie for name, tie in ties.items() if name not in own})
    values = {one["name"]: float(one["value"]) for one in table["parameters"]}
    model = model.without(name for name in model.names if name not in values)
    placements = robot.urdf.with_origins(
        {one["joint"]: _matrix(one["xyz_m"], one["rpy_rad"]) for one in table["origins"]}
    )
    targets, set_ups, payload = table["targets"], table["set_ups"], table["payload"]
    return Truth(
        nominal=robot,
        robot=robot.rebuilt(placements),
        model=model,
        x=read_only([values[name] for name in model.names]),
        groups=tuple(one["group"] for one in set_ups),
        T_frame_base=read_only(
            [_matrix(one["frame_base_xyz_m"], one["frame_base_rpy_rad"]) for one in set_ups]
        ),
        targets=tuple(one["target"] for one in targets),
        T_tip_target=read_only([_matrix(one["xyz_m"], one["rpy_rad"]) for one in targets]),
        said_T_tip_target=read_only(
            [_matrix(one["said_xyz_m"], one["said_rpy_rad"]) for one in targets]
        ),
        payload=None
        if payload is None
        else Payload(float(payload["mass_kg"]), np.array(payload["com_m"], dtype=np.float64)),
        gravity=vector(table["gravity_m_s2"], "gravity", "m/s^2"),
    )


def _ties(truth: Truth) -> list[dict[str, Any]]:
    """Errors that follow others, by what of them."""
    model = truth.model
    ties = []
    for term, row in zip(model.terms, model.mixing, strict=True):
        leader = int(np.argmax(np.abs(row)))
        if term.name not in model.names:
            other = model.names[leader]
            ties.append({"name": term.name, "other": other, "factor": float(row[leader])})
    return ties


def _displacements(truth: Truth) -> list[dict[str, Any]]:
    """Every term of the error model: where it acts, along which twist, and how far.

    The twist is in metres, and in radians, of a unit of the value. ``times`` is the number of the joint's state that
    multiplies it: "" for 1, "gain", "sin", "cos", "compliance" or that of a registered family.
    """
    values = truth.model.values(truth.x)
    return [
        {
            "name": term.name,
            "place": term.place,
            "twist": term.direction.tolist(),
            "value": float(value),
            "times": term.factor.name if term.factor else "",
        }
        for term, value in zip(truth.model.terms, values, strict=True)
    ]


def _instrument(cell: VirtualCell) -> dict[str, Any]:
    """The noise and the steps of what measured."""
    noise = cell.noise
    return {
        "kind": cell.kind,
        "noise": None
        if noise is None
        else {
            "constant_m": noise.constant,
            "per_length_m_per_m": noise.per_length,
            "repeatability_m": noise.repeatability,
        },
        "sigma_angle_rad": float(cell.sigma_angle),
        "tracker_base_xyz_m": None if cell.tracker is None else cell.tracker.tolist(),
        "encoder_step_rad": float(cell.encoder.angle),
        "encoder_step_m": float(cell.encoder.length),
        "visits": int(cell.visits),
    }


def _events(cell: VirtualCell, simulated: Simulated) -> dict[str, Any]:
    """Outliers, a moved target, drift."""
    rows = simulated.measurements.rows
    outliers = [
        {"row": rows[i], "displacement_m": simulated.outliers[i].tolist()}
        for i in np.flatnonzero(np.any(simulated.outliers != 0.0, axis=1))
    ]
    moved = cell.moved
    return {
        "outliers": outliers,
        "moved_target": None
        if moved is None
        else {
            "from_row": int(moved.row),
            "target": moved.target,
            "displacement_m": moved.by.tolist(),
        },
        "drift_m": cell.drift.tolist(),
    }


def _rows(simulated: Simulated) -> list[dict[str, Any]]:
    """For each row where the robot stood, the target's true place, and the noise's standard deviation."""
    table = simulated.measurements
    return [
        {
            "row": table.rows[i],
            "target": table.targets[i],
            "group": table.groups[i],
            "joints": simulated.q[i].tolist(),
            "xyz_m": simulated.points[i].tolist(),
            "sigma_m": float(simulated.sigma[i]),
        }
        for i in range(len(table))
    ]


def _pose(T: Array) -> dict[str, list[float]]:
    """A pose, [m] and [rad]."""
    return {"xyz_m": T[:3, 3].tolist(), "rpy_rad": _rpy(T)}


def _rpy(T: Array) -> list[float]:
    """Roll, pitch, yaw about fixed axes x, y, z [rad]."""
    return [float(v) for v in pin.rpy.matrixToRpy(np.ascontiguousarray(T[:3, :3]))]


def _matrix(xyz: Any, rpy: Any) -> Array:  # noqa: ANN401  JSON values are of any kind
    """A pose from its JSON form."""
    numbers = np.array([*xyz, *rpy], dtype=np.float64)
    if numbers.shape != (6,) or not all(map(math.isfinite, numbers)):
        message = f"six finite numbers expected, {xyz!r} and {rpy!r} found"
        raise ValueError(message)
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*numbers[3:])
    T[:3, 3] = numbers[:3]
    return T
