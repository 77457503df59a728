"""``calib workspace``: where the target lies, how often, and the region to measure in."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import CellOptions, Columns, Force, Quiet, RobotFile, Seed, verb

File = Path | None


@verb("""Sample the reachable workspace of the target, and find the region to measure in.

\b
Examples:
  calib workspace ur3 --base base --tip tool0 --target "50 50 50 mm" -o region.json
  calib workspace robot.urdf --like data.csv --margin "5 deg" --check data.csv --picture region.png

The joints take all values in their ranges equally often ([ranges] of the cell file narrows them). The region is the
smallest part of space that holds the target with a probability of --share; 'calib plan --region region.json' chooses
poses inside it. Collisions are not checked here.
""")
def workspace(
    robot: RobotFile,
    setup: CellOptions,
    like: Annotated[File, typer.Option(help="Table whose estimation rows give the ranges.")] = None,
    margin: Annotated[
        str,
        typer.Option(metavar="ANGLE", help="Margin around --like (5 mm for prismatic joints)."),
    ] = "0 deg",
    share: Annotated[float, typer.Option(metavar="P", help="Probability in the region.")] = 0.95,
    samples: Annotated[
        int, typer.Option(min=1000, max=2**24, metavar="N", help="Samples of the joint values.")
    ] = 2**19,
    voxel: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Edge of a voxel. Default: by the samples.")
    ] = None,
    seed: Seed = 0,
    check: Annotated[File, typer.Option(help="Table: which of its rows lie in the region.")] = None,
    columns: Columns = None,
    output: Annotated[
        File, typer.Option("-o", "--output", help="Region file, for 'calib plan --region'.")
    ] = None,
    picture: Annotated[File, typer.Option(help="Density and region: .png, .svg or .pdf.")] = None,
    view: Annotated[File, typer.Option(help="3D page of robot and region.")] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    import numpy as np

    from calib.cli.setup import check_outputs, parse_columns, read_cell
    from calib.cli.terminal import progress_bar
    from calib.data.table import Table
    from calib.design.candidates import by_joint
    from calib.design.workspace import (
        Checked,
        Density,
        RegionView,
        read_rows,
        row_points,
        workspace as sample,
        write_region,
    )
    from calib.robot.ranges import joint_ranges
    from calib.robot.robot import Robot
    from calib.text.plan import workspace_text
    from calib.units import ANGLE, LENGTH, parse_amount

    tables = [path for path in (like, check) if path is not None]
    inputs: list[str | Path] = [robot, *tables, *filter(None, [setup.cell])]
    check_outputs([output, picture, view], inputs, force=force)
    if picture is not None:
        from calib.report.figure_region import check_ending, write_picture  # with matplotlib

        check_ending(picture)
    wider = parse_amount(margin, "--margin", ANGLE, "5 deg")
    edge = None if voxel is None else parse_amount(voxel, "--voxel", LENGTH, "20 mm")
    cell, renamed = read_cell(**asdict(setup)), parse_columns(columns or [])
    known = [Table.read(path).names(renamed) for path in tables]
    joints = set.intersection(*known) if known else None
    arm = Robot.load(robot, cell.base, cell.tip, measured=joints, held=cell.held)
    rows = {path: read_rows(path, arm, renamed, cell.kind) for path in tables}
    own = None if like is None else rows[like].joints_for(arm.joint_names)[rows[like].estimation]
    ends = joint_ranges(arm, cell.ranges, own, by_joint(arm, wider))
    # The cell's target, or its only named one, or the tip itself.
    only = [*cell.targets.values()] if len(cell.targets) == 1 else [np.zeros(3)]
    point = only[0] if cell.target is None else cell.target
    with progress_bar("workspace", quiet=quiet) as progress:
        points = sample(arm, point, ends, samples, seed, progress)
    density, checked = Density.of(points, edge), None
    if (path := check or like) is not None:
        checked = Checked(rows[path], *row_points(arm, rows[path], cell, point))
    found = RegionView(arm, point, ends, density, density.region(share), checked)
    if output is not None:
        write_region(found, output, seed, overwrite=force)
    if picture is not None:
        write_picture(found, picture, overwrite=force)
    if view is not None:
        from calib.viewer.design_view import region_page

        region_page(found).write(view, overwrite=force)
    if quiet:
        return
    origin = "" if like is None else f"the estimation rows of {like.name}, {margin} wider"
    lines = [workspace_text(found, origin, seed, every_row=check is not None), ""]
    lines += [f"Written: {path}" for path in (output, picture, view) if path is not None]
    typer.echo("\n".join(lines))
