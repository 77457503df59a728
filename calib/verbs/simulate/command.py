"""``calib simulate``: a table of a robot whose errors are known, and the truth beside it; or a study of many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.executor import executor_of
from calib.cli.loading import load
from calib.cli.options import ColumnChoice, Force, JobOptions, ModelOptions, Quiet, RobotFile
from calib.cli.outputs import check_outputs, written_lines
from calib.cli.terminal import progress_bar
from calib.cli.verb import verb
from calib.errors import CalibError, choices
from calib.verbs.simulate.scenario_words import ScenarioWords

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from calib.basics.arrays import Array
    from calib.data.cell import Cell
    from calib.verbs.simulate.scenario import Scenario

_Text = str | None
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


@dataclass(frozen=True, slots=True)
class SimulateOutputs:
    """Files that are written."""

    output: Annotated[_File, typer.Option("-o", "--output", help="Write the table.")] = None
    truth: Annotated[
        _File,
        typer.Option(
            help="Write the truth to this file. Default: TABLE_truth.json, next to the table."
        ),
    ] = None
    truth_urdf: Annotated[
        _File, typer.Option(help="Write the URDF of the true robot to this file.")
    ] = None
    images: Annotated[
        _File,
        typer.Option(
            metavar="FOLDER",
            help="With --kind pixel: draw the pictures into this folder, with joints.csv, board.toml and camera.yaml.",
        ),
    ] = None
    json: Annotated[_File, typer.Option(help="With --study: write every trial as JSON.")] = None
    force: Force = False

    @property
    def truth_path(self) -> Path | None:
        """The file of the truth: as given, or beside the table or among the pictures; None without both."""
        if self.truth is not None:
            return self.truth
        if self.output is None:
            return None if self.images is None else self.images / "truth.json"
        return self.output.with_name(f"{self.output.stem}_truth.json")

    @property
    def files(self) -> list[Path | None]:
        """The files but the pictures, without what goes into a folder that is yet to be made."""
        files = [self.output, self.truth_path, self.truth_urdf, self.json]
        if self.images is None or self.images.is_dir():
            return files
        return [path for path in files if path is None or path.parent != self.images]


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """A study: simulation, calibration and verification of many robots."""

    study: Annotated[
        int | None, typer.Option(min=2, help="Simulate and calibrate this number of robots.")
    ] = None
    planned: Annotated[
        bool,
        typer.Option("--planned", help="With --study: plan the poses in place of random ones."),
    ] = False
    fit_model: Annotated[
        _Text,
        typer.Option(
            help="With --study: the errors that the calibrations estimate, as of --model. Default: auto."
        ),
    ] = None


@dataclass(frozen=True, slots=True, eq=False)
class _Simulation:
    """A virtual cell and the poses to measure in it."""

    scenario: Scenario
    cell: Cell
    #: (N, m), [rad] or [m]; None: random ones
    poses: Array | None
    #: The set of each of these poses
    sets: tuple[str, ...]
    #: Number of random poses to fit
    count: int
    #: Number of random poses to validate with
    validation: int
    seed: int


@verb("""Simulate measurements of a robot whose errors are known.

\b
Examples:
  calib simulate ur3 --base base --tip tool0 -o table.csv
  calib simulate robot.urdf --poses plan.csv --seed 2 -o table.csv --truth truth.json
  calib simulate robot.urdf --count 50 --validation 20 --frame estimate -o table.csv
  calib simulate robot.urdf --error "elbow_joint.rx=2 mrad" --noise none -o table.csv
  calib simulate ur5 --kind pixel --camera-on tool0 --board-on base_link --images pictures -o corners.csv
  calib simulate robot.urdf --count 30 --planned --study 200

It writes a table for calib calibrate and the truth beside it: the robot's errors, targets, frames and what happened in
which row. The same seed gives the same files. --model is the error model of the simulated robot, placement by default;
--target is the nominal place of the target, 50 50 50 mm by default. The cell file's table [simulation] has encoder
resolution, drift, a moved target and more. A study repeats simulation, calibration and verification with other robots.

Of the kind pixel it places a camera and a printed board, usual ones or those of --camera and --board, and takes
pictures at poses from which the whole board is seen; --images draws them, for calib detect.
""")
def simulate(
    robot: RobotFile,
    cell_options: ModelOptions,
    error_options: ScenarioWords,
    pose_options: PoseOptions,
    outputs: SimulateOutputs,
    study_options: StudyOptions,
    job_options: JobOptions,
    quiet: Quiet = False,
) -> None:
    """Simulate a table, pictures or a study, write the files and print what was simulated."""
    _check_options(outputs, study_options)
    check_outputs(
        outputs.files,
        [robot, pose_options.poses, cell_options.file, error_options.truth_robot],
        force=outputs.force,
    )
    # Workers begin first: they import what they need while robot and scenario are prepared here.
    with executor_of(job_options.workers, job_options.dask, study_options.study) as executor:
        simulation = _prepare(robot, cell_options, error_options, pose_options)
        _check_kind(simulation.scenario, outputs, study_options)
        if study_options.study is not None:
            text, written = _run_study(simulation, study_options, outputs, executor, quiet=quiet)
        elif simulation.scenario.kind.optical:
            text, written = _simulate_pictures(simulation, outputs, quiet=quiet)
        else:
            text, written = _simulate_table(simulation, outputs)
    if not quiet:
        typer.echo("\n".join([f"{text}\n", *written_lines(*written)]))


def _check_options(outputs: SimulateOutputs, study_options: StudyOptions) -> None:
    """Refuse options of a table with a study, and those of a study without one; raises `CalibError`."""
    of_table: dict[str, Any] = {
        "-o": outputs.output,
        "--truth": outputs.truth,
        "--truth-urdf": outputs.truth_urdf,
        "--images": outputs.images,
    }
    of_study: dict[str, Any] = {
        "--fit-model": study_options.fit_model,
        "--json": outputs.json,
        "--planned": study_options.planned or None,
    }
    if study_options.study is None:
        _refuse_given(of_study, "does not go without --study")
    else:
        _refuse_given(of_table, "does not go with --study")
    if study_options.study is None and outputs.output is None and outputs.images is None:
        raise CalibError("Name the table to write: -o table.csv.")


def _check_kind(scenario: Scenario, outputs: SimulateOutputs, study_options: StudyOptions) -> None:
    """Refuse pictures of other kinds, and plans of pictures in a study; raises `CalibError`."""
    if outputs.images is not None and not scenario.kind.optical:
        raise CalibError(
            "--images draws what a camera sees of a printed board: add --kind pixel, with --camera-on and --board-on."
        )
    if study_options.planned and scenario.kind.optical:
        raise CalibError(
            f"--planned does not go with the kind '{scenario.kind.name}', whose poses are those from which the board "
            "is seen; give those of a plan with --poses."
        )


def _refuse_given(options: Mapping[str, Any], reason: str) -> None:
    """Refuse the options, by name, that have a value; None: not given."""
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise CalibError(f"{choices(given)} {reason}.")


def _prepare(
    robot: str,
    cell_options: ModelOptions,
    error_options: ScenarioWords,
    pose_options: PoseOptions,
) -> _Simulation:
    """Load the robot, and read the scenario and the poses."""
    import calib.verbs.simulate.study  # noqa: F401  while the workers import it too
    from calib.verbs.plan.plan_file import read_poses
    from calib.verbs.simulate.scenario_words import read_scenario

    cell = cell_options.cell()
    arm = load(robot, cell)
    scenario = read_scenario(arm, cell, cell_options.file, error_options)
    joints: Array | None = None
    sets: tuple[str, ...] = ()
    default_validation = 10
    if pose_options.poses is not None:
        table = read_poses(pose_options.poses, arm, pose_options.parsed())
        joints, sets = table.joints, table.sets
        default_validation = 0
    validation = default_validation if pose_options.validation is None else pose_options.validation
    return _Simulation(
        scenario, cell, joints, sets, pose_options.count, validation, pose_options.seed
    )


def _simulate_table(simulation: _Simulation, outputs: SimulateOutputs) -> tuple[str, list[Path]]:
    """Simulate one table, and write it with the truth; returns the text, and the files."""
    from calib.verbs.simulate.scenario import simulate as simulate_rows
    from calib.verbs.simulate.text import simulated_text
    from calib.verbs.simulate.truth_file import write_truth

    assert outputs.output is not None
    assert outputs.truth_path is not None
    scenario = simulation.scenario
    simulated = simulate_rows(
        scenario,
        simulation.count,
        simulation.validation,
        simulation.seed,
        simulation.poses,
        simulation.sets,
    )
    simulated.measurements.write(outputs.output, overwrite=outputs.force)
    truth = write_truth(scenario, simulated, outputs.truth_path, overwrite=outputs.force)
    written = [outputs.output, truth]
    if outputs.truth_urdf is not None:
        urdf = simulated.truth.write_urdf(outputs.truth_urdf, overwrite=outputs.force)
        written.append(urdf)
    return simulated_text(scenario, simulated), written


def _simulate_pictures(
    simulation: _Simulation, outputs: SimulateOutputs, *, quiet: bool
) -> tuple[str, list[Path]]:
    """Simulate pictures, write their corners and draw them, as is wanted; returns the text, and the files."""
    from calib.verbs.simulate.camera.picture_files import write_pictures
    from calib.verbs.simulate.camera.simulate import simulate_pictures
    from calib.verbs.simulate.camera.text import simulated_pictures_text
    from calib.verbs.simulate.camera.truth_file import write_camera_truth

    assert outputs.truth_path is not None
    pictures = simulate_pictures(
        simulation.scenario,
        simulation.count,
        simulation.validation,
        simulation.seed,
        simulation.poses,
        simulation.sets,
    )
    written = []
    if outputs.images is not None:
        with progress_bar("pictures", quiet=quiet) as progress:
            drawn = write_pictures(
                pictures, outputs.images, overwrite=outputs.force, progress=progress
            )
        written += [path for path in drawn if path.suffix != ".png"]
    if outputs.output is not None:
        pictures.measurements.write(outputs.output, overwrite=outputs.force)
        written.append(outputs.output)
    written.append(write_camera_truth(pictures, outputs.truth_path, overwrite=outputs.force))
    if outputs.truth_urdf is not None:
        truth = pictures.cell.truth
        written.append(truth.write_urdf(outputs.truth_urdf, overwrite=outputs.force))
    return simulated_pictures_text(pictures), written


def _run_study(
    simulation: _Simulation,
    options: StudyOptions,
    outputs: SimulateOutputs,
    executor: Executor | None,
    *,
    quiet: bool,
) -> tuple[str, list[Path]]:
    """Simulate and calibrate many robots; returns the text, and the files."""
    from calib.result.calibration_file import write_table
    from calib.verbs.simulate.study import study, study_table
    from calib.verbs.simulate.text import study_text
    from calib.verbs.simulate.trial import Trials

    assert options.study is not None
    # The fit is given what a person would know, and not the errors of the robot.
    fit_cell = replace(simulation.cell, model=options.fit_model or "auto")
    trials = Trials(
        simulation.scenario,
        fit_cell,
        simulation.poses,
        simulation.sets,
        simulation.count,
        simulation.validation,
        options.planned,
    )
    with progress_bar("trials", quiet=quiet) as progress:
        done = study(trials, options.study, simulation.seed, executor, progress)
    written = []
    if outputs.json is not None:
        table = study_table(done, trials, simulation.seed)
        written.append(write_table(table, outputs.json, overwrite=outputs.force))
    return study_text(done, trials), written
