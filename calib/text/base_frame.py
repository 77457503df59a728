"""What ``calib base-frame`` prints: the frame, the sweeps, DH rows, findings."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.circle_points.checks import Finding
from calib.circle_points.frame import NUMBERS, BaseFrame
from calib.circle_points.survey import AxisRow, Survey
from calib.data.measurements import Measurements
from calib.errors import choices
from calib.robot.robot import Robot
from calib.text.lines import fill

#: How far from the base's origin the uncertainty of a point is stated [m].
REACH_M = 0.5

# A number of a DH row that is known better than this was set by the base's own definition [m, rad].
_BY_DEFINITION = 1e-10

#: The sentence of each finding; its numbers are in mm and mrad.
_FINDINGS = {
    "gross": "{where} is {off_mm:.3g} mm off and was left out: measure it again.",
    "correlated": "{where}: neighbouring points err alike {how} (correlation {correlation:.2f}): that is no noise, so "
    "the stated uncertainty is too small. Look for a worn bearing, play, bending, drift, or a target or tracker that "
    "moved.",
    "scatter": "{where}: the points scatter by {scatter_mm:.3g} mm, sigma says {sigma_mm:.3g} mm. The uncertainty is "
    "that of the scatter.",
    "gain": "{where}: the joint turns {gain:+.3f} mrad per rad otherwise than its values say (standard deviation "
    "{std:.3f}): a gear gain (--model dh+gain).",
    "eccentricity": "{where}: off by {eccentricity:.3f} mrad once per turn (standard deviation {std:.3f}): "
    "an eccentric encoder (--model dh+eccentricity), or a target that moved in the middle of the sweep.",
    "downwards": "{where}: z points from the circle towards the plane. If the robot stands on it and joint 1 turns "
    "anticlockwise seen from above, the rows are in the order of decreasing joint angle.",
    "below": "{where}: the circle lies below the plane z = 0 of the base. If the robot stands on that plane, the "
    "joint's sign differs from the URDF's.",
}


def finding_text(found: Finding) -> str:
    """A finding as a sentence."""
    return _FINDINGS[found.code].format(where=found.where, how=found.how, **found.values)


def survey_text(survey: Survey, source: str, robot: Robot | None) -> list[str]:
    """All that is printed of a survey of a file: the frame, the robot's or the axes', sweeps, DH rows, findings."""
    lines = [*_frame_text(survey.frame, source, robot), "", *_sweeps_text(survey), ""]
    if survey.rows:
        beside = ", and nominal in brackets" if survey.rows[0].nominal is not None else ""
        where = "at the joints' zero" if survey.at_zero else "at the pose of the sweeps"
        lines.append(
            fill(
                f"DH rows of the axes, {where}: measured, standard deviation{beside}; a, d in mm, alpha, theta, beta "
                "in deg."
            )
        )
        for row in survey.rows:
            lines += [f"  {row.joint}", *_row_text(row)]
        lines.append("")
    if not survey.findings:
        lines.append("No findings: the residuals look like noise.")
    else:
        lines.append("Findings:")
        lines += [fill(f"- {finding_text(one)}", "", "  ") for one in survey.findings]
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
        fill(f"Base frame from {source}: {what}."),
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
        f"together by {1e3 * std.max():.3f} mm at most (std). "
        "'calib calibrate' takes them with --frame known, the default."
    )
    if table.ignored:
        text += f" Columns left out: {choices(table.ignored)}."
    return ["", fill(text)]
