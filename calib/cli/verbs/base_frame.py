"""``calib base-frame``: the base frame and the joints' axes from single-joint sweeps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Base, Columns, Force, PointsUnit, Quiet, Tip, verb
from calib.errors import CalibError

_File = Path | None


@verb("""Find the robot's base frame in the tracker's from points on its mounting plane and sweeps of joints 1 and 2.

\b
Examples:
  calib base-frame sweeps.csv --robot robot.urdf --base base --cell-out frame.toml
  calib base-frame --points tracker.txt --json frame.json

The table has a column 'sweep' with 'plane', 'joint 1', 'joint 2' and so on, and x, y, z with their unit. Without joint
values the rows of a sweep are in the order of increasing joint angle. See docs/base-frame.md.
""")
def base_frame(
    data: Annotated[
        _File, typer.Argument(metavar="[SWEEPS]", help="CSV table: sweep, x, y, z, perhaps joints.")
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            help="URDF, or a name such as 'ur3', for the frame of its link --base. Default: z along axis 1, y along "
            "axis 2.",
        ),
    ] = None,
    base: Base = None,
    tip: Tip = None,
    points: Annotated[
        _File,
        typer.Option(
            help="List of points, named 'plane_1', 'joint1_01' and so on; or, beside a table, as its column 'point' "
            "names them.",
        ),
    ] = None,
    points_unit: PointsUnit = None,
    columns: Columns = None,
    plane_offset: Annotated[
        str, typer.Option(help='Probe centre to plane: the radius of the ball, "19.05 mm".')
    ] = "0 mm",
    cell_out: Annotated[_File, typer.Option(help="Write the frame as a cell file.")] = None,
    json: Annotated[_File, typer.Option(help="Write all of it as JSON.")] = None,
    robust: Annotated[bool, typer.Option(help="Reject and report outliers.")] = True,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.circle_points.survey import base_frame as found_frame
    from calib.circle_points.sweeps import read_sweeps
    from calib.cli.setup import check_outputs, parse_columns
    from calib.files import write_atomically
    from calib.result.calibration_file import write_table
    from calib.robot.robot import Robot
    from calib.text.base_frame import cell_text, survey_text
    from calib.units import LENGTH, parse_amount

    if robot is None and (base or tip):
        raise CalibError("--base and --tip are links of a robot; name it with --robot.")
    inputs = [p for p in (data, points, robot) if p is not None]
    check_outputs([cell_out, json], inputs, force=force)
    arm = None if robot is None else Robot.load(robot, base, tip)
    names = None if arm is None else arm.joint_names
    sweeps = read_sweeps(data, names, parse_columns(columns or []), points, points_unit)
    offset = parse_amount(plane_offset, "--plane-offset", LENGTH, "19.05 mm", signed=True)
    found = found_frame(sweeps, arm, plane_offset=offset, robust=robust)
    lines, written = survey_text(found, sweeps.source, arm), []
    if cell_out is not None:
        text = cell_text(found.frame, sweeps.source, base=arm.base if arm else None, tip=tip)
        written.append(write_atomically(cell_out, text.encode(), overwrite=force))
    if json is not None:
        written.append(write_table(found.table(), json, overwrite=force))
    if not quiet:
        for line in (*lines, *(f"Written: {path}" for path in written)):
            typer.echo(line)
