"""``calib base-frame``: the base frame and the joints' axes from single-joint sweeps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import Base, ColumnChoice, Force, PointsUnit, Quiet, Tip
from calib.cli.outputs import check_outputs, written_lines
from calib.cli.verb import verb
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.robot.robot import Robot
    from calib.verbs.base_frame.base_frame import BaseFrame

_File = Path | None


@dataclass(frozen=True, slots=True)
class ArmOptions:
    """The robot whose base frame is wanted."""

    robot: Annotated[
        str | None,
        typer.Option(
            help="URDF, or a name such as 'ur3', for the frame of its link --base. Default: z "
            "along axis 1, y along axis 2.",
        ),
    ] = None
    base: Base = None
    tip: Tip = None

    def load(self) -> Robot | None:
        """Load the robot; None without one."""
        from calib.robot.robot import Robot

        return None if self.robot is None else Robot.load(self.robot, self.base, self.tip)


@dataclass(frozen=True, slots=True)
class SweepTables(ColumnChoice):
    """Reading of the sweeps."""

    points: Annotated[
        _File,
        typer.Option(
            help="List of points, named 'plane_1', 'joint1_01' and so on; or, beside a table, as "
            "its column 'point' names them.",
        ),
    ] = None
    points_unit: PointsUnit = None


@dataclass(frozen=True, slots=True)
class FrameOutputs:
    """Files that are written."""

    cell_out: Annotated[_File, typer.Option(help="Write the frame as a cell file.")] = None
    json: Annotated[_File, typer.Option(help="Write all of it as JSON.")] = None
    force: Force = False

    def write(self, frame: BaseFrame, cell_text: str) -> None:
        """Write the files that were asked for."""
        from calib.basics.files import write_atomically
        from calib.result.calibration_file import write_table

        if self.cell_out is not None:
            write_atomically(self.cell_out, cell_text.encode(), overwrite=self.force)
        if self.json is not None:
            write_table(frame.table(), self.json, overwrite=self.force)


@verb("""Find the robot's base frame in the tracker's from points on its mounting plane and sweeps of joints 1 and 2.

\b
Examples:
  calib base-frame sweeps.csv --robot robot.urdf --base base --cell-out frame.toml
  calib base-frame --points tracker.txt --json frame.json

The table has a column 'sweep' with 'plane', 'joint 1', 'joint 2' and so on, and x, y, z with their unit. Without joint
values the rows of a sweep are in the order of increasing joint angle. See docs/base-frame.md.
""")
def base_frame(
    arm: ArmOptions,
    tables: SweepTables,
    outputs: FrameOutputs,
    data: Annotated[
        _File,
        typer.Argument(metavar="[SWEEPS]", help="CSV table: sweep, x, y, z, perhaps joints."),
    ] = None,
    plane_offset: Annotated[
        str, typer.Option(help='Probe centre to plane: the radius of the ball, "19.05 mm".')
    ] = "0 mm",
    robust: Annotated[bool, typer.Option(help="Reject and report outliers.")] = True,
    quiet: Quiet = False,
) -> None:
    """Run the verb; its help is the text of `verb`."""
    from calib.basics.units import LENGTH, parse_amount
    from calib.verbs.base_frame.base_frame import base_frame as estimate_base_frame
    from calib.verbs.base_frame.sweeps import read_sweeps
    from calib.verbs.base_frame.text import base_frame_text, cell_text

    if arm.robot is None and (arm.base or arm.tip):
        raise CalibError("--base and --tip are links of a robot; name it with --robot.")
    files = (outputs.cell_out, outputs.json)
    check_outputs(files, [data, tables.points, arm.robot], force=outputs.force)
    robot = arm.load()
    joint_names = None if robot is None else robot.joint_names
    sweeps = read_sweeps(data, joint_names, tables.parsed(), tables.points, tables.points_unit)
    offset = parse_amount(plane_offset, "--plane-offset", LENGTH, "19.05 mm", signed=True)
    frame = estimate_base_frame(sweeps, robot, plane_offset=offset, robust=robust)
    lines = base_frame_text(frame, sweeps.source, robot)
    base = robot.base if robot else None
    outputs.write(frame, cell_text(frame, sweeps.source, base=base, tip=arm.tip))
    if not quiet:
        typer.echo("\n".join([*lines, *written_lines(*files)]))
