"""The base frame as `calib base-frame` prints it, with axes, sweeps and findings, and as a cell file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from calib.robot.robot import Robot
from calib.show.lines import deg, fill, mm
from calib.show.tables import Column, name_column, table_lines
from calib.verbs.base_frame.base_frame import BaseFrame
from calib.verbs.base_frame.circles import Circle, Plane

_CORRELATED = (
    "{{where}}: the errors of neighbouring points are correlated {} ({{value:.2f}}), so they are not noise and the "
    "stated uncertainty is too small. Look for a worn bearing, backlash, bending, drift, or a target or tracker that "
    "moved."
)

#: The sentence of each finding; {mm} is its value in mm.
_FINDINGS = {
    "gross": "{where} is {mm:.3g} mm off and was ignored: measure it again.",
    "radial": _CORRELATED.format("radially"),
    "axial": _CORRELATED.format("axially"),
    "scatter": "{where}: the points scatter {value:.3g} times more than sigma says. The uncertainty given is that of "
    "the scatter.",
}


def base_frame_text(frame: BaseFrame, source: str, robot: Robot | None) -> list[str]:
    """Write a base frame with its sweeps, axes and findings.

    Args:
        frame: The base frame.
        source: The file of sweeps.
        robot: The robot whose base link it is; None if none was given.

    Returns:
        Paragraphs and lines of at most 100 columns.
    """
    what = "z along axis 1, y along axis 2, origin where axis 1 meets the plane"
    if robot is not None:
        what = f"the link '{robot.base}' of {robot.name}"
    lines = [fill(f"Base frame from {source}: {what}.")]
    lines += _pose_text(frame)

    heads = ["Sweep", "points", "radius [mm]", "arc [deg]"]
    heads += ["radial rms", "max", "axial rms", "max [mm]"]
    rows = [_sweep_row("plane", frame.plane)]
    rows += [_sweep_row(joint.name, joint.circle) for joint in frame.joints]
    lines += ["", *_table(heads, rows)]
    if frame.pairs:
        heads = ["To the next axis", "angle [deg]", "std", "nominal", "distance [mm]"]
        heads += ["std", "nominal"]
        rows = []
        for pair in frame.pairs:
            angles = (pair.angle, pair.angle_std, pair.angle_nominal)
            distances = (pair.distance, pair.distance_std, pair.distance_nominal)
            cells = [pair.joints[0]]
            cells += [deg(angle, 4) for angle in angles]
            cells += [mm(distance, 4) for distance in distances]
            rows.append(cells)
        lines += ["", *_table(heads, rows)]

    lines.append("")
    if not frame.findings:
        return [*lines, "No findings: the residuals look like noise."]
    lines.append("Findings:")
    for finding in frame.findings:
        sentence = _FINDINGS[finding.code]
        in_mm = 1e3 * finding.value
        text = sentence.format(where=finding.where, value=finding.value, mm=in_mm)
        lines.append(fill(f"- {text}", "", "  "))
    return lines


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table whose names, the first cell of each row, are indented by two spaces."""
    names = [heads[0]]
    names += [row[0] for row in rows]
    longest = max(map(len, names))
    columns = [name_column(heads[0], longest + 2)]
    columns += [Column(head, gap=2) for head in heads[1:]]
    indented = [(f"  {name}", *cells) for name, *cells in rows]
    return table_lines(columns, indented)


def _pose_text(frame: BaseFrame) -> Iterator[str]:
    """Yield lines with the pose of the frame, and its standard deviations and 95 % intervals."""
    T = frame.T_tracker_base
    angles = pin.rpy.matrixToRpy(T[:3, :3])
    place = "  ".join(mm(length, 4) for length in T[:3, 3])
    rpy = "  ".join(deg(angle, 6) for angle in angles)
    tracker = "  ".join(mm(length, 1) for length in frame.T_base_tracker[:3, 3])
    yield "Pose of the base in the tracker's frame:"
    yield f"  x y z           {place} mm"
    yield f"  roll pitch yaw  {rpy} deg"
    yield "Origin of the tracker's frame in the base:"
    yield f"  x y z           {tracker} mm"
    yield ""
    names = [f"{axis} [mm]" for axis in "xyz"]
    names += [f"about {axis} [mrad]" for axis in "xyz"]
    rows = []
    # Radians in mrad have the same digits as metres in mm.
    for name, std, half_width in zip(names, frame.std, frame.within(0.95), strict=True):
        rows.append((name, mm(std, 4), f"+-{mm(half_width, 4)}"))
    yield from _table(("Along and about the axes of the base", "std", "95 % within"), rows)


def _sweep_row(name: str, figure: Plane | Circle) -> list[str]:
    """Return a sweep's name, number of points used, radius [mm], arc [deg], and rms and largest of its residuals [mm].

    A circle has radial, then axial residuals; the residuals of a plane are all axial, and its other cells are dashes.
    """
    residuals = figure.residuals[figure.used]
    cells = [name, str(figure.used.sum())]
    if isinstance(figure, Circle):
        cells += [mm(figure.radius), deg(figure.arc, 1)]
    else:
        cells += ["-"] * 4
    for column in residuals.T:
        rms = np.sqrt(np.mean(column**2))
        largest = np.abs(column).max()
        cells += [mm(rms, 4), mm(largest)]
    return cells


def cell_text(frame: BaseFrame, source: str, **links: str | None) -> str:
    """Write the base frame as a cell file, for measurements in the tracker's frame.

    Args:
        frame: The base frame.
        source: The file of sweeps, which a comment names.
        **links: ``base`` and ``tip``, the links of the robot; None leaves one out.

    Returns:
        The content of the file.
    """
    T = frame.T_tracker_base
    rpy_deg = np.degrees(pin.rpy.matrixToRpy(T[:3, :3]))
    std = 1e3 * frame.std  # [mm], [mrad]
    along = ", ".join(f"{value:.3g}" for value in std[:3])
    about = ", ".join(f"{value:.3g}" for value in std[3:])
    lines = [
        f"# The base in the tracker's frame, by calib base-frame from {json.dumps(source)}.",
        f"# Standard deviation along x, y, z of the base: {along} mm, about them: {about} mrad.",
    ]
    lines += [f"{key} = {json.dumps(name)}" for key, name in links.items() if name]
    lines += [
        'frame = "known"',
        f"frame_xyz_mm = {(1e3 * T[:3, 3]).tolist()}",
        f"frame_rpy_deg = {rpy_deg.tolist()}",
    ]
    return "\n".join([*lines, ""])
