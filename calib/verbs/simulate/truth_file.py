"""The truth of a simulation as JSON in SI units; docs/simulation.md describes the keys.

Errors of a camera and a print are named as the fit's estimates of them: what must be added to what is stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.basics.files import write_atomically
from calib.basics.json_files import json_bytes
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.robot.coupled_readings import coupling_table
from calib.verbs.simulate.equipment import Equipment
from calib.verbs.simulate.operator import Measurement, Mistake, Operator
from calib.verbs.simulate.scenario import Scenario, Simulated
from calib.verbs.simulate.simulated_rows import Pictures
from calib.verbs.simulate.truth import Truth

SCHEMA = "truth 2"

#: Of the truth of a session.
SESSION_SCHEMA = "session truth 1"

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
    """Write the truth of a simulation as JSON, in SI units.

    It is complete: true positions, and the pixels of a camera, follow from it and the nominal URDF.

    Args:
        scenario: The scenario.
        simulated: Its measurements, with their truth.
        path: The file.
        overwrite: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        FileError: It cannot be written.
    """
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "seed": simulated.seed,
        **truth_table(simulated.truth),
    }
    if simulated.pictures is None:
        content |= _tracker_tables(scenario, simulated)
    else:
        content["parameters"] += _equipment_errors(simulated.truth, simulated.pictures.equipment)
        content |= _camera_tables(scenario, simulated, simulated.pictures)
    return write_atomically(path, json_bytes(content), overwrite=overwrite)


def write_session_truth(
    operator: Operator,
    stops: Sequence[Measurement],
    seed: int,
    path: str | Path,
    *,
    overwrite: bool = False,
) -> Path:
    """Write the truth of a session with a virtual operator as JSON, in SI units.

    Args:
        operator: Has the cell as it was at the beginning, and what was knocked since.
        stops: What was measured, in order.
        seed: Of the cell and the operator.
        path: The file.
        overwrite: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        FileError: It cannot be written.
    """
    virtual = operator.virtual
    content: dict[str, Any] = {
        "schema": SESSION_SCHEMA,
        "seed": seed,
        **truth_table(virtual.truth),
        "knocked": [_mistake_table(mistake) for mistake in reversed(operator.knocked)],
        "stops": [
            {
                "stop": number,
                "joints": stop.joints,
                "mistakes": [_mistake_table(mistake) for mistake in stop.mistakes],
            }
            for number, stop in enumerate(stops, start=1)
        ],
    }
    if virtual.equipment is not None:
        content["parameters"] += _equipment_errors(virtual.truth, virtual.equipment)
    return write_atomically(path, json_bytes(content), overwrite=overwrite)


def _mistake_table(mistake: Mistake) -> dict[str, Any]:
    """Return a mistake by the keys of a truth file."""
    return {
        "mistake": mistake.code,
        "since_stop": mistake.since,
        "name": mistake.name,
        "size_m": mistake.size,
        "turn_rad": mistake.turn,
    }


def truth_table(truth: Truth) -> dict[str, Any]:
    """Return the tables of a truth file that describe a robot with its errors, targets and frames, in SI units."""
    robot, model, payload = truth.nominal, truth.model, truth.payload
    ties = []
    displacements = []
    for term, row, value in zip(model.terms, model.mixing, model.values(truth.x), strict=True):
        if term.name not in model.names:
            leader = int(np.argmax(np.abs(row)))
            ties.append({"name": term.name, "other": model.names[leader], "factor": row[leader]})
        displacements.append(
            {
                "name": term.name,
                "place": term.place,
                "twist": term.direction,
                "value": value,
                "times": term.factor.name if term.factor else "",
            }
        )
    parameters = zip(model.parameters, truth.x, strict=True)
    tips = truth.target_links or (robot.tip,) * len(truth.targets)
    bases = truth.frame_links or (robot.base,) * len(truth.groups)
    poses = zip(truth.T_tip_target, truth.stated_T_tip_target, strict=True)
    targets = zip(truth.targets, tips, poses, strict=True)
    frames = zip(truth.groups, bases, truth.T_frame_base, strict=True)
    return {
        "robot": {
            "name": robot.name,
            "urdf_sha256": robot.urdf.sha256,
            "base": robot.base,
            "tip": robot.tip,
            "chains": [{"base": chain.base, "tip": chain.tip} for chain in robot.chains],
            "joints": robot.joint_names,
            "held": [{"joint": name, "value": q} for name, q in sorted(robot.held.items())],
            "coupling": coupling_table(robot.reading_coupling),
        },
        "model": {"set": model.name, "ties": ties},
        "parameters": [{"name": p.name, "unit": p.unit, "value": value} for p, value in parameters],
        "displacements": displacements,
        "origins": [
            {"joint": name, **_pose_table(T)} for name, T in sorted(truth.robot.origins().items())
        ],
        "targets": [
            {"target": name, "link": link, **_pose_table(true), **_pose_table(stated, "said_")}
            for name, link, (true, stated) in targets
        ],
        "set_ups": [
            {"group": name, "link": link, **_pose_table(T, "frame_base_")}
            for name, link, T in frames
        ],
        "payload": payload and {"mass_kg": payload.mass, "com_m": payload.com},
        "gravity_m_s2": truth.gravity,
    }


def _pose_table(T: Array, prefix: str = "") -> dict[str, Any]:
    """Return a pose by keys with a prefix: position [m], and roll, pitch, yaw about fixed axes x, y, z [rad]."""
    rpy = pin.rpy.matrixToRpy(np.ascontiguousarray(T[:3, :3]))
    return {f"{prefix}xyz_m": T[:3, 3], f"{prefix}rpy_rad": rpy}


# Rows of a tracker


def _tracker_tables(scenario: Scenario, simulated: Simulated) -> dict[str, Any]:
    """Return the tables ``instrument``, ``events`` and ``rows`` of a tracker's truth file, in SI units."""
    noise, moved, table = scenario.noise, scenario.moved, simulated.measurements
    step = scenario.step
    outliers = [
        {"row": table.rows[i], "displacement_m": simulated.outliers[i]}
        for i in np.flatnonzero(simulated.outliers.any(axis=1))
    ]
    moved_target = moved and {
        "from_row": moved.row,
        "target": moved.target,
        "displacement_m": moved.by,
    }
    rows = zip(
        table.rows,
        table.targets,
        table.groups,
        simulated.q,
        simulated.points,
        simulated.sigma,
        strict=True,
    )
    return {
        "instrument": {
            "kind": scenario.kind.name,
            "noise": noise and dict(zip(_NOISE, astuple(noise), strict=True)),
            "sigma": scenario.sigma,
            "tracker_base_xyz_m": scenario.tracker,
            "encoder_step_rad": scenario.encoder.angle,
            "encoder_step_m": scenario.encoder.length,
            "visits": scenario.visits,
        },
        "events": {
            "outliers": outliers,
            "moved_target": moved_target,
            "drift_m": scenario.drift,
            "step": step and {"from_row": step.row, "displacement_m": step.by},
        },
        "references": [
            {"target": f"reference {k}", "xyz_m": xyz}
            for k, xyz in enumerate(simulated.standing, start=1)
        ],
        "rows": [dict(zip(_ROW, row, strict=True)) for row in rows],
    }


# Pictures


def _equipment_errors(truth: Truth, equipment: Equipment) -> list[dict[str, Any]]:
    """Return name, unit and value of each error of the cameras' numbers, true less stated, and of the prints.

    Without stated numbers of a camera there are none of it. Of several, the name ends with that of camera or board.
    """
    errors = []
    for name, stated, camera in zip(
        truth.groups, equipment.stated_cameras, equipment.cameras, strict=True
    ):
        owner = f"[{name}]" if len(truth.groups) > 1 else ""
        lens = LENSES[camera.lens]
        if camera.values is None or stated.values is None:
            continue
        for of_lens, unit, error in zip(
            lens.names, lens.units, camera.values - stated.values, strict=True
        ):
            errors.append({"name": of_lens + owner, "unit": unit, "value": float(error)})
    for name, printed in zip(truth.targets, equipment.prints, strict=True):
        owner = f"[{name}]" if len(truth.targets) > 1 else ""
        for axis, scale, sag in zip("xy", printed.scale, printed.warp, strict=True):
            errors.append({"name": f"board_scale_{axis}{owner}", "unit": "1", "value": scale - 1.0})
            errors.append({"name": f"board_sag_{axis}{owner}", "unit": "m", "value": sag})
        if printed.offsets is not None:
            for corner, offset in enumerate(printed.offsets.tolist()):
                for axis, value in zip("xy", offset, strict=False):
                    of_corner = f"corner_{corner}_{axis}{owner}"
                    errors.append({"name": of_corner, "unit": "m", "value": value})
    return errors


def _camera_tables(scenario: Scenario, simulated: Simulated, pictures: Pictures) -> dict[str, Any]:
    """Return the tables ``cameras``, ``boards``, ``instrument``, ``events`` and ``pictures`` of a truth file.

    Values are in SI units, and pixels are the true ones, without noise.
    """
    truth, equipment = simulated.truth, pictures.equipment
    outliers = [
        {"row": row, "displacement_px": simulated.outliers[row - 1]}
        for row in simulated.outlier_rows
    ]
    rows = zip(pictures.images, pictures.sets, pictures.q, pictures.T_camera_board, strict=True)
    each_picture = []
    for k, (image, set_name, q, T) in enumerate(rows):
        is_here = pictures.picture == k
        each_picture.append(
            {
                "image": image,
                "group": truth.groups[pictures.camera[k]],
                "board": truth.targets[pictures.board[k]],
                "set": set_name,
                "joints": q,
                **_pose_table(T, "camera_board_"),
                "corners": pictures.corner[is_here],
                "pixels": pictures.true_pixels[is_here],
            }
        )
    stated_and_true = zip(equipment.stated_cameras, equipment.cameras, strict=True)
    return {
        "cameras": [
            _camera_table(group or camera.name, stated, camera)
            for group, (stated, camera) in zip(truth.groups, stated_and_true, strict=True)
        ],
        "boards": [
            {
                "board": name,
                "pattern": printed.board.pattern,
                "columns": printed.board.columns,
                "rows": printed.board.rows,
                "said_square_m": printed.board.square,
                "scale": printed.scale,
                "sag_m": printed.warp,
                "corners_m": printed.corners,
            }
            for name, printed in zip(truth.targets, equipment.prints, strict=True)
        ],
        "instrument": {
            "kind": scenario.kind.name,
            "sigma": {"px": pictures.sigma},
            "repeatability_m": 0.0 if scenario.noise is None else scenario.noise.repeatability,
            "encoder_step_rad": scenario.encoder.angle,
            "encoder_step_m": scenario.encoder.length,
        },
        "events": {"outliers": outliers},
        "pictures": each_picture,
    }


def _camera_table(name: str, stated: Camera, camera: Camera) -> dict[str, Any]:
    """Return the table of a camera: size and lens, its true numbers, and the stated ones."""
    names = LENSES[camera.lens].names
    assert camera.values is not None
    said = None
    if stated.values is not None:
        said = dict(zip(names, stated.values.tolist(), strict=True))
    return {
        "camera": name,
        "width_px": camera.width,
        "height_px": camera.height,
        "lens": camera.lens,
        "values": dict(zip(names, camera.values.tolist(), strict=True)),
        "said_values": said,
    }
