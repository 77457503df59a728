"""``calib plan``: a robot in, the poses to measure out, and the accuracy to expect; images and touches of a board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from calib.cli.loading import load
from calib.cli.notices import say_accepted
from calib.cli.options import Accept, CellOptions, Force, Quiet, RobotFile, Seed
from calib.cli.outputs import check_outputs, written_lines
from calib.cli.terminal import stages_bar
from calib.cli.verb import verb
from calib.errors import CalibError, VerdictError
from calib.verbs.plan.image_command import ImageOptions, board_of

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
class PlanCellOptions(CellOptions):
    """Options of the cell, with those of the errors of the robot and of the tracker."""

    groups: ClassVar[tuple[str, ...]] = ("model", "tracker")


@dataclass(frozen=True, slots=True)
class PoseOptions:
    """Poses that are wanted."""

    count: Annotated[int, typer.Option(metavar="N", help="Number of poses to calibrate with.")] = 30
    validation: Annotated[
        int, typer.Option(metavar="N", help="Number of random poses for validation.")
    ] = 5
    criterion: Annotated[
        str,
        typer.Option(
            metavar="V|D|A",
            help="Optimality criterion. V: the predicted errors of position in the workspace; D: the volume of the "
            "parameters' covariance; A: the sum of the parameters' variances.",
        ),
    ] = "V"
    candidates: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Number of random poses to choose from. Default: 20000, or 600 for images.",
        ),
    ] = None
    seed: Seed = 0
    margin: Annotated[
        str, typer.Option(metavar="ANGLE", help="Margin that is kept to the limits of the joints.")
    ] = "5 deg"
    taken: Annotated[
        _File,
        typer.Option(help="Table of poses that were measured already and that the plan adds to."),
    ] = None
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"JOINT=VALUE UNIT"',
            help="Joint value of the pose that the robot starts from; joints that are not named are at 0. Can be "
            "repeated.",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Region and obstacles."""

    region: Annotated[
        _File,
        typer.Option(help="Region that the target is to stay in, as 'calib workspace' writes it."),
    ] = None
    clearance: Annotated[
        str,
        typer.Option(metavar="LENGTH", help="Smallest distance that is kept between two bodies."),
    ] = "0 mm"
    collisions: Annotated[
        bool, typer.Option(help="Check poses and the moves between them for collisions.")
    ] = True
    floor: Annotated[bool, typer.Option(help="Keep the robot above its mounting plane.")] = True
    package_dir: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOLDER", help="Folder with the ROS packages of the meshes. Can be repeated."
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class PlanOutputs:
    """Files that are written."""

    output: Annotated[
        _File, typer.Option("-o", "--output", help="Write the plan as a table of poses.")
    ] = None
    json: Annotated[_File, typer.Option(help="Write the plan and the forecast as JSON.")] = None
    view: Annotated[
        _File, typer.Option(help="Write a page that shows the plan in 3D, to open in a browser.")
    ] = None
    force: Force = False
    accept: Accept = False


@verb("""Plan the poses of a calibration: which to measure, in which order, and how accurate the robot will be.

\b
Examples:
  calib plan ur3 --base base --tip tool0 --target "70 -70 22.5 mm" -o plan.csv
  calib plan robot.urdf --cell cell.toml --tracker "2500 0 500 mm" -o plan.csv --json plan.json
  calib plan robot.urdf --region region.json --model dh --count 40 -o plan.csv
  calib plan robot.urdf --taken measured.csv --count 5 --validation 0 -o next.csv
  calib plan robot.urdf --camera-on tool0 --camera 1280x720 --camera-at "0 60 30 mm"
    --board-on base_link --board board.toml --board-at "500 0 0 mm 180 0 0 deg" -o images.csv
  calib plan robot.urdf --touch result.json --pointer "0 0 120 mm" -o touch.csv

Put boxes, reflector, noise and joint ranges into the cell file. Drive the poses from top to bottom, write what was
measured into the empty columns, and give the table to calib calibrate, which leaves out rows that stay empty. With
--camera images of a printed board are planned: save each under the name in the table, for calib detect. With --touch
a calibration is checked: drive a pointer to corners of the board.
""")
def plan(
    robot: RobotFile,
    cell_options: PlanCellOptions,
    pose_options: PoseOptions,
    image_options: ImageOptions,
    scene_options: SceneOptions,
    outputs: PlanOutputs,
    quiet: Quiet = False,
) -> None:
    """Plan poses, images or touches, write the files and print the plan."""
    files = (outputs.output, outputs.json, outputs.view)
    inputs = [
        robot,
        cell_options.file,
        scene_options.region,
        pose_options.taken,
        image_options.touch,
    ]
    check_outputs(files, inputs, force=outputs.force)
    cell = cell_options.cell()
    if image_options.touch is not None:
        _touch(robot, cell, image_options, scene_options, outputs, quiet=quiet)
        return
    collisions = _collision_check(scene_options)
    arm = _load_chain(robot, cell, pose_options.taken)
    taken, first_row = _read_taken(arm, pose_options.taken, of_images=bool(cell.cameras))
    request = _request(arm, pose_options, of_images=bool(cell.cameras))
    with stages_bar(quiet=quiet) as progress:
        shared = {"taken": taken, "collisions": collisions, "progress": progress}
        if cell.cameras:
            planned = _plan_images(arm, cell, image_options, request, scene_options, shared)
        else:
            planned = _plan(arm, cell, request, scene_options, shared)
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
    from calib.basics.units import ANGLE, parse_amount, parse_joint_values
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
    return replace(
        request, start=start_values(arm, parse_joint_values(options.start, "--start"), 0.0)
    )


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
    arm: Robot,
    cell: Cell,
    request: PlanRequest,
    scene_options: SceneOptions,
    shared: Mapping[str, Any],
) -> Plan:
    """Plan the poses of an instrument, with the arguments that images are planned with, too."""
    from calib.verbs.plan.plan import plan as plan_poses

    region = _read_region(arm, cell, scene_options.region)
    return plan_poses(arm, cell, request, region=region, **shared)


def _plan_images(
    arm: Robot,
    cell: Cell,
    image_options: ImageOptions,
    request: PlanRequest,
    scene_options: SceneOptions,
    shared: Mapping[str, Any],
) -> Plan:
    """Plan images of a board."""
    from calib.verbs.plan.images.plan import plan_images
    from calib.verbs.plan.reaching import reach

    if scene_options.region is not None:
        raise CalibError("--region is for targets; where the board is seen is said by --board-at.")
    wanted = replace(image_options.request(), poses=request)
    return plan_images(arm, cell, wanted, reach, **shared)


def _touch(
    robot: str,
    cell: Cell,
    image_options: ImageOptions,
    scene_options: SceneOptions,
    outputs: PlanOutputs,
    *,
    quiet: bool,
) -> None:
    """Plan to touch corners of a calibrated board."""
    from calib.result.calibration_file import read_result
    from calib.show.verdict import against, refusal
    from calib.verbs.plan.touch import plan_touch
    from calib.verbs.plan.touch_file import write_touch
    from calib.verbs.plan.touch_text import no_touch_text, touch_text

    assert image_options.touch is not None
    if outputs.json is not None or outputs.view is not None:
        raise CalibError("--touch writes a table (-o), no --json and no --view.")
    result = read_result(image_options.touch)
    stated = against(result.verdict)
    if stated and not outputs.accept:
        raise VerdictError(refusal(f"'{image_options.touch}'", stated))
    load(robot, replace(cell, base=result.nominal.base, tip=result.nominal.tip))
    touches = plan_touch(
        result,
        board_of(cell, result.optics.nominal_boards),
        image_options.tool(),
        image_options.ids(),
        collisions=_collision_check(scene_options),
    )
    if not touches.usable.any():
        raise CalibError(no_touch_text(touches))
    if outputs.output is not None:
        write_touch(touches, outputs.output, overwrite=outputs.force)
    if not quiet:
        typer.echo("\n".join([touch_text(touches), "", *written_lines(outputs.output)]))
    say_accepted(f"'{image_options.touch}'", stated)


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
