"""``calib simulate``: a table of a robot whose errors are known, and the truth beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.loading import load
from calib.cli.options import ColumnChoice, Force, ModelOptions, Quiet, RobotFile
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import moving_bar, progress_bar
from calib.cli.verb import verb
from calib.errors import CalibError
from calib.verbs.simulate.scenario_words import ScenarioWords

if TYPE_CHECKING:
    from calib.basics.arrays import Array

_File = Path | None


@dataclass(frozen=True, slots=True)
class PoseOptions(ColumnChoice):
    """Poses of a table, and the seed of all random numbers."""

    poses: Annotated[_File, typer.Option(help="Plan or table whose poses are simulated.")] = None
    count: Annotated[
        int, typer.Option(min=1, metavar="N", help="Number of random poses to calibrate with.")
    ] = 30
    validation: Annotated[
        int | None,
        typer.Option(
            min=0, help="Number of random poses for validation. Default: 10, or 0 with --poses."
        ),
    ] = None
    seed: Annotated[
        int,
        typer.Option(min=0, help="Seed of all random numbers; the same seed gives the same files."),
    ] = 0


@verb("""Simulate measurements of a robot whose errors are known.

\b
Examples:
  calib simulate ur3 --base base --tip tool0 -o table.csv
  calib simulate robot.urdf --poses plan.csv --seed 2 -o table.csv --truth truth.json
  calib simulate robot.urdf --count 50 --validation 20 --frame estimate -o table.csv
  calib simulate robot.urdf --error "elbow_joint.rx=2 mrad" --noise none -o table.csv
  calib simulate robot.urdf --tip left=hand_l --tip right=hand_r --frame estimate -o hands.csv
  calib simulate ur5 --kind pixel --camera-on tool0 --board-on base_link --images pictures -o corners.csv

It writes a table for calib calibrate, and next to it the truth: the robot's errors, targets, frames, and what was
disturbed in which row. The same seed gives the same files. --model is the error model of the simulated robot, placement
by default; --target is the nominal position of the target, 50 50 50 mm by default. The cell file's table [simulation]
has encoder resolution, drift, a moved target and more.

For the kind pixel it places a camera and a printed board, usual ones or those of --camera and --board, and takes
pictures at poses from which the whole board is seen; --images draws them, for calib detect.
""")
def simulate(
    robot: RobotFile,
    cell_options: ModelOptions,
    errors: ScenarioWords,
    poses: PoseOptions,
    output: Annotated[_File, typer.Option("-o", "--output", help="Write the table.")] = None,
    truth: Annotated[
        _File,
        typer.Option(
            help="Write the truth to this file. Default: TABLE_truth.json, next to the table."
        ),
    ] = None,
    truth_urdf: Annotated[
        _File, typer.Option(help="Write the URDF of the true robot to this file.")
    ] = None,
    images: Annotated[
        _File,
        typer.Option(
            metavar="FOLDER",
            help="With --kind pixel: draw the pictures into this folder, with joints.csv, board.toml and camera.yaml.",
        ),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Read robot and scenario, simulate, write pictures, table, truth and URDF, and print what was simulated.

    It raises `CalibError` if neither a table nor a folder of pictures is named, or a file may not be written.
    """
    from calib.data.cell_chains import check_arm_is_named
    from calib.verbs.plan.plan_file import read_poses
    from calib.verbs.simulate.picture_files import write_pictures
    from calib.verbs.simulate.scenario import simulate as simulate_rows, with_robots_placed
    from calib.verbs.simulate.scenario_words import read_scenario
    from calib.verbs.simulate.text import simulated_text
    from calib.verbs.simulate.truth_file import write_truth

    # The truth goes next to the table, or among the pictures, unless its file is named.
    if output is None and images is None:
        raise CalibError("Name the table to write: -o table.csv.")
    if truth is None and output is not None:
        truth = output.with_name(f"{output.stem}_truth.json")
    elif truth is None and images is not None:
        truth = images / "truth.json"
    assert truth is not None
    files = [output, truth, truth_urdf]
    if images is not None and not images.is_dir():  # its files cannot exist yet
        files = [path for path in files if path is None or path.parent != images]
    inputs = [robot, poses.poses, cell_options.file, errors.truth_robot]
    check_outputs(files, inputs, force=force)
    cell = with_robots_placed(cell_options.cell())
    arm = load(robot, cell)
    check_arm_is_named(arm, cell)
    scenario = read_scenario(arm, cell, cell_options.file, errors)
    if images is not None and not scenario.kind.is_image:
        raise CalibError(
            "--images draws what a camera sees of a printed board: add --kind pixel, with --camera-on and --board-on."
        )
    joints: Array | None = None
    moves: Array | None = None
    sets: tuple[str, ...] = ()
    validation = 10
    if poses.poses is not None:
        table = read_poses(poses.poses, arm, poses.parsed())
        joints, sets, moves, validation = table.joints, table.sets, table.moves, 0
    if poses.validation is not None:
        validation = poses.validation
    with moving_bar("rows", quiet=quiet):
        simulated = simulate_rows(
            scenario, poses.count, validation, poses.seed, joints, sets, moves
        )

    written = []
    if images is not None:
        with progress_bar("pictures", quiet=quiet) as progress:
            drawn = write_pictures(simulated, images, overwrite=force, progress=progress)
        written += [path for path in drawn if path.suffix != ".png"]
    with moving_bar("writing", quiet=quiet):
        if output is not None:
            simulated.measurements.write(output, overwrite=force)
            written.append(output)
        written.append(write_truth(scenario, simulated, truth, overwrite=force))
        if truth_urdf is not None:
            written.append(simulated.truth.write_urdf(truth_urdf, overwrite=force))
    if not quiet:
        text = simulated_text(scenario, simulated)
        typer.echo("\n".join([f"{text}\n", *written_lines(*written)]))
