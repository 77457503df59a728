"""``calib plan``: a robot in, the poses to measure out, and the accuracy to expect."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Force, ModelOptions, Quiet, RobotFile, Seed, verb

File = Path | None


@verb("""Plan the poses of a calibration: which to measure, in which order, and how accurate the robot will be.

\b
Examples:
  calib plan ur3 --base base --tip tool0 --target "70 -70 22.5 mm" -o plan.csv
  calib plan robot.urdf --cell cell.toml --tracker "2500 0 500 mm" -o plan.csv --json plan.json
  calib plan robot.urdf --region region.json --model dh --count 40 -o plan.csv
  calib plan robot.urdf --taken measured.csv --count 5 --validation 0 -o next.csv

Boxes, reflector, noise and joint ranges stand in the cell file. Drive the poses from top to bottom, write what was
measured into the empty columns, and give the table to calib calibrate. Rows that stay empty are left out there.
""")
def plan(
    robot: RobotFile,
    setup: ModelOptions,
    count: Annotated[int, typer.Option(metavar="N", help="Poses to calibrate with.")] = 30,
    validation: Annotated[int, typer.Option(metavar="N", help="Random validation poses.")] = 5,
    criterion: Annotated[str, typer.Option(metavar="V|D|A", help="Optimality criterion.")] = "V",
    candidates: Annotated[int, typer.Option(metavar="N", help="Poses to choose from.")] = 20_000,
    seed: Seed = 0,
    tracker: Annotated[
        str | None,
        typer.Option(metavar='"X Y Z UNIT"', help="Position of the tracker, in the base."),
    ] = None,
    region: Annotated[File, typer.Option(help="Region for the target, of calib workspace.")] = None,
    margin: Annotated[str, typer.Option(metavar="ANGLE", help="Margin to joint limits.")] = "5 deg",
    clearance: Annotated[
        str, typer.Option(metavar="LENGTH", help="Least distance of bodies.")
    ] = "0 mm",
    collisions: Annotated[bool, typer.Option(help="Check poses and moves for collisions.")] = True,
    floor: Annotated[bool, typer.Option(help="Keep above the robot's mounting plane.")] = True,
    package_dir: Annotated[
        list[Path] | None, typer.Option(metavar="FOLDER", help="Folder with packages of meshes.")
    ] = None,
    taken: Annotated[File, typer.Option(help="Table of poses measured already, to add to.")] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(metavar='"JOINT=VALUE UNIT"', help="Start pose; other joints are at 0."),
    ] = None,
    output: Annotated[File, typer.Option("-o", "--output", help="Table of poses.")] = None,
    json: Annotated[File, typer.Option(help="Plan and forecast as JSON.")] = None,
    view: Annotated[File, typer.Option(help="3D page of the plan.")] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    import calib.cli.setup as words
    from calib.cli.terminal import stages_bar
    from calib.compensation.inverse import start_values
    from calib.data.table import Table
    from calib.design.collision import CollisionCheck
    from calib.design.optimal import PlanRequest
    from calib.design.plan import plan as make_plan, plan_table, read_poses, write_plan
    from calib.design.workspace import read_region
    from calib.result.calibration_file import write_table
    from calib.robot.robot import Robot
    from calib.text.plan import plan_text
    from calib.units import ANGLE, LENGTH, parse_amount

    inputs: list[str | Path] = [robot, *filter(None, (setup.cell, region, taken))]
    words.check_outputs([output, json, view], inputs, force=force)
    gap = parse_amount(margin, "--margin", ANGLE, "5 deg")
    clear = parse_amount(clearance, "--clearance", LENGTH, "1 mm")
    cell = words.read_cell(**asdict(setup))
    cell = replace(cell, tracker=words.parse_tracker(tracker, cell.tracker))
    names = None if taken is None else Table.read(taken).names({})
    arm = Robot.load(robot, cell.base, cell.tip, measured=names, held=cell.held)
    point = next(iter(cell.targets.values()), cell.target)
    place = None if region is None else read_region(region, arm, point)
    before = None if taken is None else read_poses(taken, arm, taken=True)
    check = CollisionCheck(clear, floor, package_dirs=tuple(package_dir or ()))
    request = PlanRequest(count, validation, criterion, candidates, gap, seed=seed)
    if start:
        request = replace(request, start=start_values(arm, words.parse_held(start, "--start"), 0.0))
    with stages_bar(quiet=quiet) as progress:
        made = make_plan(
            arm,
            cell,
            request,
            region=place,
            taken=None if before is None else before.joints,
            collisions=check if collisions else None,
            progress=progress,
        )
    if output is not None:
        # Rows go on behind those that were taken.
        first = 1 if before is None else max(before.last_row, 0) + 1
        write_plan(made, output, overwrite=force, first_row=first)
    if json is not None:
        write_table(plan_table(made), json, overwrite=force)
    if view is not None:
        from calib.viewer.design_view import plan_page

        plan_page(made).write(view, overwrite=force)
    if not quiet:
        written = [f"Written: {path}" for path in (output, json, view) if path is not None]
        typer.echo("\n".join([plan_text(made), "", *written]))
