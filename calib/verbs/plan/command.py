"""``calib plan``: a robot in, the poses to measure out, and the accuracy to expect, of a tracker or of a camera."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.options import Force, ModelOptions, Quiet, RobotFile, Seed
from calib.cli.outputs import check_outputs, written_lines
from calib.cli.setup import load, read_cell
from calib.cli.terminal import stages_bar
from calib.cli.verb import verb
from calib.cli.words import parse_held, parse_tracker
from calib.errors import CalibError
from calib.verbs.plan.image_command import ImageOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calib.basics.arrays import Array
    from calib.data.cell import Cell
    from calib.robot.robot import Robot
    from calib.verbs.plan.choice import PlanRequest
    from calib.verbs.plan.collision import CollisionCheck
    from calib.verbs.plan.plan import Plan
    from calib.verbs.workspace.region import Region

_File = Path | None


@dataclass(frozen=True, slots=True)
class PoseOptions:
    """Poses that are wanted."""

    count: Annotated[int, typer.Option(metavar="N", help="Poses to calibrate with.")] = 30
    validation: Annotated[int, typer.Option(metavar="N", help="Random validation poses.")] = 5
    criterion: Annotated[str, typer.Option(metavar="V|D|A", help="Optimality criterion.")] = "V"
    candidates: Annotated[
        int | None,
        typer.Option(metavar="N", help="Poses to choose from. Default: 20000, of images 600."),
    ] = None
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
  calib plan robot.urdf --camera-on tool0 --camera 1280x720 --camera-at "0 60 30 mm"
    --board-on base_link --board board.toml --board-at "500 0 0 mm 180 0 0 deg" -o images.csv

Put boxes, reflector, noise and joint ranges into the cell file. Drive the poses from top to bottom, write what was
measured into the empty columns, and give the table to calib calibrate, which leaves out rows that stay empty. With
--camera images of a printed board are planned: save each under the name in the table, for calib detect.
""")
def plan(
    robot: RobotFile,
    setup: ModelOptions,
    poses: PoseOptions,
    images: ImageOptions,
    scene: SceneOptions,
    outputs: PlanOutputs,
    quiet: Quiet = False,
) -> None:
    """Run the verb; its help is the text of `verb`."""
    files = (outputs.output, outputs.json, outputs.view)
    inputs = [robot, setup.cell, scene.region, poses.taken]
    check_outputs(files, inputs, force=outputs.force)
    cell = read_cell(**asdict(setup))
    cell = replace(cell, tracker=parse_tracker(scene.tracker, cell.tracker))
    collisions = _collision_check(scene)
    arm = _load_chain(robot, cell, poses.taken)
    taken, first_row = _read_taken(arm, poses.taken, of_images=bool(cell.cameras))
    request = _request(arm, poses, of_images=bool(cell.cameras))
    with stages_bar(quiet=quiet) as progress:
        shared = {"taken": taken, "collisions": collisions, "progress": progress}
        if cell.cameras:
            planned = _plan_images(arm, cell, images, request, scene, shared)
        else:
            planned = _plan(arm, cell, request, scene, shared)
    _write(planned, outputs, first_row)
    if not quiet:
        from calib.verbs.plan.text import plan_text

        typer.echo("\n".join([plan_text(planned), "", *written_lines(*files)]))


def _load_chain(robot: str, cell: Cell, taken: Path | None) -> Robot:
    """Load the robot; without a tip the chain is that of the joints in the table of poses already measured."""
    from calib.basics.tables import Table
    from calib.data.columns import column_names

    joints = None if taken is None else column_names(Table.read(taken))
    return load(robot, cell, joints)


def _request(arm: Robot, options: PoseOptions, *, of_images: bool) -> PlanRequest:
    """Return the request for the poses that are wanted."""
    from calib.basics.units import ANGLE, parse_amount
    from calib.verbs.compensate.inverse import start_values
    from calib.verbs.plan.choice import PlanRequest
    from calib.verbs.plan.images.plan import CANDIDATES

    usual = CANDIDATES if of_images else PlanRequest().candidates
    request = PlanRequest(
        options.count,
        options.validation,
        options.criterion,
        usual if options.candidates is None else options.candidates,
        parse_amount(options.margin, "--margin", ANGLE, "5 deg"),
        seed=options.seed,
    )
    if not options.start:
        return request
    return replace(request, start=start_values(arm, parse_held(options.start, "--start"), 0.0))


def _collision_check(options: SceneOptions) -> CollisionCheck | None:
    """Return what is checked for collisions; None: nothing."""
    from calib.basics.units import LENGTH, parse_amount
    from calib.verbs.plan.collision import CollisionCheck

    clearance = parse_amount(options.clearance, "--clearance", LENGTH, "1 mm")
    folders = tuple(options.package_dir or ())
    check = CollisionCheck(clearance, options.floor, package_dirs=folders)
    return check if options.collisions else None


def _read_region(arm: Robot, cell: Cell, path: Path | None) -> Region | None:
    """Read the region for the (first) target; None without one."""
    from calib.verbs.workspace.region_file import read_region

    if path is None:
        return None
    target = next(iter(cell.targets.values()), cell.target)
    return read_region(path, arm, target)


def _read_taken(arm: Robot, path: Path | None, *, of_images: bool) -> tuple[Array | None, int]:
    """Read the poses that are measured already.

    Returns:
        Their joint values, None without a table; and the number of the plan's first row, or image, behind theirs.
    """
    from calib.verbs.plan.images.plan_file import next_number
    from calib.verbs.plan.plan_file import read_poses

    if path is None:
        return None, 1
    measured = read_poses(path, arm, taken=True)
    first_row = next_number(path) if of_images else max(measured.last_row, 0) + 1
    return measured.joints, first_row


def _plan(
    arm: Robot, cell: Cell, request: PlanRequest, scene: SceneOptions, shared: Mapping[str, Any]
) -> Plan:
    """Plan the poses of an instrument, with the arguments that images are planned with, too."""
    from calib.verbs.plan.plan import plan as plan_poses

    region = _read_region(arm, cell, scene.region)
    return plan_poses(arm, cell, request, region=region, **shared)


def _plan_images(
    arm: Robot,
    cell: Cell,
    images: ImageOptions,
    request: PlanRequest,
    scene: SceneOptions,
    shared: Mapping[str, Any],
) -> Plan:
    """Plan images of a board."""
    from calib.verbs.plan.images.plan import plan_images
    from calib.verbs.plan.reaching import reach

    if scene.region is not None:
        raise CalibError("--region is for targets; where the board is seen is said by --board-at.")
    wanted = replace(images.request(), poses=request)
    return plan_images(arm, cell, wanted, reach, **shared)


def _write(planned: Plan, outputs: PlanOutputs, first_row: int) -> None:
    """Write the files that were asked for."""
    from calib.result.calibration_file import write_table
    from calib.verbs.plan.images.plan_file import write_image_plan
    from calib.verbs.plan.plan_file import plan_table, write_plan

    if outputs.output is not None:
        write = write_plan if planned.sight is None else write_image_plan
        write(planned, outputs.output, overwrite=outputs.force, first_row=first_row)
    if outputs.json is not None:
        write_table(plan_table(planned), outputs.json, overwrite=outputs.force)
    if outputs.view is not None:
        from calib.verbs.plan.view import plan_page

        plan_page(planned, first_row=first_row).write(outputs.view, overwrite=outputs.force)
