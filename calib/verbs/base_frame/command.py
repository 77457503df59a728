"""``calib base-frame``: the base frame and the joints' axes from single-joint sweeps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from calib.cli.options import CellOptions, ColumnChoice, Force, PointsUnit, Quiet
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.verb import verb
from calib.errors import CalibError

_File = Path | None


@dataclass(frozen=True, slots=True)
class ChainOptions(CellOptions):
    """Chain of the robot whose base frame is wanted."""

    names: ClassVar[tuple[str, ...]] = ("base", "tip")
    has_file: ClassVar[bool] = False


@verb("""Measure the robot's base frame from points on its mounting plane and sweeps of joints 1 and 2.

\b
Examples:
  calib base-frame sweeps.csv --robot robot.urdf --base base --cell-out frame.toml
  calib base-frame --points tracker.txt --json frame.json

The table has a column 'sweep' with 'plane', 'joint 1', 'joint 2' and so on, and x, y, z with their unit. Without joint
values the rows of a sweep are in the order of increasing joint angle. See docs/base-frame.md.
""")
def base_frame(
    *,
    cell_options: ChainOptions,
    column_options: ColumnChoice,
    points: Annotated[
        _File,
        typer.Option(
            help="List of the measured points, named 'plane_1', 'joint1_01' and so on, or, with a table, as its column "
            "'point' names them.",
        ),
    ] = None,
    points_unit: PointsUnit = None,
    cell_out: Annotated[
        _File,
        typer.Option(help="Write the base's pose in the tracker as a cell file (TOML)."),
    ] = None,
    json: Annotated[
        _File, typer.Option(help="Write frame, axes, sweeps and findings as JSON.")
    ] = None,
    force: Force = False,
    data: Annotated[
        _File,
        typer.Argument(
            metavar="[SWEEPS]",
            help="Table with the columns sweep, x, y, z, and the joint values if they are known.",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            help="URDF, or a name such as 'ur3', of the robot whose link --base is the frame. Default: a frame with "
            "its origin where axis 1 meets the plane, z along axis 1 and y along axis 2.",
        ),
    ] = None,
    plane_offset: Annotated[
        str,
        typer.Option(
            help="Distance of the probe centre from the plane, positive towards the robot: the radius of the ball, "
            'such as "19.05 mm".'
        ),
    ] = "0 mm",
    robust: Annotated[bool, typer.Option(help="Reject outliers and report them.")] = True,
    quiet: Quiet = False,
) -> None:
    """Read sweeps, estimate the base frame, write the files named, and print frame, sweeps and findings."""
    from calib.basics.files import write_atomically
    from calib.basics.units import LENGTH, parse_amount
    from calib.result.calibration_file import write_table
    from calib.robot.robot import Robot
    from calib.verbs.base_frame.base_frame import base_frame as estimate_base_frame
    from calib.verbs.base_frame.sweeps import read_sweeps
    from calib.verbs.base_frame.text import base_frame_text, cell_text

    if robot is None and cell_options.given:
        raise CalibError("--base and --tip are links of a robot; name it with --robot.")
    files = (cell_out, json)
    check_outputs(files, [data, points, robot], force=force)
    chain = cell_options.cell()
    arm = None if robot is None else Robot.load(robot, chain.base, chain.tip)
    sweeps = read_sweeps(
        data,
        None if arm is None else arm.joint_names,
        column_options.parsed(),
        points,
        points_unit,
    )
    offset = parse_amount(plane_offset, "--plane-offset", LENGTH, "19.05 mm", signed=True)
    frame = estimate_base_frame(sweeps, arm, plane_offset=offset, robust=robust)
    lines = base_frame_text(frame, sweeps.source, arm)
    if cell_out is not None:
        base = None if arm is None else arm.base
        content = cell_text(frame, sweeps.source, base=base, tip=chain.tip)
        write_atomically(cell_out, content.encode(), overwrite=force)
    if json is not None:
        write_table(frame.table(), json, overwrite=force)
    if not quiet:
        typer.echo("\n".join([*lines, *written_lines(*files)]))
