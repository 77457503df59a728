"""``calib plan``: a robot in, the poses to measure out, and what they will give."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Columns, Force, ModelOptions, Quiet, RobotFile, verb
from calib.errors import CalibError

#: Of a larger distance between meshes coal takes half a second a pose, where 0.1 m take 6 ms [m].
_LARGEST_CLEARANCE = 0.1


@dataclass(frozen=True, slots=True)
class PlanOptions(ModelOptions):
    """The set-up as the line has it, with what a plan means by it."""

    tip: Annotated[
        str | None,
        typer.Option(
            help="Link that the target is mounted on. Default: the end of the longest chain, with --taken of joints "
            "that are in its table."
        ),
    ] = None
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Target in the tip, to about a centimetre, such as "70 -70 22.5 mm". Default: 50, 70, 30 mm off the '
            "tip, which is only a guess.",
        ),
    ] = None


@verb("""Plan the poses of a calibration: which to measure, in which order, and how accurate the robot will be.

\b
Examples:
  calib plan ur3 --base base --tip tool0 --target "70 -70 22.5 mm" -o plan.csv
  calib plan robot.urdf --tracker "2500 0 500 mm" --reflector "0 0 1" \\
        --box "table: 0 0 -25 1200 800 50 mm" -o plan.csv --json plan.json
  calib plan robot.urdf --region region.json --model dh --count 40 -o plan.csv
  calib plan robot.urdf --taken measured.csv --count 5 --validation 0 -o next.csv

Drive the poses from top to bottom, write what was measured into the empty columns, and give the table to calib fit.
Rows that stay empty are left out there.
""")
def plan(
    robot: RobotFile,
    setup: PlanOptions,
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
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NOISE",
            help='Of one measured coordinate, "0.05 mm", or "15 um + 6 um/m" by the distance. Default: a laser '
            "tracker's.",
        ),
    ] = None,
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
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import check_outputs, parse_amount, parse_columns, read_cell
    from calib.cli.surroundings_words import add_surroundings, parse_start
    from calib.cli.terminal import stages_bar
    from calib.data.table import Table
    from calib.design.plan import plan as make_plan
    from calib.design.plan_file import plan_table, read_taken, write_plan
    from calib.design.region import RegionFile
    from calib.result.calibration_file import write_table
    from calib.robot.robot import Robot
    from calib.text.plan import next_text, notes_of, plan_text

    inputs: list[str | Path] = [robot, *(path for path in (setup.cell, region, taken) if path)]
    check_outputs([output, json, view], inputs, force=force)
    rungs, gap = parse_ladder(ladder), parse_amount(margin, "--margin", "an angle", "5 deg")
    clear = parse_amount(clearance, "--clearance", "a length", "1 mm")
    if clear > _LARGEST_CLEARANCE:
        raise CalibError(
            f'--clearance was given as "{clearance}"; it must be {1e3 * _LARGEST_CLEARANCE:g} mm or less, for links of '
            "an arm pass each other closer than that. To keep more distance to a box make the box larger."
        )
    cell = add_surroundings(
        read_cell(**asdict(setup)),
        tracker=tracker,
        reflector=reflector,
        boxes=boxes or (),
        ranges=ranges or (),
        noise=noise,
    )
    renamed = parse_columns(columns or [])
    if renamed and taken is None:
        raise CalibError(
            "--columns renames the columns of a table of poses taken; name it with --taken."
        )
    names = None if taken is None else Table.read(taken).names(renamed)
    arm = Robot.load(robot, cell.base, cell.tip, measured=names, held=cell.held)
    place = None if region is None else RegionFile.read(region)
    fitting = next(iter(cell.targets.values()), cell.target)
    remarks = () if place is None else place.check_fits(arm, fitting)
    before = None if taken is None else read_taken(taken, arm, renamed)
    with stages_bar(quiet=quiet) as progress:
        made = make_plan(
            arm,
            cell,
            count=count,
            validation=validation,
            criterion=criterion,
            candidates=candidates,
            region=None if place is None else place.region,
            margin=gap,
            taken=None if before is None else before.joints,
            collisions=collisions,
            clearance=clear,
            floor=floor,
            holder_radius=parse_amount(holder, "--holder", "a length", "20 mm"),
            package_dirs=package_dir or (),
            ladder=rungs,
            start=parse_start(start or [], arm),
            seed=seed,
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
        said = (*notes_of(made, before, taken), *remarks)
        written = [f"Written: {path}" for path in (output, json, view) if path is not None]
        following = next_text(made, robot, output, taken, asdict(setup))
        typer.echo("\n".join([plan_text(made, cell.model, said), "", *written, following]))


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
