"""``calib base-frame``: the base frame and the joints' axes from single-joint sweeps."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import (
    Base,
    Columns,
    Debug,
    Force,
    PointsUnit,
    Quiet,
    Tip,
    reporting,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from calib.measure.axes import AxisRow, JointAxis, Survey
    from calib.measure.base_frame import BaseFrame
    from calib.measure.measurements import Measurements
    from calib.measure.sweeps import Sweeps
    from calib.model.robot import Robot

# A number of a DH row that is known better than this was set by the base's own definition [m, rad].
_BY_DEFINITION = 1e-10

_HELP = """Find the robot's base frame in the tracker's from points on its mounting plane and sweeps of joints 1 and 2.

\b
Examples:
  calib base-frame sweeps.csv --robot robot.urdf --base base --cell-out frame.toml
  calib base-frame --points tracker.txt --carry data.csv -o data_in_base.csv

The table has a column 'sweep' with 'plane', 'joint 1', 'joint 2' and so on, and x, y, z with their unit. Without joint
values the rows of a sweep are in the order of increasing joint angle. See docs/base-frame.md.
"""


def base_frame(
    data: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SWEEPS]", help="CSV table with the columns sweep, x, y, z, perhaps joints."
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="ROBOT",
            help="URDF, or a name such as 'ur3': the frame is then that of its link --base. Default: z along axis 1, y "
            "along axis 2.",
        ),
    ] = None,
    base: Base = None,
    tip: Tip = None,
    points: Annotated[
        Path | None,
        typer.Option(
            "--points",
            metavar="FILE",
            help="Points in a list of their own, named 'plane_1', 'joint1_01' and so on; or, beside a table, as its "
            "column 'point' names them.",
        ),
    ] = None,
    points_unit: PointsUnit = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"NAME=SWEEP"',
            help='What the file calls a sweep, such as "ring_a=joint 1". Can be repeated.',
        ),
    ] = None,
    columns: Columns = None,
    plane_offset: Annotated[
        str | None,
        typer.Option(
            "--plane-offset",
            metavar='"LENGTH"',
            help="How far the plane's points stand off it, towards the robot: the ball's radius, \"19.05 mm\".",
        ),
    ] = None,
    carry: Annotated[
        Path | None,
        typer.Option(
            "--carry", metavar="FILE", help="A table of measurements to carry into the base frame."
        ),
    ] = None,
    carry_points: Annotated[
        Path | None,
        typer.Option("--carry-points", metavar="FILE", help="The list of points of that table."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the carried table.")
    ] = None,
    cell_out: Annotated[
        Path | None,
        typer.Option(
            "--cell-out", metavar="FILE", help="Write the frame as a cell file, for --cell."
        ),
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write all of it as JSON.")] = None,
    robust: Annotated[
        bool, typer.Option("--robust/--no-robust", help="Leave gross rows out, and name them.")
    ] = True,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug):
        from calib.cli.setup import check_outputs
        from calib.identify.result_file import write_table
        from calib.measure.axes import survey
        from calib.measure.carrying import carried, cell_text, survey_table
        from calib.model.files import write_atomically

        _check_call(carry, carry_points, output)
        inputs = [p for p in (data, points, carry, carry_points, robot) if p is not None]
        check_outputs([output, cell_out, json], inputs, force=force)
        arm = _load(robot, base, tip)
        sweeps = _read(data, arm, columns, points, points_unit, sweep)
        found = survey(sweeps, arm, plane_offset=_length(plane_offset), robust=robust)
        written = []
        moved = None
        if carry is not None:
            moved = carried(_read_carried(carry, carry_points, points_unit, arm), found.frame)
        if moved is not None and output is not None:
            moved.write(output, overwrite=force)
            written.append(output)
        if cell_out is not None:
            text = cell_text(found, sweeps.source, None if arm is None else arm.base, tip)
            written.append(write_atomically(cell_out, text.encode(), overwrite=force))
        if json is not None:
            written.append(write_table(survey_table(found), json, overwrite=force))
        if quiet:
            return
        for line in (*_text(found, sweeps, arm), *_carried_text(moved, found.frame)):
            typer.echo(line)
        for path in written:
            typer.echo(f"Written: {path}")


def _check_call(carry: Path | None, carry_points: Path | None, output: Path | None) -> None:
    """Refuse options that need each other."""
    from calib.errors import CalibError

    if (carry is None) != (output is None) or (carry_points is not None and carry is None):
        message = (
            "--carry names the table to carry into the base frame and -o the file to write it to: give both, or "
            "neither; --carry-points is the list of points of the first."
        )
        raise CalibError(message)


def _load(robot: str | None, base: str | None, tip: str | None) -> Robot | None:
    """The robot, if one is named."""
    from calib.errors import CalibError
    from calib.model.robot import Robot

    if robot is not None:
        return Robot.load(robot, base, tip)
    if base is not None or tip is not None:
        message = "--base and --tip are links of a robot; name it with --robot, or leave them out."
        raise CalibError(message)
    return None


def _read(
    data: Path | None,
    robot: Robot | None,
    columns: Iterable[str] | None,
    points: Path | None,
    points_unit: str | None,
    words: Iterable[str] | None,
) -> Sweeps:
    """The sweeps of a table, of a list of points, or of both."""
    from calib.cli.words import parse_columns, parse_sweeps
    from calib.measure.sweep_words import check_words
    from calib.measure.sweeps import read_sweeps

    names = None if robot is None else robot.joint_names
    called = parse_sweeps(words or [])
    check_words(called, names or (), "--sweep")
    return read_sweeps(data, names, parse_columns(columns or []), points, points_unit, called)


def _read_carried(
    path: Path, points: Path | None, points_unit: str | None, robot: Robot | None
) -> Measurements:
    """The table of measurements to carry."""
    from calib.measure.measurements import Measurements

    names, types = (None, None) if robot is None else (robot.joint_names, robot.joint_types)
    unit = points_unit if points is not None else None
    return Measurements.read(path, names, types, points=points, points_unit=unit)


def _length(text: str | None) -> float:
    """A length with its unit [m]; 0 for none."""
    from calib.errors import CalibError
    from calib.measure.quantities import LENGTH, parse_quantity

    if text is None:
        return 0.0
    try:
        value, kind = parse_quantity(text)
    except CalibError as error:
        message = f'--plane-offset: {error}. Write "19.05 mm".'
        raise CalibError(message) from error
    if kind != LENGTH:
        message = f'--plane-offset was given as "{text}"; it must be a length, such as "19.05 mm".'
        raise CalibError(message)
    return value


def _text(survey: Survey, sweeps: Sweeps, robot: Robot | None) -> list[str]:
    """All that is printed of a survey."""
    lines = [*_frame_text(survey.frame, sweeps, robot), "", *_sweeps_text(survey), ""]
    if survey.rows:
        lines += [*_rows_text(survey), ""]
    if not survey.findings:
        lines.append(
            "The residuals look like noise: no gross rows, lobes, steps, or drift were found."
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


def _frame_text(frame: BaseFrame, sweeps: Sweeps, robot: Robot | None) -> list[str]:
    """The frame and how well it is known."""
    import numpy as np
    import pinocchio as pin

    from calib.measure.carrying import REACH_M, tracker_place

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
        *_wrapped(f"Base frame from {sweeps.source}: {what}."),
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
    import numpy as np

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
    import math

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
    import math

    from calib.measure.axis_geometry import NUMBERS

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


def _carried_text(table: Measurements | None, frame: BaseFrame) -> list[str]:
    """How far carried points are known, and which columns were left behind."""
    import numpy as np

    from calib.errors import choices

    if table is None:
        return []
    rows = table.positions
    std = np.sqrt((frame.std_at(table.points[rows]) ** 2).sum(axis=1))
    text = (
        f"Carried {int(rows.sum())} rows of {table.source} into the base frame; it moves them "
        f"together by {1e3 * std.max():.3f} mm at most (std). 'calib fit' takes them with --frame known, the default."
    )
    if table.ignored:
        text += f" Columns left out: {choices(table.ignored)}."
    return ["", *_wrapped(text)]


base_frame.__doc__ = _HELP
