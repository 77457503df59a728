"""``calib joints``: joint values of a table with poses of the flange, by the inverse kinematics of its controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.loading import load
from calib.cli.options import CellOptions, ColumnChoice, Force, Quiet, RobotFile
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.verb import verb
from calib.errors import CalibError, VerdictError


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
    from calib.basics.files import write_atomically
    from calib.basics.tables import Table
    from calib.robot.robot import Robot
    from calib.verbs.joints.joints import MeasuredThere, joint_values
    from calib.verbs.joints.pose_table import PoseTable
    from calib.verbs.joints.text import joints_text, not_unique_text

    check_outputs([output], [robot, data, controller, cell_options.file], force=force)
    cell = cell_options.cell()
    table = PoseTable.read(Table.read(data), column_options.parsed())
    arm = Robot.load(robot, poses_in, poses_of, held=cell.held, coupling=cell.coupling)
    shown = arm
    if controller is not None:
        shown = Robot.load(controller, poses_in, poses_of)
        if len(shown.joint_names) != len(arm.joint_names):
            raise CalibError(
                f"'{controller}' has {len(shown.joint_names)} joints between '{shown.base}' and '{shown.tip}', and "
                f"'{robot}' {len(arm.joint_names)} between '{arm.base}' and '{arm.tip}'. Name the frame of the poses "
                "with --poses-in and the link with --poses-of."
            )
    measured = None
    if table.measures and (cell.base is not None or cell.tip is not None):
        fitted = load(robot, cell, arm.joint_names)
        rows, pose = table.measurements(cell.kind)
        measured = MeasuredThere(fitted, rows, cell, arm.joint_names, pose)
    found = joint_values(shown, table.T_base_flange, measured)

    rows_of_poses = [table.pose.tolist().index(p) + 1 for p in range(len(found.q))]
    withheld = not found.unique.all() and not accept
    if output is not None and not withheld:
        content = table.with_joints(arm.joint_names, found.q, [
            name for name, kind in arm.joint_types.items() if kind == "prismatic"
        ])  # fmt: skip
        write_atomically(output, content, overwrite=force)
    if not quiet:
        written = [] if withheld else written_lines(output)
        typer.echo("\n".join([*joints_text(shown, found, rows_of_poses), *written]))
    if output is not None and withheld:
        raise VerdictError(
            f"{not_unique_text(found, rows_of_poses)} No table was written; --accept writes the likeliest values."
        )
