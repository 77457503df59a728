"""``calib plan``: a robot in, the poses to measure out, and the accuracy to expect."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import Force, ModelOptions, Quiet, RobotFile, Seed
from calib.cli.outputs import check_outputs, written_lines
from calib.cli.setup import load, read_cell
from calib.cli.terminal import stages_bar
from calib.cli.verb import verb
from calib.cli.words import parse_held, parse_tracker

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.design.choice import PlanRequest
    from calib.design.collision import CollisionCheck
    from calib.design.plan import PlanValues
    from calib.regions.region import Region
    from calib.robot.robot import Robot

_File = Path | None


@dataclass(frozen=True, slots=True)
class PoseOptions:
    """Poses that are wanted."""

    count: Annotated[int, typer.Option(metavar="N", help="Poses to calibrate with.")] = 30
    validation: Annotated[int, typer.Option(metavar="N", help="Random validation poses.")] = 5
    criterion: Annotated[str, typer.Option(metavar="V|D|A", help="Optimality criterion.")] = "V"
    candidates: Annotated[int, typer.Option(metavar="N", help="Poses to choose from.")] = 20_000
    seed: Seed = 0
    margin: Annotated[str, typer.Option(metavar="ANGLE", help="Margin to joint limits.")] = "5 deg"
    taken: Annotated[_File, typer.Option(help="Table of poses measured already, to add to.")] = None
    start: Annotated[
        list[str] | None,
        typer.Option(metavar='"JOINT=VALUE UNIT"', help="Start pose; other joints are at 0."),
    ] = None


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Tracker, region and obstacles."""

    tracker: Annotated[
        str | None,
        typer.Option(metavar='"X Y Z UNIT"', help="Position of the tracker, in the base."),
    ] = None
    region: Annotated[_File, typer.Option(help="Region for the target, of calib workspace.")] = None
    clearance: Annotated[str, typer.Option(metavar="LENGTH", help="Least distance of bodies.")] = (
        "0 mm"
    )
    collisions: Annotated[bool, typer.Option(help="Check poses and moves for collisions.")] = True
    floor: Annotated[bool, typer.Option(help="Keep above the robot's mounting plane.")] = True
    package_dir: Annotated[
        list[Path] | None,
        typer.Option(metavar="FOLDER", help="Folder with packages of meshes."),
    ] = None


@dataclass(frozen=True, slots=True)
class PlanOutputs:
    """Files that are written."""

    output: Annotated[_File, typer.Option("-o", "--output", help="Table of poses.")] = None
    json: Annotated[_File, typer.Option(help="Plan and forecast as JSON.")] = None
    view: Annotated[_File, typer.Option(help="3D page of the plan.")] = None
    force: Force = False


@verb("""Plan the poses of a calibration: which to measure, in which order, and how accurate the robot will be.

\b
Examples:
  calib plan ur3 --base base --tip tool0 --target "70 -70 22.5 mm" -o plan.csv
  calib plan robot.urdf --cell cell.toml --tracker "2500 0 500 mm" -o plan.csv --json plan.json
  calib plan robot.urdf --region region.json --model dh --count 40 -o plan.csv
  calib plan robot.urdf --taken measured.csv --count 5 --validation 0 -o next.csv

Put boxes, reflector, noise and joint ranges into the cell file. Drive the poses from top to bottom, write what was
measured into the empty columns, and give the table to calib calibrate, which leaves out rows that stay empty.
""")
def plan(
    robot: RobotFile,
    setup: ModelOptions,
    poses: PoseOptions,
    scene: SceneOptions,
    outputs: PlanOutputs,
    quiet: Quiet = False,
) -> None:
    """Run the verb; its help is the text of `verb`."""
    files = (outputs.output, outputs.json, outputs.view)
    check_outputs(files, [robot, setup.cell, scene.region, poses.taken], force=outputs.force)
    cell = read_cell(**asdict(setup))
    cell = replace(cell, tracker=parse_tracker(scene.tracker, cell.tracker))
    collisions = _collision_check(scene)
    arm = _load_chain(robot, cell, poses.taken)
    request = _request(arm, poses)
    planned, first_row = _plan(arm, cell, request, poses, scene, collisions, quiet=quiet)
    _write(planned, outputs, first_row)
    if not quiet:
        from calib.text.plan import plan_text

        typer.echo("\n".join([plan_text(planned), "", *written_lines(*files)]))


def _load_chain(robot: str, cell: Cell, taken: Path | None) -> Robot:
    """Load the robot; without a tip the chain is that of the joints in the table of poses already measured."""
    from calib.data.columns import column_names
    from calib.tables.table import Table

    joints = None if taken is None else column_names(Table.read(taken))
    return load(robot, cell, joints)


def _request(arm: Robot, options: PoseOptions) -> PlanRequest:
    """Return the request for the poses that are wanted."""
    from calib.compensation.inverse import start_values
    from calib.design.choice import PlanRequest
    from calib.units import ANGLE, parse_amount

    request = PlanRequest(
        options.count,
        options.validation,
        options.criterion,
        options.candidates,
        parse_amount(options.margin, "--margin", ANGLE, "5 deg"),
        seed=options.seed,
    )
    if not options.start:
        return request
    return replace(request, start=start_values(arm, parse_held(options.start, "--start"), 0.0))


def _collision_check(options: SceneOptions) -> CollisionCheck | None:
    """Return what is checked for collisions; None: nothing."""
    from calib.design.collision import CollisionCheck
    from calib.units import LENGTH, parse_amount

    clearance = parse_amount(options.clearance, "--clearance", LENGTH, "1 mm")
    folders = tuple(options.package_dir or ())
    check = CollisionCheck(clearance, options.floor, package_dirs=folders)
    return check if options.collisions else None


def _read_region(arm: Robot, cell: Cell, path: Path | None) -> Region | None:
    """Read the region for the (first) target; None without one."""
    from calib.regions.region_file import read_region

    if path is None:
        return None
    target = next(iter(cell.targets.values()), cell.target)
    return read_region(path, arm, target)


def _plan(
    arm: Robot,
    cell: Cell,
    request: PlanRequest,
    poses: PoseOptions,
    scene: SceneOptions,
    collisions: CollisionCheck | None,
    *,
    quiet: bool,
) -> tuple[PlanValues, int]:
    """Plan the poses.

    Returns:
        The plan, and the number of its first row: rows go on behind those already measured.
    """
    from calib.design.plan import plan as plan_poses
    from calib.design.plan_file import read_poses

    region = _read_region(arm, cell, scene.region)
    taken, first_row = None, 1
    if poses.taken is not None:
        measured = read_poses(poses.taken, arm, taken=True)
        taken = measured.joints
        first_row = max(measured.last_row, 0) + 1
    with stages_bar(quiet=quiet) as progress:
        planned = plan_poses(
            arm,
            cell,
            request,
            region=region,
            taken=taken,
            collisions=collisions,
            progress=progress,
        )
    return planned, first_row


def _write(planned: PlanValues, outputs: PlanOutputs, first_row: int) -> None:
    """Write the files that were asked for."""
    from calib.design.plan_file import plan_table, write_plan
    from calib.result.calibration_file import write_table

    if outputs.output is not None:
        write_plan(planned, outputs.output, overwrite=outputs.force, first_row=first_row)
    if outputs.json is not None:
        write_table(plan_table(planned), outputs.json, overwrite=outputs.force)
    if outputs.view is not None:
        from calib.viewer.design_view import plan_page

        plan_page(planned, first_row=first_row).write(outputs.view, overwrite=outputs.force)
