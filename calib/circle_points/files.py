"""Measurements carried into the base frame, and a survey as a cell file and as a table for JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.circle_points.frame import NUMBERS, BaseFrame
from calib.circle_points.survey import JointAxis, Survey
from calib.data.measurements import Measurements
from calib.errors import MeasurementError, choices

Array = NDArray[np.float64]

#: Of the table for JSON; a number behind it changes with the meaning of a key.
SCHEMA = "base-frame 1"


def carried(measurements: Measurements, frame: BaseFrame) -> Measurements:
    """Measurements of the tracker's frame in the base: positions and orientations; all else stays.

    Raises:
        MeasurementError: No row measures a position, or the rows are of several set-ups, of which each has a frame.
    """
    rows = measurements.positions
    if not rows.any():
        raise MeasurementError(
            f"{measurements.source}: no row measures a position, they are of the kinds "
            f"{choices(dict.fromkeys(measurements.kinds))}. There is nothing to carry into the base frame."
        )
    groups = dict.fromkeys(g for g, there in zip(measurements.groups, rows, strict=True) if there)
    if len(groups) > 1:
        raise MeasurementError(
            f"{measurements.source}: the rows are of the set-ups {choices(groups)} (column 'group'), and the sweeps "
            "tell the base frame of one. Carry each set-up with its own sweeps."
        )
    rotations = measurements.rotations
    return replace(
        measurements,
        points=frame.carry(measurements.points),
        rotations=None if rotations is None else frame.T_base_tracker[:3, :3] @ rotations,
    )


def cell_text(survey: Survey, source: str, base: str | None = None, tip: str | None = None) -> str:
    """The base frame as a cell file, with which measurements in the tracker's frame can be used as they are.

    ``source``, the file of sweeps, stands in a comment; base and tip are links, if they are named.
    """
    T, std, place = (
        survey.frame.T_tracker_base,
        survey.frame.std,
        survey.frame.T_base_tracker[:3, 3],
    )
    links = [f"{key} = {json.dumps(name)}" for key, name in (("base", base), ("tip", tip)) if name]
    rpy = np.degrees(pin.rpy.matrixToRpy(T[:3, :3]))
    along, about = (", ".join(f"{1e3 * v:.3g}" for v in part) for part in (std[:3], std[3:]))
    return "\n".join(
        [
            f"# The base in the tracker's frame, by calib base-frame from {json.dumps(source)}.",
            f"# Standard deviation along x, y, z of the base: {along} mm, about them: {about} mrad.",
            *links,
            'frame = "known"',
            f"frame_xyz_mm = {(1e3 * T[:3, 3]).tolist()}",
            f"frame_rpy_deg = {rpy.tolist()}",
            "",
            "# A tracker in the origin of its frame stands here in the base; calib plan asks then what it sees.",
            "# [tracker]",
            f"# xyz_mm = [{', '.join(f'{1e3 * v:.1f}' for v in place)}]",
            "",
        ]
    )


def survey_table(survey: Survey) -> dict[str, Any]:
    """All of it as nested tables of plain values and arrays, SI units, see docs/base-frame.md."""
    frame, plane = survey.frame, survey.plane
    return {
        "schema": SCHEMA,
        "frame": {
            "T_tracker_base": frame.T_tracker_base,
            "covariance": frame.covariance,
            "region_95": frame.limit(0.95),
            "std_m": frame.std[:3],
            "std_rad": frame.std[3:],
        },
        "plane": {
            "sweep": survey.plane_sweep.name,
            "points": int(plane.used.sum()),
            "point_m": plane.point,
            "normal": plane.normal,
            "rms_m": _rms(plane.residuals[plane.used]),
            "noise_m": plane.noise,
            "residuals_m": plane.residuals[:, 0],
            "used": plane.used,
        },
        "joints": [_joint_table(joint) for joint in survey.joints],
        "rows": [
            {
                "joint": row.joint,
                "measured": _named(row.values),
                "std": _named(row.std),
                "nominal": None if row.nominal is None else _named(row.nominal),
            }
            for row in survey.rows
        ],
        "rows_at_zero": survey.at_zero,
        "findings": [asdict(one) for one in survey.findings],
    }


def _joint_table(joint: JointAxis) -> dict[str, Any]:
    """A joint's axis, and its circle."""
    circle, turned, B = joint.circle, joint.turning, joint.circle.basis
    return {
        "joint": joint.joint + 1,
        "name": joint.name,
        "points": int(circle.used.sum()),
        "radius_m": circle.radius,
        "radius_std_m": np.sqrt(circle.covariance[5, 5]),
        "arc_rad": circle.arc,
        "tracker": {
            "point_m": circle.point,
            "direction": circle.normal,
            "point_covariance": B @ circle.covariance[:3, :3] @ B.T,
            "direction_covariance": B[:, :2] @ circle.covariance[3:5, 3:5] @ B[:, :2].T,
        },
        "base": {
            "point_m": joint.point,
            "direction": joint.direction,
            "covariance": joint.covariance,
        },
        "radial_rms_m": _rms(circle.residuals[circle.used, 0]),
        "axial_rms_m": _rms(circle.residuals[circle.used, 1]),
        "noise_m": circle.noise,
        "turning": turned
        and {
            "rms_rad": turned.rms,
            "gain": turned.gain,
            "gain_std": turned.gain_std,
            "eccentricity_rad": turned.eccentricity,
            "eccentricity_std_rad": turned.eccentricity_std,
        },
        "radial_m": circle.residuals[:, 0],
        "axial_m": circle.residuals[:, 1],
        "angles_rad": circle.angles,
        "rows": joint.sweep.rows,
        "used": circle.used,
    }


def _named(values: Array) -> dict[str, float]:
    """The numbers of a DH row by their names and units."""
    return {f"{n}_{u}": float(v) for (n, u), v in zip(NUMBERS.items(), values, strict=True)}


def _rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
