"""``calib workspace``: where the target lies, how often, and the region to measure in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.loading import load
from calib.cli.options import CellOptions, ColumnChoice, Force, Quiet, RobotFile, Seed
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import moving_bar, progress_bar
from calib.cli.verb import verb

_File = Path | None


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
    *,
    cell_options: CellOptions,
    column_options: ColumnChoice,
    like: Annotated[
        _File, typer.Option(help="Table whose rows for estimation give the ranges of the joints.")
    ] = None,
    margin: Annotated[
        str,
        typer.Option(
            metavar="ANGLE",
            help="Margin added to the ranges of --like at both ends; it is 5 mm for prismatic joints.",
        ),
    ] = "0 deg",
    check: Annotated[
        _File, typer.Option(help="Table whose rows are checked: which of them lie in the region.")
    ] = None,
    share: Annotated[
        float, typer.Option(metavar="P", help="Probability that the target is in the region.")
    ] = 0.95,
    samples: Annotated[
        int,
        typer.Option(
            min=1000, max=2**24, metavar="N", help="Number of samples of the joint values."
        ),
    ] = 2**19,
    voxel: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Length of the edge of a voxel. Default: chosen by the number of samples.",
        ),
    ] = None,
    seed: Seed = 0,
    output: Annotated[
        _File,
        typer.Option(
            "-o", "--output", help="Write the region as a file, for 'calib plan --region'."
        ),
    ] = None,
    picture: Annotated[
        _File,
        typer.Option(help="Write a figure of the density and the region: .png, .svg or .pdf."),
    ] = None,
    view: Annotated[
        _File,
        typer.Option(help="Write a page that shows robot and region in 3D, to open in a browser."),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Sample the workspace, write the files and print the region."""
    import numpy as np

    from calib.basics.tables import Table
    from calib.basics.units import ANGLE, LENGTH, parse_amount
    from calib.data.cell_chains import refuse_several_chains
    from calib.data.columns import column_names
    from calib.robot.ranges import joint_ranges, margins_by_joint
    from calib.show.plotting import require_matplotlib
    from calib.verbs.workspace.region import Density
    from calib.verbs.workspace.region_file import write_region
    from calib.verbs.workspace.region_picture import check_ending, write_picture
    from calib.verbs.workspace.region_rows import Checked, RegionView, read_rows, row_points
    from calib.verbs.workspace.text import workspace_text
    from calib.verbs.workspace.workspace import workspace_points

    check_outputs([output, picture, view], [robot, like, check, cell_options.file], force=force)
    if picture is not None:
        require_matplotlib("A picture")
        check_ending(picture)
    edge = None if voxel is None else parse_amount(voxel, "--voxel", LENGTH, "20 mm")
    margin_rad = parse_amount(margin, "--margin", ANGLE, "5 deg")

    # Without a tip the chain is that of the joints that the tables have in common.
    cell = cell_options.cell()
    refuse_several_chains(cell, "calib workspace shows where a target gets")
    columns = column_options.parsed()
    paths = [path for path in (like, check) if path is not None]
    joints = [column_names(Table.read(path), columns) for path in paths]
    known = [names for names in joints if names is not None]
    arm = load(robot, cell, set.intersection(*known) if known else None)
    tables = {path: read_rows(path, arm, columns, cell.kind) for path in paths}

    measured = None
    if like is not None:
        rows = tables[like]
        measured = rows.joints_for(arm.joint_names)[rows.estimation]
    limits = joint_ranges(arm, cell.ranges, measured, margins_by_joint(arm, margin_rad))

    target = np.zeros(3) if cell.target is None else cell.target
    if cell.target is None and len(cell.targets) == 1:
        (target,) = cell.targets.values()
    with progress_bar("workspace", quiet=quiet) as progress:
        points = workspace_points(arm, target, limits, samples, seed, progress)
    with moving_bar("region", quiet=quiet):
        density = Density.of(points, edge)
        checked = None
        checked_path = check or like
        if checked_path is not None:
            rows = tables[checked_path]
            checked = Checked(rows, *row_points(arm, rows, cell, target))
        found = RegionView(arm, target, limits, density, density.region(share), checked)
        if output is not None:
            write_region(found, output, seed, overwrite=force)
        if picture is not None:
            write_picture(found, picture, overwrite=force)
        if view is not None:
            from calib.verbs.workspace.region_page import region_page  # with meshcat

            region_page(found).write(view, overwrite=force)
    if quiet:
        return
    origin = ""
    if like is not None:
        origin = f"the estimation rows of {like.name}, {margin} wider"
    text = workspace_text(found, origin, seed, every_row=check is not None)
    typer.echo("\n".join([text, "", *written_lines(output, picture, view)]))
