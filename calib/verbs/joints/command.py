"""``calib joints``: joint values of a table with poses of the flange, by the inverse kinematics of its controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import CellOptions, ColumnChoice, Force, Quiet, RobotFile
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.verb import verb


@verb("""Compute joint values from poses of the flange, by inverse kinematics of the controller's model.

\b
Examples:
  calib joints robot.urdf corners.csv --poses-in base --poses-of tool0 -o with_joints.csv
  calib joints robot.urdf corners.csv --controller controller.csv --camera-on tool0 --board-on base \\
        --camera camera.toml --board board.toml -o with_joints.csv

The table has the pose that the controller showed in columns such as "flange_x [mm]" and "flange_qw"; see
docs/data-format.md. An arm reaches a pose in several ways: the limits of the joints, the other poses and what was
measured in the rows tell which one it was. If they do not, no table is written, and the exit status is 3; --accept
writes the likeliest one.
""")
def joints(
    robot: RobotFile,
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA", help="Table with poses of the flange, and what was measured."
        ),
    ],
    *,
    cell_options: CellOptions,
    column_options: ColumnChoice,
    controller: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="The robot as its controller has it, if that is another URDF or other DH rows than ROBOT; its joints "
            "are ROBOT's, in their order.",
        ),
    ] = None,
    poses_in: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Link in whose frame the controller gives poses. Default: the root.",
        ),
    ] = None,
    poses_of: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Link whose poses the controller gives. Default: the end of the longest chain, before a gripper.",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the table with joint values.")
    ] = None,
    accept: Annotated[
        bool,
        typer.Option("--accept", help="Write the likeliest joint values if they are not unique."),
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Read the poses, solve them, decide between the solutions, and write the table with joint values."""
    from calib.verbs.joints.joint_table import joints as joints_of_table
    from calib.verbs.joints.text import joints_text

    check_outputs([output], [robot, data, controller, cell_options.file], force=force)
    found = joints_of_table(
        robot,
        data,
        cell=cell_options.cell(),
        controller=controller,
        poses_in=poses_in,
        poses_of=poses_of,
        columns=column_options.parsed(),
    )
    if not quiet:
        typer.echo("\n".join(joints_text(found.controller, found.values, found.first_rows)))
    if output is not None:
        found.write(output, overwrite=force, accept=accept)
        if not quiet:
            typer.echo("\n".join(written_lines(output)))
