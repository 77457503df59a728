"""What ``calib base-frame`` prints and writes as text: the frame, the axes and sweeps, findings, a cell file."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from calib.circle_points.fits import Circle
from calib.circle_points.survey import BaseFrame, Survey
from calib.robot.robot import Robot
from calib.text.lines import deg, fill, mm

Table = list[tuple[str, ...]]

#: The sentence of each finding; its numbers are in mm and mrad.
_ALIKE = (
    "{{where}}: neighbouring points err alike {} (correlation {{value:.2f}}): that is no noise, so the stated "
    "uncertainty is too small. Look for a worn bearing, play, bending, drift, or a target or tracker that moved."
)
_FINDINGS = {
    "gross": "{where} is {mm:.3g} mm off and was left out: measure it again.",
    "radial": _ALIKE.format("radially"),
    "axial": _ALIKE.format("axially"),
    "scatter": "{where}: the points scatter {value:.3g} times more than sigma says. The uncertainty is that of the "
    "scatter.",
}


def survey_text(survey: Survey, source: str, robot: Robot | None) -> list[str]:
    """All that is printed of a survey of a file: the frame, sweeps, axes, findings."""
    what = "z along axis 1, y along axis 2, origin where axis 1 meets the plane"
    if robot is not None:
        what = f"the link '{robot.base}' of {robot.name}"
    lines = [fill(f"Base frame from {source}: {what}."), *_frame_text(survey.frame)]
    for table in (_sweeps_table(survey), _pairs_table(survey)):
        if len(table) > 1:
            lines += ["", *_aligned(table)]
    lines.append("")
    if not survey.findings:
        return [*lines, "No findings: the residuals look like noise."]
    told = (
        _FINDINGS[one.code].format(where=one.where, value=one.value, mm=1e3 * one.value)
        for one in survey.findings
    )
    return [*lines, "Findings:", *(fill(f"- {text}", "", "  ") for text in told)]


def _aligned(table: Table) -> Iterator[str]:
    """The lines of a table with its heads, the first column to the left, the others to the right."""
    first, *widths = (max(map(len, column)) for column in zip(*table, strict=True))
    for k, (name, *cells) in enumerate(table):
        inside = "  " * (k > 0)
        right = "".join(f"{cell:>{w + 2}}" for cell, w in zip(cells, widths, strict=True))
        yield f"{inside + name:<{first + 2}}{right}"


def _frame_text(frame: BaseFrame) -> Iterator[str]:
    """The frame and how well it is known."""
    T = frame.T_tracker_base
    yield "Pose of the base in the tracker's frame:"
    yield f"  x y z           {'  '.join(mm(v, 4) for v in T[:3, 3])} mm"
    rpy = pin.rpy.matrixToRpy(T[:3, :3])
    yield f"  roll pitch yaw  {'  '.join(deg(v, 6) for v in rpy)} deg"
    yield "Origin of the tracker's frame in the base:"
    yield f"  x y z           {'  '.join(mm(v, 1) for v in frame.T_base_tracker[:3, 3])} mm"
    yield ""
    axes = [*(f"{axis} [mm]" for axis in "xyz"), *(f"about {axis} [mrad]" for axis in "xyz")]
    numbers = zip(axes, frame.std, frame.within(0.95), strict=True)
    rows = [(axis, mm(std, 4), f"+-{mm(within, 4)}") for axis, std, within in numbers]
    yield from _aligned([("Along and about the axes of the base", "std", "95 % within"), *rows])


def _sweeps_table(survey: Survey) -> Table:
    """The plane and the circles."""
    heads = ("Sweep", "points", "radius [mm]", "arc [deg]", "radial rms", "max", "axial rms")
    table: Table = [(*heads, "max [mm]")]
    for name, figure in (("plane", survey.plane), *((j.name, j.circle) for j in survey.joints)):
        off = figure.residuals[figure.used]
        sizes = zip(np.sqrt(np.mean(off**2, axis=0)), np.abs(off).max(axis=0), strict=True)
        cells = [text for rms, most in sizes for text in (mm(rms, 4), mm(most))]
        shape = ["-"] * 4
        if isinstance(figure, Circle):
            shape = [mm(figure.radius), deg(figure.arc, 1)]
        table.append((name, str(figure.used.sum()), *shape, *cells))
    return table


def _pairs_table(survey: Survey) -> Table:
    """How neighbouring axes stand to each other, beside the URDF's."""
    heads = ("To the next axis", "angle [deg]", "std", "nominal", "distance [mm]", "std")
    table: Table = [(*heads, "nominal")]
    for pair in survey.pairs:
        angles = (pair.angle, pair.angle_std, pair.angle_nominal)
        distances = (pair.distance, pair.distance_std, pair.distance_nominal)
        numbers = [*(deg(value, 4) for value in angles), *(mm(value, 4) for value in distances)]
        table.append((pair.joints[0], *numbers))
    return table


def cell_text(frame: BaseFrame, source: str, **links: str | None) -> str:
    """The base frame as a cell file, with which measurements in the tracker's frame can be used as they are.

    ``source``, the file of sweeps, stands in a comment; ``base`` and ``tip`` are links, if they are named.
    """
    T, std = frame.T_tracker_base, 1e3 * frame.std
    along, about = (", ".join(f"{v:.3g}" for v in part) for part in (std[:3], std[3:]))
    lines = [
        f"# The base in the tracker's frame, by calib base-frame from {json.dumps(source)}.",
        f"# Standard deviation along x, y, z of the base: {along} mm, about them: {about} mrad.",
        *(f"{key} = {json.dumps(name)}" for key, name in links.items() if name),
        'frame = "known"',
        f"frame_xyz_mm = {(1e3 * T[:3, 3]).tolist()}",
        f"frame_rpy_deg = {np.degrees(pin.rpy.matrixToRpy(T[:3, :3])).tolist()}",
    ]
    return "\n".join([*lines, ""])
