"""``calib simulate``: a table of a robot whose errors are known, and the truth beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.loading import load
from calib.cli.options import ColumnChoice, Force, ModelOptions, Quiet, RobotFile
from calib.cli.output_files import check_outputs, written_lines
from calib.cli.terminal import moving_bar, progress_bar, work_line
from calib.cli.verb import verb
from calib.errors import CalibError
from calib.verbs.simulate.scenario_words import ScenarioWords

if TYPE_CHECKING:
    from calib.basics.arrays import Array

_File = Path | None

#: The most stops of a session.
MOST_STOPS = 120


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


@dataclass(frozen=True, slots=True)
class SessionOptions:
    """A session with a virtual operator, in place of a table."""

    session: Annotated[
        _File,
        typer.Option(
            metavar="FOLDER",
            help="Measure pose by pose, as 'calib measure' proposes them, into this new folder.",
        ),
    ] = None
    mistakes: Annotated[
        bool, typer.Option("--mistakes", help="With --session: the operator makes mistakes.")
    ] = False
    aim: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help='With --session: the error that shall hold with 95 %, such as "0.15 mm". Default: as good as --count '
            "random poses.",
        ),
    ] = None

    def check(self) -> None:
        """Refuse options of a session without one: `CalibError`."""
        if self.session is None and (self.mistakes or self.aim is not None):
            raise CalibError("--mistakes and --aim belong to a session: add --session FOLDER.")


@verb("""Simulate measurements of a robot whose errors are known.

\b
Examples:
  calib simulate ur3 --base base --tip tool0 -o table.csv
  calib simulate robot.urdf --poses plan.csv --seed 2 -o table.csv --truth truth.json
  calib simulate robot.urdf --count 50 --validation 20 --frame estimate -o table.csv
  calib simulate robot.urdf --error "elbow_joint.rx=2 mrad" --noise none -o table.csv
  calib simulate robot.urdf --tip left=hand_l --tip right=hand_r --frame estimate -o hands.csv
  calib simulate ur5 --kind pixel --camera-on tool0 --board-on base_link --images pictures -o corners.csv
  calib simulate ur3 --base base --tip tool0 --frame estimate --session rehearsal --mistakes

It writes a table for calib calibrate, and next to it the truth: the robot's errors, targets, frames, and what was
disturbed in which row. The same seed gives the same files. --model is the error model of the simulated robot, placement
by default; --target is the nominal position of the target, 50 50 50 mm by default. The cell file's table [simulation]
has encoder resolution, drift, a moved target and more.

For the kind pixel it places a camera and a printed board, usual ones or those of --camera and --board, and takes
pictures at poses from which the whole board is seen; --images draws them, for calib detect.

With --session a virtual operator measures a session of calib measure, pose by pose until the aim is reached, and the
robot is calibrated; --mistakes: one reading in six is wrong.
""")
def simulate(
    robot: RobotFile,
    cell_options: ModelOptions,
    errors: ScenarioWords,
    poses: PoseOptions,
    session: SessionOptions,
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

    session.check()
    if session.session is not None:
        named = [output, images, truth_urdf, poses.poses]
        if any(path is not None for path in named) or poses.validation is not None:
            raise CalibError(
                "--session chooses its poses, and writes its table into its folder; leave out -o, --images, "
                "--truth-urdf, --poses and --validation."
            )
        _simulate_session(
            robot,
            cell_options,
            errors,
            session,
            poses.count,
            poses.seed,
            truth,
            force=force,
            quiet=quiet,
        )
        return
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


def _simulate_session(
    robot: str,
    cell_options: ModelOptions,
    errors: ScenarioWords,
    options: SessionOptions,
    count: int,
    seed: int,
    truth: Path | None,
    *,
    force: bool,
    quiet: bool,
) -> None:
    """Measure a session with a virtual operator, calibrate, write the truth beside its folder, and print all of it.

    Without an aim it is that of so many random poses.
    """
    from calib.basics.units import LENGTH, parse_amount
    from calib.data.cell_chains import check_arm_is_named
    from calib.numerics.errors import rms
    from calib.verbs.measure.aim import Aim
    from calib.verbs.measure.session import Session
    from calib.verbs.simulate.operator import NO_MISTAKES, USUAL_MISTAKES, Operator
    from calib.verbs.simulate.scenario import with_robots_placed
    from calib.verbs.simulate.scenario_words import read_scenario
    from calib.verbs.simulate.session_text import heading, legend, result_lines, stop_line
    from calib.verbs.simulate.truth_file import write_session_truth
    from calib.verbs.simulate.virtual_session import (
        everywhere,
        known_cell,
        measure_with,
        true_error,
    )

    assert options.session is not None
    folder = options.session
    if truth is None:
        truth = folder.with_name(f"{folder.name}_truth.json")
    check_outputs([truth], [robot, cell_options.file, errors.truth_robot], force=force)
    aim = Aim(poses=count)
    if options.aim is not None:
        aim = Aim(error=parse_amount(options.aim, "--aim", LENGTH, "0.15 mm"))
    cell = with_robots_placed(cell_options.cell())
    arm = load(robot, cell)
    check_arm_is_named(arm, cell)
    virtual = read_scenario(arm, cell, cell_options.file, errors).draw(seed)
    operator = Operator.of(virtual, seed, USUAL_MISTAKES if options.mistakes else NO_MISTAKES)
    known = known_cell(virtual, seed)
    stops = []
    with progress_bar("candidates", quiet=quiet) as progress:
        session = Session.start(folder, arm, known, aim, seed=seed, progress=progress)
    with session:
        if not quiet:
            typer.echo(f"{legend()}\n\n{heading(arm)}")
        for stop in measure_with(session, operator, MOST_STOPS):
            stops.append(stop.measurement)
            if not quiet:
                typer.echo(stop_line(arm, stop))
        with work_line(quiet=quiet):
            result = session.calibrate()
        state = session.state
    q = everywhere(virtual)
    predicted = result.predict_poses(q, group=result.setup.groups[0])
    true = min(true_error(of, q, predicted) for of in (virtual, operator.now))
    write_session_truth(operator, stops, seed, truth, overwrite=force)
    if not quiet:
        nominal = rms(virtual.truth.nominal_errors(q))
        typer.echo("\n".join(["", *result_lines(state, result, nominal, true), ""]))
        typer.echo("\n".join(written_lines(folder, truth)))
