"""Measurements carried into the base frame, and a survey as text, as a cell file and as a table for JSON."""

from __future__ import annotations

import json
import textwrap
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.circle_points.frame import NUMBERS, BaseFrame
from calib.circle_points.survey import AxisRow, JointAxis, Survey
from calib.data.measurements import Measurements
from calib.errors import MeasurementError, choices
from calib.robot.robot import Robot

Array = NDArray[np.float64]

#: Of the table for JSON; a number behind it changes with the meaning of a key.
SCHEMA = "base-frame 1"

#: How far from the base's origin the uncertainty of a point is stated [m].
REACH_M = 0.5

# A number of a DH row that is known better than this was set by the base's own definition [m, rad].
_BY_DEFINITION = 1e-10


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


def survey_text(survey: Survey, source: str, robot: Robot | None) -> list[str]:
    """All that is printed of a survey of a file: the frame, the robot's or the axes', sweeps, DH rows, findings."""
    lines = [*_frame_text(survey.frame, source, robot), "", *_sweeps_text(survey), ""]
    if survey.rows:
        beside = ", and nominal in brackets" if survey.rows[0].nominal is not None else ""
        where = "at the joints' zero" if survey.at_zero else "at the pose of the sweeps"
        lines.append(
            _fill(
                f"DH rows of the axes, {where}: measured, standard deviation{beside}; a, d in mm, alpha, theta, beta "
                "in deg."
            )
        )
        for row in survey.rows:
            lines += [f"  {row.joint}", *_row_text(row)]
        lines.append("")
    if not survey.findings:
        lines.append(
            "The residuals look like noise: no gross rows were found, and no neighbours that err alike."
        )
    else:
        lines.append("Findings:")
    for sentence in survey.findings:
        lines.append(_fill(f"- {sentence}"))
    return lines


def _frame_text(frame: BaseFrame, source: str, robot: Robot | None) -> list[str]:
    """The frame and how well it is known."""
    T, place = frame.T_tracker_base, frame.T_base_tracker[:3, 3]
    what = "z along axis 1, y along axis 2, origin where axis 1 meets the plane"
    if robot is not None:
        what = f"the link '{robot.base}' of {robot.name}"
    rpy = np.degrees(pin.rpy.matrixToRpy(T[:3, :3]))
    names = ("x mm", "y mm", "z mm", "about x mrad", "about y mrad", "about z mrad")
    far = frame.std_at(REACH_M * np.vstack([np.eye(3), -np.eye(3)]))
    lines = [
        _fill(f"Base frame from {source}: {what}."),
        "Pose of the base in the tracker's frame:",
        f"  x y z           {'  '.join(f'{1e3 * v:.4f}' for v in T[:3, 3])} mm",
        f"  roll pitch yaw  {'  '.join(f'{v + 0.0:.6f}' for v in rpy)} deg",
        "Origin of the tracker's frame in the base:",
        f"  x y z           {'  '.join(f'{1e3 * v:.1f}' for v in place)} mm",
        "",
        f"{'Along and about the axes of the base':<40}{'std':>10}{'95 % within':>14}",
    ]
    for name, std, within in zip(names, frame.std, frame.within(0.95), strict=True):
        label, unit = name.rsplit(" ", 1)
        lines.append(f"  {label:<38}{1e3 * std:>10.4f}{f'+-{1e3 * within:.4f}':>14} {unit}")
    lines.append(
        f"A point {1e3 * REACH_M:.0f} mm from the origin is known to "
        f"{1e3 * np.linalg.norm(far, axis=1).max():.3f} mm through the frame (std, worst direction)."
    )
    return lines


def _sweeps_text(survey: Survey) -> list[str]:
    """A table of the plane and the circles, and how far joints turned against their values."""
    lines = [
        f"{'Sweep':<28}{'points':>7}{'radius [mm]':>13}{'arc [deg]':>11}{'radial rms':>12}{'max':>8}"
        f"{'axial rms':>11}{'max [mm]':>9}"
    ]
    turned = []
    for name, figure, joint in (
        ("plane", survey.plane, None),
        *((joint.name, joint.circle, joint) for joint in survey.joints),
    ):
        off = 1e3 * np.abs(figure.residuals[figure.used])
        rms = np.sqrt(np.mean(off**2, axis=0))
        around = f"{'-':>13}{'-':>11}{'-':>12}{'-':>8}"
        if joint is not None:
            around = f"{1e3 * joint.circle.radius:>13.3f}{np.degrees(joint.circle.arc):>11.1f}"
            around += f"{rms[0]:>12.4f}{off[:, 0].max():>8.3f}"
        head = [f"  {name:<26}"] if len(name) < 26 else [f"  {name}", " " * 28]
        head[-1] += f"{int(figure.used.sum()):>7}{around}{rms[-1]:>11.4f}{off[:, -1].max():>9.3f}"
        lines += head
        if joint is not None and (t := joint.turning) is not None:
            once = f"{1e3 * t.eccentricity:.4f} +-{1e3 * t.eccentricity_std:.4f}"
            once = once if np.isfinite(t.eccentricity) else "arc too short"
            gain = f"{1e3 * t.gain:+.4f} +-{1e3 * t.gain_std:.4f}"
            turned.append(f"  {name:<32}{1e3 * t.rms:>11.4f}{gain:>22}{once:>24}")
    if turned:
        title = f"{'Turned against its own values':<34}{'rms [mrad]':>11}{'gain [mrad/rad]':>22}"
        lines += ["", f"{title}{'once per turn [mrad]':>24}", *turned]
    return lines


def _row_text(row: AxisRow) -> list[str]:
    """The numbers of a row, those that are not zero by convention."""
    lines = []
    nominal = row.values if row.nominal is None else row.nominal
    for (name, unit), *numbers in zip(NUMBERS.items(), row.values, row.std, nominal, strict=True):
        scale = 1e3 if unit == "m" else np.degrees(1.0)
        value, std, wanted = (round(scale * float(v), 4) + 0.0 for v in numbers)
        if numbers[1] >= _BY_DEFINITION:
            beside = "" if row.nominal is None else f"   ({wanted:.4f})"
            lines.append(f"    {name:<6}{value:>12.4f}  +-{std:.4f}{beside}")
    return lines


def carried_text(table: Measurements, frame: BaseFrame) -> list[str]:
    """How far carried points are known, and which columns were left behind."""
    rows = table.positions
    std = np.linalg.norm(frame.std_at(table.points[rows]), axis=1)
    text = (
        f"Carried {int(rows.sum())} rows of {table.source} into the base frame; it moves them "
        f"together by {1e3 * std.max():.3f} mm at most (std). 'calib fit' takes them with --frame known, the default."
    )
    if table.ignored:
        text += f" Columns left out: {choices(table.ignored)}."
    return ["", _fill(text)]


def _fill(text: str) -> str:
    """Text in lines of 100 columns at most, those after the first of a list's entry indented."""
    hang = "  " if text.startswith("- ") else ""
    return textwrap.fill(
        text, 100, subsequent_indent=hang, break_on_hyphens=False, break_long_words=False
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
            "dof": frame.dof,
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
            "noise_m": plane.scatter.estimate,
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
        "findings": survey.findings,
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
        "noise_m": circle.scatter.estimate,
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
