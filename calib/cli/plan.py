"""``calib plan``: a robot in, the poses to measure out, and what they will give."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import (
    Base,
    CellFile,
    Columns,
    Debug,
    Force,
    Frame,
    Hold,
    MeasuredKind,
    ModelName,
    PayloadMass,
    Quiet,
    RobotFile,
    reporting,
)
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.design.plan import Plan
    from calib.design.plan_file import Taken
    from calib.design.region import Region
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

#: Of a larger distance between meshes coal takes half a second a pose, where 0.1 m take 6 ms [m].
_LARGEST_CLEARANCE = 0.1

_HELP = """Plan the poses of a calibration: which to measure, in which order, and how accurate the robot will be.

\b
Examples:
  calib plan ur3 --base base --tip tool0 --target "70 -70 22.5 mm" -o plan.csv
  calib plan robot.urdf --tracker "2500 0 500 mm" --reflector "0 0 1" \\
        --box "table: 0 0 -25 1200 800 50 mm" -o plan.csv --json plan.json
  calib plan robot.urdf --region region.json --model dh --count 40 -o plan.csv
  calib plan robot.urdf --taken measured.csv --count 5 --validation 0 -o next.csv

Drive the poses from top to bottom, write what was measured into the empty columns, and give the table to calib fit.
Rows that stay empty are left out there.
"""


def plan(
    robot: RobotFile,
    count: Annotated[int, typer.Option(metavar="N", help="Poses to calibrate with.")] = 30,
    validation: Annotated[
        int, typer.Option(metavar="N", help="Poses besides, drawn at random, to validate with.")
    ] = 5,
    criterion: Annotated[
        str,
        typer.Option(
            metavar="V|D|A",
            help="V: least mean error over the workspace (default). D: most information on the parameters. A: least "
            "mean variance of the parameters.",
        ),
    ] = "V",
    model: ModelName = None,
    base: Base = None,
    tip: Annotated[
        str | None,
        typer.Option(
            help="Link that the target is mounted on. Default: the end of the longest chain, with --taken of joints "
            "that are in its table."
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Target in the tip, to about a centimetre, such as "70 -70 22.5 mm". Default: 50, 70, 30 mm off the '
            "tip, which is only a guess.",
        ),
    ] = None,
    frame: Frame = None,
    kind: MeasuredKind = None,
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NOISE",
            help='Of one measured coordinate, "0.05 mm", or "15 um + 6 um/m" by the distance. Default: a laser '
            "tracker's.",
        ),
    ] = None,
    payload: PayloadMass = None,
    hold: Hold = None,
    cell: CellFile = None,
    region: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Region that the target is to lie in, as calib workspace writes it.",
        ),
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar='"JOINT=LOW..HIGH UNIT"',
            help='Range of a joint to plan in, such as "elbow_joint=-90..90 deg". Can be repeated.',
        ),
    ] = None,
    margin: Annotated[
        str,
        typer.Option(metavar="ANGLE", help="Distance to the joint limits of the URDF."),
    ] = "5 deg",
    boxes: Annotated[
        list[str] | None,
        typer.Option(
            "--box",
            metavar='"NAME: X Y Z SX SY SZ UNIT"',
            help="A box that robot and target must not touch, centre in the base and edges: "
            '"table: 0 0 -25 1200 800 50 mm". Can be repeated.',
        ),
    ] = None,
    clearance: Annotated[
        str,
        typer.Option(
            metavar="LENGTH",
            help="Least distance of links and targets to each other and to what stands around.",
        ),
    ] = "0 mm",
    collisions: Annotated[
        bool, typer.Option(help="Check poses, and moves between them, for collisions.")
    ] = True,
    floor: Annotated[
        bool,
        typer.Option(
            help="Keep above the robot's mounting plane: z = 0 of the base link, however the robot is hung."
        ),
    ] = True,
    holder: Annotated[
        str,
        typer.Option(
            metavar="LENGTH",
            help="Radius of the target and what holds it: a rod from the tip to the target, in the collision check.",
        ),
    ] = "20 mm",
    package_dir: Annotated[
        list[Path] | None,
        typer.Option(
            "--package-dir",
            metavar="FOLDER",
            help="Folder in which packages of meshes lie. Can be repeated.",
        ),
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help="Where the tracker stands in the base; it must see the target.",
        ),
    ] = None,
    reflector: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z"',
            help="Direction in the tip that the reflector faces. Default: it is turned by hand.",
        ),
    ] = None,
    taken: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Table of poses that are measured already; the plan adds to them."
        ),
    ] = None,
    columns: Columns = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar='home|"JOINT=VALUE UNIT"',
            help="Where the robot stands before; home: all joints at zero. Can be repeated. Default: at any pose.",
        ),
    ] = None,
    ladder: Annotated[
        str | None,
        typer.Option(
            metavar='"N,N,..."|none',
            help="Numbers of poses to forecast too. Default: some around --count.",
        ),
    ] = None,
    candidates: Annotated[
        int, typer.Option(metavar="N", help="Poses among which is chosen.")
    ] = 20_000,
    seed: Annotated[
        int, typer.Option(min=0, metavar="S", help="The same S gives the same plan.")
    ] = 0,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the table of poses.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Write plan and forecast as JSON.")
    ] = None,
    view: Annotated[
        Path | None,
        typer.Option(
            "--view",
            help="Write a page that shows robot, targets and what stands around, to open in a browser.",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug):
        from calib.cli.plan_text import expected_text, next_text, plan_text, taken_text
        from calib.cli.setup import check_outputs, parse_amount, parse_columns, read_cell
        from calib.cli.surroundings_words import add_surroundings, parse_start, with_noise
        from calib.cli.terminal import stages_bar
        from calib.design.plan import plan as make_plan
        from calib.design.plan_file import read_taken

        inputs: list[str | Path] = [robot, *(path for path in (cell, region, taken) if path)]
        check_outputs([output, json, view], inputs, force=force)
        rungs, gap = parse_ladder(ladder), parse_amount(margin, "--margin", "an angle", "5 deg")
        clear = parse_amount(clearance, "--clearance", "a length", "1 mm")
        if clear > _LARGEST_CLEARANCE:
            raise CalibError(
                f'--clearance was given as "{clearance}"; it must be {1e3 * _LARGEST_CLEARANCE:g} mm or less, for '
                "links of an arm pass each other closer than that. To keep more distance to a box make the box larger."
            )
        setup = read_cell(
            cell,
            base=base,
            tip=tip,
            target=target,
            frame=frame,
            model=model,
            kind=kind,
            hold=hold,
            payload=payload,
        )
        setup = add_surroundings(
            setup, tracker=tracker, reflector=reflector, boxes=boxes, ranges=ranges
        )
        setup = with_noise(setup, noise)
        renamed = parse_columns(columns or [])
        arm = load_for_plan(robot, setup, taken, renamed)
        place, remarks = read_region(region, arm, setup)
        before = None if taken is None else read_taken(taken, arm, renamed)
        first = parse_start(start or [], arm)
        with stages_bar(quiet=quiet) as progress:
            made = make_plan(
                arm,
                setup,
                count=count,
                validation=validation,
                criterion=criterion,
                candidates=candidates,
                region=place,
                margin=gap,
                taken=None if before is None else before.joints,
                collisions=collisions,
                clearance=clear,
                floor=floor,
                holder_radius=parse_amount(holder, "--holder", "a length", "20 mm"),
                package_dirs=package_dir or (),
                ladder=rungs,
                start=first,
                seed=seed,
                progress=progress,
            )
        _write(made, output, json, view, before, force=force)
        if quiet:
            return
        said = (*taken_text(before, taken), *remarks, *expected_text(setup, arm.base))
        typer.echo(plan_text(made, setup.model, said) + "\n")
        for path in (output, json, view):
            if path is not None:
                typer.echo(f"Written: {path}")
        options = {
            "--base": base,
            "--tip": tip,
            "--target": target,
            "--frame": frame,
            "--kind": kind,
            "--model": model,
            "--payload": payload,
            "--cell": None if cell is None else str(cell),
        }
        typer.echo(next_text(made, robot, output, taken, options, hold or []))


def parse_ladder(text: str | None) -> list[int] | None:
    """``--ladder``: numbers of poses such as ``10,15,20``; ``none`` is an empty list.

    Raises:
        CalibError: No whole numbers above 0.
    """
    if text is None:
        return None
    words = text.replace(",", " ").split()
    if words == ["none"]:
        return []
    if not words or not all(re.fullmatch(r"[0-9]{1,9}", word) and int(word) for word in words):
        raise CalibError(
            f'--ladder was given as "{text}"; it must be numbers of poses such as "10,15,20,30", or \'none\'.'
        )
    return [int(word) for word in words]


def load_for_plan(robot: str, cell: Cell, taken: Path | None, columns: dict[str, str]) -> Robot:
    """The robot; a tip that was not named is chosen by the columns of the table taken, as ``calib fit`` does.

    Raises:
        CalibError: Names for the columns of a table that there is not.
    """
    from calib.measure.table import Table
    from calib.model.robot import Robot
    from calib.units import split_header

    if columns and taken is None:
        raise CalibError(
            "--columns renames the columns of a table of poses taken; name it with --taken."
        )
    names = None
    if taken is not None:
        names = {split_header(label)[0] for label in Table.read(taken).header}
        names |= {split_header(wanted)[0] for wanted in columns.values()}
    return Robot.load(robot, cell.base, cell.tip, measured=names, held=cell.held)


def read_region(path: Path | None, robot: Robot, cell: Cell) -> tuple[Region | None, list[str]]:
    """The region of a file, and sentences on what of it does not quite fit the robot.

    Raises:
        CalibError: It cannot be read, or is another robot's.
    """
    from calib.design.region import RegionFile

    if path is None:
        return None, []
    file = RegionFile.read(path)
    target = next(iter(cell.targets.values()), cell.target)
    return file.region, list(file.check_fits(robot, target))


def _write(
    made: Plan,
    output: Path | None,
    json: Path | None,
    view: Path | None,
    before: Taken | None,
    *,
    force: bool,
) -> None:
    """Write the files asked for; rows go on behind those that were taken."""
    from calib.design.plan_file import plan_table, write_plan

    if output is not None:
        first = 1 if before is None else max(before.last_row, 0) + 1
        write_plan(made, output, overwrite=force, first_row=first)
    if json is not None:
        from calib.identify.result_file import write_table

        write_table(plan_table(made), json, overwrite=force)
    if view is not None:
        from calib.show.plan_view import write_plan_view

        write_plan_view(made, view, overwrite=force)


plan.__doc__ = _HELP
