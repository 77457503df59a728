"""What was true of a simulated table, as JSON beside it: SI units, the unit in each key's suffix.

docs/simulation.md describes the keys. The file is complete: with the nominal URDF alone, true positions follow from it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.files import json_bytes, write_atomically
from calib.robot.readback import check_written, random_joint_values
from calib.simulation.scenario import Scenario, Simulated
from calib.simulation.truth import Truth

SCHEMA = "truth 1"


def write_truth(
    scenario: Scenario, made: Simulated, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write what was true of a simulated table.

    Raises:
        UrdfError: No ``<origin>`` of the URDF can hold one of the errors.
        FileError: The file exists, or cannot be written.
    """
    truth, table, robot = made.truth, made.measurements, made.truth.nominal
    model, noise, moved = truth.model, scenario.noise, scenario.moved
    targets = zip(truth.targets, truth.T_tip_target, truth.said_T_tip_target, strict=True)
    leaders = np.argmax(np.abs(model.mixing), axis=1)
    content = {
        "schema": SCHEMA,
        "seed": made.seed,
        "robot": {
            "name": robot.name,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "joints": robot.joint_names,
            "held": [{"joint": name, "value": value} for name, value in sorted(robot.held.items())],
        },
        "model": {
            "set": model.name,
            "ties": [
                {"name": term.name, "other": model.names[leader], "factor": row[leader]}
                for term, row, leader in zip(model.terms, model.mixing, leaders, strict=True)
                if term.name not in model.names
            ],
        },
        "parameters": [
            {"name": p.name, "unit": p.unit, "value": value}
            for p, value in zip(model.parameters, truth.x, strict=True)
        ],
        "displacements": [
            {
                "name": term.name,
                "place": term.place,
                "twist": term.direction,
                "value": value,
                "times": term.factor.name if term.factor else "",
            }
            for term, value in zip(model.terms, model.values(truth.x), strict=True)
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
        "payload": truth.payload and {"mass_kg": truth.payload.mass, "com_m": truth.payload.com},
        "gravity_m_s2": truth.gravity,
        "instrument": {
            "kind": scenario.kind.name,
            "noise": noise
            and {
                "constant_m": noise.constant,
                "per_length_m_per_m": noise.per_length,
                "repeatability_m": noise.repeatability,
            },
            "sigma_angle_rad": scenario.sigma_angle,
            "tracker_base_xyz_m": scenario.tracker,
            "encoder_step_rad": scenario.encoder.angle,
            "encoder_step_m": scenario.encoder.length,
            "visits": scenario.visits,
        },
        "events": {
            "outliers": [
                {"row": table.rows[i], "displacement_m": made.outliers[i]}
                for i in np.flatnonzero(made.outliers.any(axis=1))
            ],
            "moved_target": moved
            and {"from_row": moved.row, "target": moved.target, "displacement_m": moved.by},
            "drift_m": scenario.drift,
        },
        "rows": [
            {
                "row": row,
                "target": table.targets[i],
                "group": table.groups[i],
                "joints": made.q[i],
                "xyz_m": made.points[i],
                "sigma_m": made.sigma[i],
            }
            for i, row in enumerate(table.rows)
        ],
    }
    return write_atomically(path, json_bytes(content), overwrite=overwrite)


def write_simulated(
    scenario: Scenario,
    made: Simulated,
    table: Path,
    truth: Path,
    urdf: Path | None = None,
    *,
    overwrite: bool = False,
) -> list[Path]:
    """Write a table, what was true of it, and perhaps the true robot's URDF.

    Raises:
        UrdfError, FileError: As for `write_truth` and `write_true_urdf`.
    """
    made.measurements.write(table, overwrite=overwrite)
    write_truth(scenario, made, truth, overwrite=overwrite)
    if urdf is not None:
        write_true_urdf(made.truth, urdf, overwrite=overwrite)
    return [path for path in (table, truth, urdf) if path is not None]


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


def _pose(T: NDArray[np.float64], prefix: str = "") -> dict[str, Any]:
    """A pose, [m], and roll, pitch, yaw about fixed axes x, y, z [rad]."""
    rpy = pin.rpy.matrixToRpy(np.ascontiguousarray(T[:3, :3]))
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": rpy}
