"""What `calib base-frame` prints of a survey, in lines of 100 columns at most."""

from __future__ import annotations

import math
import textwrap

import numpy as np
import pinocchio as pin

from calib.base_frame.axes import NUMBERS
from calib.base_frame.files import REACH_M, tracker_place
from calib.base_frame.frame import BaseFrame
from calib.base_frame.survey import AxisRow, JointAxis, Survey
from calib.errors import choices
from calib.measure.measurements import Measurements
from calib.model.robot import Robot

# A number of a DH row that is known better than this was set by the base's own definition [m, rad].
_BY_DEFINITION = 1e-10


def survey_text(survey: Survey, source: str, robot: Robot | None) -> list[str]:
    """All that is printed of a survey: the frame, the sweeps, the DH rows, what was found.

    Args:
        survey: The survey.
        source: The name of the file of sweeps.
        robot: Whose base the frame is; None: that of the axes.
    """
    lines = [*_frame_text(survey.frame, source, robot), "", *_sweeps_text(survey), ""]
    if survey.rows:
        lines += [*_rows_text(survey), ""]
    if not survey.findings:
        lines.append(
            "The residuals look like noise: no gross rows were found, and no neighbours that err alike."
        )
    else:
        lines.append("Findings:")
    for sentence in survey.findings:
        lines += _wrapped(f"- {sentence}", "  ")
    return lines


def _wrapped(text: str, indent: str = "") -> list[str]:
    """Text in lines of 100 columns at most."""
    return textwrap.wrap(
        text, 100, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    )


def _frame_text(frame: BaseFrame, source: str, robot: Robot | None) -> list[str]:
    """The frame and how well it is known."""
    T = frame.T_tracker_base
    what = (
        "z along axis 1, y along axis 2, origin where axis 1 meets the plane"
        if robot is None
        else f"the link '{robot.base}' of {robot.name}"
    )
    rpy = np.degrees(pin.rpy.matrixToRpy(T[:3, :3]))
    units = (*(("mm",) * 3), *(("mrad",) * 3))
    names = ("x", "y", "z", "about x", "about y", "about z")
    far = frame.std_at(REACH_M * np.vstack([np.eye(3), -np.eye(3)]))
    return [
        *_wrapped(f"Base frame from {source}: {what}."),
        "Pose of the base in the tracker's frame:",
        f"  x y z           {'  '.join(f'{1e3 * v:.4f}' for v in T[:3, 3])} mm",
        f"  roll pitch yaw  {'  '.join(f'{v + 0.0:.6f}' for v in rpy)} deg",
        "Origin of the tracker's frame in the base:",
        f"  x y z           {'  '.join(f'{1e3 * v:.1f}' for v in tracker_place(frame))} mm",
        "",
        f"{'Along and about the axes of the base':<40}{'std':>10}{'95 % within':>14}",
        *(
            f"  {name:<38}{1e3 * s:>10.4f}{f'+-{1e3 * w:.4f}':>14} {unit}"
            for name, unit, s, w in zip(names, units, frame.std, frame.within(0.95), strict=True)
        ),
        f"A point {1e3 * REACH_M:.0f} mm from the origin is known to "
        f"{1e3 * np.sqrt((far**2).sum(axis=1)).max():.3f} mm through the frame (std, worst direction).",
    ]


def _sweeps_text(survey: Survey) -> list[str]:
    """A table of the plane and the circles."""
    head = (
        f"{'Sweep':<28}{'points':>7}{'radius [mm]':>13}{'arc [deg]':>11}{'radial rms':>12}{'max':>8}"
        f"{'axial rms':>11}{'max [mm]':>9}"
    )
    plane = survey.plane
    off = 1e3 * np.abs(plane.residuals[plane.used, 0])
    lines = [
        head,
        f"  {'plane':<26}{int(plane.used.sum()):>7}{'-':>13}{'-':>11}{'-':>12}{'-':>8}"
        f"{np.sqrt(np.mean(off**2)):>11.4f}{off.max():>9.3f}",
    ]
    for joint in survey.joints:
        circle = joint.circle
        off = 1e3 * np.abs(circle.residuals[circle.used])
        rms = np.sqrt(np.mean(off**2, axis=0))
        name = f"  {joint.name:<26}" if len(joint.name) < 26 else f"  {joint.name}\n{'':<28}"
        lines += (
            f"{name}{int(circle.used.sum()):>7}{1e3 * circle.radius:>13.3f}"
            f"{np.degrees(circle.arc):>11.1f}{rms[0]:>12.4f}{off[:, 0].max():>8.3f}"
            f"{rms[1]:>11.4f}{off[:, 1].max():>9.3f}"
        ).split("\n")
    turned = [joint for joint in survey.joints if joint.turning is not None]
    if turned:
        lines += ["", *_turning_text(turned)]
    return lines


def _turning_text(joints: list[JointAxis]) -> list[str]:
    """How far joints turned against their values."""
    lines = [
        f"{'Turned against its own values':<34}{'rms [mrad]':>11}{'gain [mrad/rad]':>22}"
        f"{'once per turn [mrad]':>24}"
    ]
    for joint in joints:
        t = joint.turning
        assert t is not None
        once = "arc too short"
        if math.isfinite(t.eccentricity):
            once = f"{1e3 * t.eccentricity:.4f} +-{1e3 * t.eccentricity_std:.4f}"
        gain = f"{1e3 * t.gain:+.4f} +-{1e3 * t.gain_std:.4f}"
        lines.append(f"  {joint.name:<32}{1e3 * t.rms:>11.4f}{gain:>22}{once:>24}")
    return lines


def _rows_text(survey: Survey) -> list[str]:
    """The DH rows, the nominal ones beside."""
    where = "at the joints' zero" if survey.at_zero else "at the pose of the sweeps"
    nominal = any(row.nominal is not None for row in survey.rows)
    lines = _wrapped(
        f"DH rows of the axes, {where}: measured, standard deviation"
        f"{', and nominal in brackets' if nominal else ''}; a, d in mm, alpha, theta, beta in deg."
    )
    for row in survey.rows:
        lines.append(f"  {row.joint}")
        lines += [f"    {text}" for text in _numbers_text(row)]
    return lines


def _numbers_text(row: AxisRow) -> list[str]:
    """The numbers of a row, those that are not zero by convention."""
    lines = []
    for k, name in enumerate(NUMBERS):
        if row.std[k] < _BY_DEFINITION:
            continue
        scale = 1e3 if name in ("a", "d") else math.degrees(1.0)
        value, std = (round(scale * float(v), 4) + 0.0 for v in (row.values[k], row.std[k]))
        beside = (
            ""
            if row.nominal is None
            else f"   ({round(scale * float(row.nominal[k]), 4) + 0.0:.4f})"
        )
        lines.append(f"{name:<6}{value:>12.4f}  +-{std:.4f}{beside}")
    return lines


def carried_text(table: Measurements, frame: BaseFrame) -> list[str]:
    """How far carried points are known, and which columns were left behind."""
    rows = table.positions
    std = np.sqrt((frame.std_at(table.points[rows]) ** 2).sum(axis=1))
    text = (
        f"Carried {int(rows.sum())} rows of {table.source} into the base frame; it moves them "
        f"together by {1e3 * std.max():.3f} mm at most (std). 'calib fit' takes them with --frame known, the default."
    )
    if table.ignored:
        text += f" Columns left out: {choices(table.ignored)}."
    return ["", *_wrapped(text)]
