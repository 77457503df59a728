"""``calib plan``: a robot in, the poses to measure out, and the accuracy to expect, of a tracker or of a camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from calib.cli.loading import load
from calib.cli.options import CellOptions, Force, Quiet, RobotFile, Seed
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import stages_bar
from calib.cli.verb import verb
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from calib.basics.arrays import Array
    from calib.data.cell import Cell
    from calib.data.cell_chains import Sight
    from calib.instruments.camera import SightLimits
    from calib.robot.robot import Robot
    from calib.verbs.plan.choice import PlanRequest
    from calib.verbs.plan.collision import CollisionCheck

_File = Path | None

#: Stands for a pose in the help.
_POSE = '"X Y Z UNIT RX RY RZ UNIT"'


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
    approach: Annotated[
        str,
        typer.Option(
            metavar="straight|one|both",
            help="How to come to a pose. straight: from the pose before; one: with every joint rising; both: each "
            "pose is measured twice, with every joint rising and falling, which shows lost motion.",
        ),
    ] = "straight"
    seed: Seed = 0
    margin: Annotated[
        str, typer.Option(metavar="ANGLE", help="Margin kept from the joint limits.")
    ] = "5 deg"
    taken: Annotated[
        _File,
        typer.Option(help="Table of poses already measured, to which the plan adds others."),
    ] = None
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"JOINT=VALUE UNIT"',
            help="Joint value of the pose that the robot starts from; joints that are not named are at 0. Can be "
            "repeated.",
        ),
    ] = None

    def request(self, arm: Robot, sight: SightLimits) -> PlanRequest:
        """Return the request for the poses that are wanted; joints that ``--start`` does not name start at 0.

        It raises `CalibError` for a text that an option refuses.
        """
        from calib.basics.units import ANGLE, parse_amount, parse_joint_values
        from calib.verbs.compensate.inverse import start_values
        from calib.verbs.plan.choice import PlanRequest

        start = None
        if self.start:
            start = start_values(arm, parse_joint_values(self.start, "--start"), 0.0)
        return PlanRequest(
            self.count,
            self.validation,
            self.criterion,
            self.candidates,
            parse_amount(self.margin, "--margin", ANGLE, "5 deg"),
            start=start,
            approach=self.approach,
            seed=self.seed,
            sight=sight,
        )


@dataclass(frozen=True, slots=True)
class PlaceOptions:
    """The rough places of camera and board."""

    camera_at: Annotated[
        list[str] | None,
        typer.Option(
            metavar=f"[NAME=]{_POSE}",
            help="Approximate pose of the camera in its link, with a rotation vector; z is the line of sight, "
            "and y points "
            "down in the image. Of several cameras each by its name. Default: the link is the camera's optical frame.",
        ),
    ] = None
    board_at: Annotated[
        str | None,
        typer.Option(
            metavar=_POSE,
            help="Approximate pose of the board in its link, with a rotation vector; x points along its columns, z "
            "into the page.",
        ),
    ] = None

    def in_cell(self, cell: Cell) -> Cell:
        """Return a cell with its camera and board where the options say; raises `CalibError` for another text.

        A place that is not given stays as the cell has it, and a cell without a camera as it is.
        """
        from calib.basics.arrays import rigid_inverse

        for given in (self.camera_at or ()) if cell.cameras else ():
            name, _, pose = given.rpartition("=")
            T_camera_link = rigid_inverse(pose_of(pose, "--camera-at"))
            if name:
                known = choices([*cell.cameras, *cell.bases])
                if name not in (*cell.cameras, *cell.bases):
                    raise CalibError(
                        f"--camera-at {given}: there is no camera '{name}', only {known}."
                    )
                cell = replace(cell, frames={**cell.frames, name: T_camera_link})
            else:
                cell = replace(cell, T_frame_base=T_camera_link, frames={})
        if cell.cameras and self.board_at is not None:
            T = pose_of(self.board_at, "--board-at")
            cell = replace(cell, target=T[:3, 3], target_rotation=T[:3, :3], targets={})
        return cell


@dataclass(frozen=True, slots=True)
class ImageOptions(PlaceOptions):
    """Images of a printed board, and where camera and board roughly are."""

    distance: Annotated[
        str | None,
        typer.Option(
            metavar='"NEAREST FARTHEST UNIT"',
            help="Distances between which the camera is in focus. Default: those at which the board fills 15 to "
            "80 % of "
            "the image.",
        ),
    ] = None
    tilt: Annotated[
        str,
        typer.Option(
            metavar="ANGLE", help="Largest angle between the board's normal and the line of sight."
        ),
    ] = "55 deg"
    share: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            help="Share of the board's corners that each image must show, from 0 to 1.",
        ),
    ] = 1.0

    def limits(self) -> SightLimits:
        """Return at which distances [m] and tilts [rad], and where in the image, the board may be seen.

        Without distances they follow from the board's size in the image. A text that is refused raises `CalibError`.
        """
        from calib.basics.units import ANGLE, LENGTH, parse_amount, parse_quantities
        from calib.instruments.camera import SightLimits

        distances = None
        if self.distance is not None:
            example = "300 900 mm"
            near, far = parse_quantities(self.distance, "--distance", {LENGTH: 2}, example)[LENGTH]
            distances = float(near), float(far)
        return SightLimits(
            distances, parse_amount(self.tilt, "--tilt", ANGLE, "55 deg"), self.share
        )


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Region and obstacles."""

    region: Annotated[
        _File,
        typer.Option(help="Region in which the target must stay, as 'calib workspace' writes it."),
    ] = None
    clearance: Annotated[
        str,
        typer.Option(metavar="LENGTH", help="Smallest distance allowed between two bodies."),
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

    def check(self) -> CollisionCheck | None:
        """Return how collisions are checked, None if they are not; raises `CalibError` for another ``--clearance``."""
        from calib.basics.units import LENGTH, parse_amount
        from calib.verbs.plan.collision import CollisionCheck

        clearance = parse_amount(self.clearance, "--clearance", LENGTH, "1 mm")
        folders = tuple(self.package_dir or ())
        check = CollisionCheck(clearance, self.floor, package_dirs=folders)
        return check if self.collisions else None


@verb("""Plan the poses of a calibration: which to measure, in which order, and how accurate the robot will be.

\b
Examples:
  calib plan ur3 --base base --tip tool0 --target "70 -70 22.5 mm" -o plan.csv
  calib plan robot.urdf --cell cell.toml --tracker "2500 0 500 mm" -o plan.csv --json plan.json
  calib plan robot.urdf --region region.json --model dh --count 40 -o plan.csv
  calib plan robot.urdf --tip left=hand_l --tip right=hand_r --frame estimate -o plan.csv
  calib plan robot.urdf --taken measured.csv --count 5 --validation 0 -o next.csv
  calib plan robot.urdf --camera-on tool0 --camera 1280x720 --camera-at "0 60 30 mm"
    --board-on base_link --board board.toml --board-at "500 0 0 mm 180 0 0 deg" -o images.csv

Put boxes, reflector, noise and joint ranges into the cell file. Drive to the poses from top to bottom, enter the
measurements into the empty columns, and give the table to calib calibrate, which ignores rows that are still empty.
With --camera, images of a printed board are planned: save each under the name in the table, for calib detect.
""")
def plan(
    robot: RobotFile,
    *,
    cell_options: PlanCellOptions,
    poses: PoseOptions,
    images: ImageOptions,
    scene: SceneOptions,
    output: Annotated[
        _File, typer.Option("-o", "--output", help="Write the plan as a table of poses.")
    ] = None,
    json: Annotated[_File, typer.Option(help="Write the plan and the forecast as JSON.")] = None,
    view: Annotated[
        _File, typer.Option(help="Write a page that shows the plan in 3D, to open in a browser.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Load robot and cell, whose boxes are the obstacles, plan the poses, write the files named, and print the plan."""
    from calib.basics.tables import Table
    from calib.data.cell_chains import check_arm_is_named
    from calib.data.columns import column_names
    from calib.result.calibration_file import write_table
    from calib.verbs.plan.plan import plan as plan_poses
    from calib.verbs.plan.plan_file import next_number, plan_table, read_poses, write_plan
    from calib.verbs.plan.reachable import refuse_region
    from calib.verbs.plan.sensitivity import views_of
    from calib.verbs.plan.text import plan_text
    from calib.verbs.workspace.region_file import read_region

    files = (output, json, view)
    check_outputs(files, [robot, cell_options.file, scene.region, poses.taken], force=force)
    cell = images.in_cell(cell_options.cell())
    # Without a tip the chain is that of the joints in the table of poses already measured.
    joints = None if poses.taken is None else column_names(Table.read(poses.taken))
    arm = load(robot, cell, joints)
    if joints is None:
        check_arm_is_named(arm, cell)
    request = poses.request(arm, images.limits())
    views, _, _ = views_of(arm, cell, request.sight)
    instrument = views[0].instrument
    if view is not None and len(views) > 1:
        raise CalibError(
            "--view shows a plan for one hand, and this one is for several. Leave it out: 'calib view' shows the table "
            "once it is measured and fitted."
        )
    region = None
    if scene.region is not None:
        refuse_region(instrument)
        target = next(iter(cell.targets.values()), cell.target)
        region = read_region(scene.region, arm, target)
    taken: Array | None = None
    taken_moves: Array | None = None
    taken_sights: Sequence[Collection[Sight]] | None = None
    first_row = 1
    if poses.taken is not None:
        measured = read_poses(poses.taken, arm, taken=True)
        taken, taken_moves, taken_sights = measured.joints, measured.moves, measured.sights
        first_row = next_number(instrument, measured)
    with stages_bar(quiet=quiet) as progress:
        planned = plan_poses(
            arm,
            cell,
            request,
            region=region,
            taken=taken,
            taken_moves=taken_moves,
            taken_sights=taken_sights,
            collisions=scene.check(),
            progress=progress,
        )
    if output is not None:
        write_plan(planned, output, overwrite=force, first_row=first_row)
    if json is not None:
        write_table(plan_table(planned), json, overwrite=force)
    if view is not None:
        from calib.verbs.plan.plan_page import plan_page  # with meshcat

        plan_page(planned, first_row=first_row).write(view, overwrite=force)
    if not quiet:
        typer.echo("\n".join([plan_text(planned, first_row), "", *written_lines(*files)]))


def pose_of(text: str, option: str) -> Array:
    """Parse a pose, a position with or without a rotation vector.

    Args:
        text: As typed, such as ``0 0 100 mm 0 0 90 deg``.
        option: The option that it was given with, for messages.

    Returns:
        The pose, shape (4, 4), [m]; without a rotation its axes are those of the frame that it is in.

    Raises:
        CalibError: It is another text.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from calib.basics.units import ANGLE, LENGTH, parse_quantities

    example = "0 0 100 mm 0 0 90 deg"
    values = parse_quantities(text, option, {LENGTH: 3, ANGLE: 3}, example)
    T = np.eye(4)
    T[:3, 3] = values.get(LENGTH, [0.0, 0.0, 0.0])
    T[:3, :3] = Rotation.from_rotvec(values.get(ANGLE, [0.0, 0.0, 0.0])).as_matrix()
    return T
