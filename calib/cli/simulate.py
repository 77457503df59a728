"""``calib simulate``: a table of a robot whose errors are known, and the truth beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import (
    Base,
    CellFile,
    Dask,
    Debug,
    Force,
    Hold,
    MeasuredKind,
    PayloadMass,
    Quiet,
    RobotFile,
    RobotTip,
    Workers,
    reporting,
)
from calib.cli.setup import executor_of
from calib.errors import CalibError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import numpy as np
    from numpy.typing import NDArray

    from calib.simulate.scenario import Scenario
    from calib.simulate.study import Trials

#: Poses, and poses to validate with, where nothing says how many.
_COUNT, _VALIDATION = 30, 10

#: How far a target sits from where it is said to, where nothing says so.
_TARGET_ERROR = "1 mm"

_HELP = """Simulate measurements of a robot whose errors are known.

\b
Examples:
  calib simulate ur3 --base base --tip tool0 -o table.csv
  calib simulate robot.urdf --poses plan.csv --seed 2 -o table.csv --truth truth.json
  calib simulate robot.urdf --count 50 --validation 20 --frame estimate -o table.csv
  calib simulate robot.urdf --error "elbow_joint.rx=2 mrad" --noise none -o table.csv
  calib simulate robot.urdf --outliers 3 --moved-target "25: 0 0 0.5 mm" -o table.csv
  calib simulate robot.urdf --count 30 --planned --study 200

It writes a table that calib fit reads, and beside it what was true: the robot's errors, the target's place, what
happened in which row. The same seed gives the same files. A study writes no table: it does all of it many times, each
time with another robot, and says what calibrations reach.
"""


def simulate(
    robot: RobotFile,
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Poses of a plan or a measured table, its joint columns alone. Default: random ones.",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1_000_000,
            metavar="N",
            help="Number of random poses inside the limits. Default: 30.",
        ),
    ] = None,
    validation: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=1_000_000,
            metavar="N",
            help="Random poses besides, marked 'validate'. Default: 10, and 0 with --poses.",
        ),
    ] = None,
    visits: Annotated[
        int, typer.Option(min=1, max=1000, metavar="N", help="How often each pose is measured.")
    ] = 1,
    seed: Annotated[
        int, typer.Option(min=0, metavar="S", help="The same S gives the same files.")
    ] = 0,
    base: Base = None,
    tip: RobotTip = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Where the target is said to sit in the tip. Default: "50 50 50 mm".',
        ),
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(
            metavar="known|estimate|LIST",
            help="'known': measured in the base frame, or in the cell's (default). 'estimate': in the frame of a "
            "tracker that stands somewhere 3 m away.",
        ),
    ] = None,
    kind: MeasuredKind = None,
    payload: PayloadMass = None,
    hold: Hold = None,
    cell: CellFile = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="SET[+FAMILY...]",
            help="Error model of the simulated robot, such as dh or placement+gain+compliance. Default: placement.",
        ),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(
            metavar='"FAMILY VALUE, ..."',
            help='Sizes of the drawn errors, such as "length 0.5 mm, angle 3 mrad, zero 5 mrad", or none. Default: '
            "those of a typical arm; none with --error.",
        ),
    ] = None,
    error: Annotated[
        list[str] | None,
        typer.Option(
            metavar='"NAME=VALUE"',
            help='One error by name, such as "elbow_joint.rx=2 mrad". Can be repeated.',
        ),
    ] = None,
    truth_robot: Annotated[Path | None, typer.Option(help="URDF of the true robot.")] = None,
    target_error: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help='How far the target sits from where it is said to, standard deviation. Default: "1 mm".',
        ),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NOISE",
            help='Of one coordinate, such as "0.05 mm", "15 um + 6 um/m" by the distance, or none. Default: a laser '
            "tracker's and a robot's repeatability of 0.02 mm, or the cell's.",
        ),
    ] = None,
    repeatability: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Of the robot, one coordinate. Default: 0.02 mm; 0 with --noise.",
        ),
    ] = None,
    angle_noise: Annotated[
        str | None,
        typer.Option(
            metavar="ANGLE",
            help='Noise of orientations about each axis. Default: "0.01 deg", or the cell\'s.',
        ),
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Where the tracker stands in the base. Default: "3000 0 0 mm", or the cell\'s.',
        ),
    ] = None,
    encoder: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STEP",
            help='Encoder resolution, such as "0.001 deg"; repeat the option for prismatic joints: "0.01 mm".',
        ),
    ] = None,
    outliers: Annotated[
        str | None,
        typer.Option(metavar='N|"P %"', help="Rows that are far off: a number, or a share."),
    ] = None,
    outlier_size: Annotated[
        str | None,
        typer.Option(metavar="LENGTH", help='How far they are off. Default: "5 mm".'),
    ] = None,
    moved_target: Annotated[
        str | None,
        typer.Option(
            metavar='"ROW: X Y Z UNIT"',
            help='The target is knocked before a row, such as "25: 0 0 0.5 mm", along the tip\'s axes.',
        ),
    ] = None,
    drift: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help="How far the instrument drifts from the first row to the last.",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the table. Needed.")
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Write the truth, as JSON. Default: TABLE_truth.json beside the table."),
    ] = None,
    truth_urdf: Annotated[
        Path | None, typer.Option(help="Write the URDF of the true robot.")
    ] = None,
    study: Annotated[
        int | None,
        typer.Option(
            min=2,
            metavar="N",
            help="Simulate N robots, calibrate each, verify it against its truth, and print figures with their spread; "
            "200 is a good number.",
        ),
    ] = None,
    planned: Annotated[
        bool,
        typer.Option("--planned", help="Of a study: plan the --count poses, anew each time."),
    ] = False,
    fit_model: Annotated[
        str | None,
        typer.Option(
            metavar="SET[+FAMILY...]",
            help="Of a study: which errors are estimated. Default: auto.",
        ),
    ] = None,
    workers: Workers = None,
    dask: Dask = None,
    json: Annotated[
        Path | None, typer.Option(help="Of a study: write every trial as JSON.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    # Workers begin first: they import what they need while robot and scenario are prepared here.
    with reporting(debug=debug), executor_of(workers, dask, study) as executor:
        from dataclasses import replace

        from calib.cli.setup import AUTO, check_model, check_outputs, load, parse_point, read_cell
        from calib.cli.simulate_options import (
            angle_noise_of,
            check_poses,
            check_together,
            definite,
            noise_of,
            parse_encoder,
            parse_errors,
            parse_moved,
            parse_outliers,
            parse_size,
            sizes_of,
        )
        from calib.cli.surroundings_words import parse_tracker
        from calib.design.plan_file import read_pose_list
        from calib.model.error_model import error_model
        from calib.model.robot import Robot
        from calib.simulate.scenario import DEFAULT_MODEL, Scenario

        check_together(
            study,
            {"-o": output, "--truth": truth, "--truth-urdf": truth_urdf},
            {
                "--planned": planned or None,
                "--fit-model": fit_model,
                "--workers": workers,
                "--dask": dask,
                "--json": json,
            },
        )
        check_poses(poses, count, planned=planned)
        if output is not None and truth is None:
            truth = output.with_name(f"{output.stem}_truth.json")
        inputs = [robot, *(str(path) for path in (poses, cell, truth_robot) if path)]
        check_outputs([output, truth, truth_urdf, json], inputs, force=force)
        setup = read_cell(
            cell,
            base=base,
            tip=tip,
            target=target,
            frame=frame,
            model=definite(model),
            kind=kind,
            hold=hold,
            payload=payload,
        )
        check_model(fit_model or AUTO, "--fit-model")
        if tracker is not None:
            setup = replace(setup, tracker=parse_tracker(tracker, setup.tracker))
        arm = load(robot, setup)
        wrong = DEFAULT_MODEL if setup.model == AUTO else setup.model
        errors = parse_errors(error or (), error_model(arm, wrong, target=False).parameters)
        noises = noise_of(setup, noise, repeatability)
        true_robot = None
        if truth_robot is not None:
            true_robot = Robot.load(truth_robot, arm.base, arm.tip, held=arm.held)
        scenario = Scenario(
            robot=arm,
            cell=setup,
            model=wrong,
            sizes=sizes_of(setup, sizes, named=bool(errors)),
            errors=errors,
            true_robot=true_robot,
            target_error=parse_size(target_error or _TARGET_ERROR, "--target-error"),
            noise=noises,
            sigma_angle=angle_noise_of(setup, angle_noise, any_noise=noises is not None),
            encoder=parse_encoder(encoder or ()),
            outliers=parse_outliers(outliers, outlier_size),
            moved=parse_moved(moved_target),
            drift=parse_point(drift or "0 0 0 mm", "--drift"),
            visits=visits,
        )
        given, sets = (None, ()) if poses is None else read_pose_list(poses, arm)
        number = count or _COUNT
        extra = (_VALIDATION if given is None else 0) if validation is None else validation
        if study is not None:
            from calib.simulate.study import Trials

            # The fit knows what a person would tell it, and not what the robot is wrong in.
            told = replace(setup, model=fit_model or AUTO)
            trials = Trials(scenario, told, given, sets, number, extra, planned)
            _study(trials, study, seed, executor, json, force=force, quiet=quiet)
            return
        if output is None or truth is None:
            raise CalibError("Name the table to write: -o table.csv.")
        from calib.cli.simulate_text import next_command

        chosen = scenario.poses(seed, number, extra, given, sets)
        text = _simulate(scenario, chosen, seed, output, truth, truth_urdf, force=force)
        if not quiet:
            options = {
                "--base": base,
                "--tip": tip,
                "--target": target,
                "--frame": frame,
                "--kind": kind,
                "--payload": payload,
                "--cell": None if cell is None else str(cell),
            }
            typer.echo(f"{text}\n\nNext:  {next_command(robot, output, options, hold or [])}")


def _simulate(
    scenario: Scenario,
    chosen: tuple[NDArray[np.float64], tuple[str, ...]],
    seed: int,
    output: Path,
    truth: Path,
    truth_urdf: Path | None,
    *,
    force: bool,
) -> str:
    """Simulate once, write table and truth; what is to be said."""
    from calib.cli.simulate_text import simulated_text
    from calib.simulate.scenario import outside_limits
    from calib.simulate.truth_file import write_true_urdf, write_truth

    q, sets = chosen
    made = scenario.draw(seed).measure(q, seed, sets)
    text = simulated_text(scenario, made, outside_limits(scenario.robot, q))
    written = [output, write_truth(scenario, made, truth, overwrite=force)]
    made.measurements.write(output, overwrite=force)
    if truth_urdf is not None:
        written.append(write_true_urdf(made.truth, truth_urdf, overwrite=force))
    return "\n".join([f"{text}\n", *(f"Written: {path}" for path in written)])


def _study(
    trials: Trials,
    count: int,
    seed: int,
    executor: Executor | None,
    json: Path | None,
    *,
    force: bool,
    quiet: bool,
) -> None:
    """Do a study, write it and print it."""
    from calib.cli.simulate_text import study_text
    from calib.cli.terminal import progress_bar
    from calib.identify.result_file import write_table
    from calib.simulate.study import study, study_table

    with progress_bar("trials", quiet=quiet) as progress:
        found = study(trials, count, seed, executor, progress)
    if json is not None:
        write_table(study_table(found, trials, seed), json, overwrite=force)
    if not quiet:
        typer.echo(study_text(found, trials) + (f"\n\nWritten: {json}" if json else ""))


simulate.__doc__ = _HELP
