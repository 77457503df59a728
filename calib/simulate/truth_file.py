"""What was true of a simulated table, as JSON beside it: SI units, the unit in each key's suffix.

docs/simulation.md describes the keys. The file is complete: with the nominal URDF alone, true positions follow from it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.model.files import json_bytes, write_atomically
from calib.model.readback import check_written, random_joint_values
from calib.simulate.scenario import Scenario, Simulated
from calib.simulate.truth import Truth

Array = NDArray[np.float64]

SCHEMA = "truth 1"


def truth_table(scenario: Scenario, simulated: Simulated) -> dict[str, Any]:
    """The file's content: nested dictionaries of numbers, texts and lists.

    Raises:
        UrdfError: No ``<origin>`` of the URDF can hold one of the errors.
    """
    truth, robot = simulated.truth, simulated.truth.nominal
    values = truth.model.values(truth.x)
    targets = zip(truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True)
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
        "displacements": [
            {
                "name": term.name,
                "place": term.place,
                "twist": term.direction.tolist(),
                "value": float(value),
                "times": term.factor.name if term.factor else "",
            }
            for term, value in zip(truth.model.terms, values, strict=True)
        ],
        "origins": [
            {"joint": name, **_pose(T)} for name, T in sorted(truth.robot.origins().items())
        ],
        "targets": [
            {"target": name, **_pose(T), **_pose(said, "said_")} for name, T, said in targets
        ],
        "set_ups": [
            {"group": name, **_pose(T, "frame_base_")}
            for name, T in zip(truth.groups, truth.T_frame_base, strict=True)
        ],
        "payload": None
        if truth.payload is None
        else {"mass_kg": float(truth.payload.mass), "com_m": truth.payload.com.tolist()},
        "gravity_m_s2": truth.gravity.tolist(),
        "instrument": _instrument(scenario),
        "events": _events(scenario, simulated),
        "rows": _rows(simulated),
    }


def write_truth(
    scenario: Scenario, simulated: Simulated, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write what was true of a simulated table.

    Raises:
        UrdfError: No ``<origin>`` of the URDF can hold one of the errors.
        FileError: The file exists, or cannot be written.
    """
    content = json_bytes(truth_table(scenario, simulated))
    return write_atomically(path, content, overwrite=overwrite)


def write_true_urdf(truth: Truth, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the URDF of the true geometry, after reading it back with Pinocchio and yourdfpy.

    Raises:
        UrdfError: A reader disagrees with the model in memory by more than 1e-9 m or rad.
        FileError: The file exists, or cannot be written.
    """
    robot = truth.robot
    q = random_joint_values(robot)
    check_written(robot, robot.poses(q), q)
    return robot.urdf.write(path, overwrite=overwrite)


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


def _instrument(cell: Scenario) -> dict[str, Any]:
    """The noise and the steps of what measured."""
    noise = cell.noise
    return {
        "kind": cell.kind.name,
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


def _events(cell: Scenario, simulated: Simulated) -> dict[str, Any]:
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


def _pose(T: Array, prefix: str = "") -> dict[str, list[float]]:
    """A pose, [m], and roll, pitch, yaw about fixed axes x, y, z [rad]."""
    rpy = pin.rpy.matrixToRpy(np.ascontiguousarray(T[:3, :3]))
    return {f"{prefix}xyz_m": T[:3, 3].tolist(), f"{prefix}rpy_rad": [float(v) for v in rpy]}
