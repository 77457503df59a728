"""The truth of a simulated table as JSON in SI units; docs/simulation.md describes the keys."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.basics.files import write_atomically
from calib.basics.json_files import json_bytes
from calib.model.parameters import ErrorModel
from calib.robot.coupled_readings import coupling_table
from calib.robot.robot import Robot
from calib.verbs.simulate.scenario import Scenario, Simulated
from calib.verbs.simulate.truth import Truth

#: Kind and version of the file.
SCHEMA = "truth 2"

#: Keys of a noise.
_NOISE = ("constant_m", "per_length_m_per_m", "repeatability_m")

#: Keys of a row.
_ROW = ("row", "target", "group", "joints", "xyz_m", "sigma_m")


def write_truth(
    scenario: Scenario,
    simulated: Simulated,
    path: str | Path,
    *,
    overwrite: bool = False,
) -> Path:
    """Write the truth of a simulated table.

    It is complete: with the nominal URDF alone, true positions follow from it.

    Args:
        scenario: What was simulated.
        simulated: The table and its truth.
        path: The file.
        overwrite: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        FileError: It cannot be written.
    """
    content = {
        "schema": SCHEMA,
        "seed": simulated.seed,
        **truth_table(simulated.truth),
        "instrument": _instrument_table(scenario),
        "events": _event_table(scenario, simulated),
        "rows": list(_rows(simulated)),
    }
    return write_atomically(path, json_bytes(content), overwrite=overwrite)


def truth_table(truth: Truth) -> dict[str, Any]:
    """Return the part of the file that describes a robot with its errors, its targets and its frames."""
    model = truth.model
    parameters = zip(model.parameters, truth.x, strict=True)
    payload = truth.payload
    return {
        "robot": _robot_table(truth.nominal),
        "model": {"set": model.name, "ties": list(_ties(model))},
        "parameters": [{"name": p.name, "unit": p.unit, "value": value} for p, value in parameters],
        "displacements": list(_displacements(truth)),
        **_places(truth),
        "payload": payload and {"mass_kg": payload.mass, "com_m": payload.com},
        "gravity_m_s2": truth.gravity,
    }


def _robot_table(robot: Robot) -> dict[str, Any]:
    """Return the nominal robot's URDF and chain."""
    held = [{"joint": name, "value": value} for name, value in sorted(robot.held.items())]
    return {
        "name": robot.name,
        "urdf_sha256": robot.urdf.sha256,
        "base": robot.base,
        "tip": robot.tip,
        "joints": robot.joint_names,
        "held": held,
        "coupling": coupling_table(robot.reading_coupling),
    }


def _ties(model: ErrorModel) -> Iterator[dict[str, Any]]:
    """Yield the errors that follow others."""
    for term, row in zip(model.terms, model.mixing, strict=True):
        if term.name not in model.names:
            leader = int(np.argmax(np.abs(row)))
            yield {"name": term.name, "other": model.names[leader], "factor": row[leader]}


def _displacements(truth: Truth) -> Iterator[dict[str, Any]]:
    """Yield the displacement of a placement by each error."""
    model = truth.model
    for term, value in zip(model.terms, model.values(truth.x), strict=True):
        yield {
            "name": term.name,
            "place": term.place,
            "twist": term.direction,
            "value": value,
            "times": term.factor.name if term.factor else "",
        }


def _places(truth: Truth) -> dict[str, Any]:
    """Return true joint origins, targets and frames."""
    origins = [
        {"joint": name, **pose_table(T)} for name, T in sorted(truth.robot.origins().items())
    ]
    targets = [
        {"target": name, **pose_table(true), **pose_table(stated, "said_")}
        for name, true, stated in zip(
            truth.targets, truth.T_tip_target, truth.stated_T_tip_target, strict=True
        )
    ]
    frames = [
        {"group": name, **pose_table(T, "frame_base_")}
        for name, T in zip(truth.groups, truth.T_frame_base, strict=True)
    ]
    return {"origins": origins, "targets": targets, "set_ups": frames}


def _instrument_table(scenario: Scenario) -> dict[str, Any]:
    """Return the instrument, its noise, and the encoders' steps."""
    noise = scenario.noise
    return {
        "kind": scenario.kind.name,
        "noise": noise and dict(zip(_NOISE, astuple(noise), strict=True)),
        "sigma": scenario.sigma,
        "tracker_base_xyz_m": scenario.tracker,
        "encoder_step_rad": scenario.encoder.angle,
        "encoder_step_m": scenario.encoder.length,
        "visits": scenario.visits,
    }


def _event_table(scenario: Scenario, simulated: Simulated) -> dict[str, Any]:
    """Return outliers, the moved target and the drift."""
    moved, rows = scenario.moved, simulated.measurements.rows
    outliers = [
        {"row": rows[i], "displacement_m": simulated.outliers[i]}
        for i in np.flatnonzero(simulated.outliers.any(axis=1))
    ]
    moved_target = moved and {
        "from_row": moved.row,
        "target": moved.target,
        "displacement_m": moved.by,
    }
    return {"outliers": outliers, "moved_target": moved_target, "drift_m": scenario.drift}


def _rows(simulated: Simulated) -> Iterator[dict[str, Any]]:
    """Yield the truth of each row."""
    table = simulated.measurements
    rows = zip(
        table.rows,
        table.targets,
        table.groups,
        simulated.q,
        simulated.points,
        simulated.sigma,
        strict=True,
    )
    for row in rows:
        yield dict(zip(_ROW, row, strict=True))


def pose_table(T: Array, prefix: str = "") -> dict[str, Any]:
    """Return a pose, position [m] and roll, pitch, yaw about fixed axes x, y, z [rad], by keys with a prefix."""
    rpy = pin.rpy.matrixToRpy(np.ascontiguousarray(T[:3, :3]))
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": rpy}
