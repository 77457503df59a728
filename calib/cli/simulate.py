"""``calib simulate``: a table of a robot whose errors are known, and the truth beside it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.executors import Dask, Workers, executor_of
from calib.cli.options import (
    Base,
    CellFile,
    Debug,
    Force,
    Hold,
    MeasuredKind,
    PayloadMass,
    Quiet,
    RobotFile,
    Tip,
    reporting,
)
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from calib.cli.simulate_setup import Prepared

#: Of a line of the command to type next.
_WIDTH = 88

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
    tip: Tip = None,
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
            "--model",
            metavar="SET[+FAMILY...]",
            help="In which errors the robot is wrong, such as dh or placement+gain+compliance. Default: placement.",
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
    truth_robot: Annotated[
        Path | None, typer.Option("--truth-robot", help="URDF of the true robot.")
    ] = None,
    target_error: Annotated[
        str | None,
        typer.Option(
            "--target-error",
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
            "--angle-noise",
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
            help='Joint values are read in steps, such as "0.001 deg". Once more for joints that slide: "0.01 mm".',
        ),
    ] = None,
    outliers: Annotated[
        str | None,
        typer.Option(metavar='N|"P %"', help="Rows that are far off: a number, or a share."),
    ] = None,
    outlier_size: Annotated[
        str | None,
        typer.Option(
            "--outlier-size", metavar="LENGTH", help='How far they are off. Default: "5 mm".'
        ),
    ] = None,
    moved_target: Annotated[
        str | None,
        typer.Option(
            "--moved-target",
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
        typer.Option(
            "--truth", help="Write the truth, as JSON. Default: TABLE_truth.json beside the table."
        ),
    ] = None,
    truth_urdf: Annotated[
        Path | None, typer.Option("--truth-urdf", help="Write the URDF of the true robot.")
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
            "--fit-model",
            metavar="SET[+FAMILY...]",
            help="Of a study: which errors are estimated. Default: auto.",
        ),
    ] = None,
    workers: Workers = None,
    dask: Dask = None,
    json: Annotated[
        Path | None, typer.Option("--json", help="Of a study: write every trial as JSON.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    # Workers begin first: they import what they need while robot and scenario are prepared here.
    with reporting(debug=debug), executor_of(workers, dask, study) as executor:
        from calib.cli.setup import check_outputs, load, read_cell
        from calib.cli.simulate_setup import Asked, checked_model, prepare, with_tracker

        inputs = [robot, *(str(path) for path in (poses, cell, truth_robot) if path)]
        check_outputs([output, truth, truth_urdf, json], inputs, force=force)
        setup = read_cell(
            cell,
            base=base,
            tip=tip,
            target=target,
            frame=frame,
            model=checked_model(model),
            kind=kind,
            hold=hold,
            payload=payload,
        )
        setup = with_tracker(setup, tracker)
        asked = Asked(
            poses=poses,
            count=count,
            validation=validation,
            visits=visits,
            seed=seed,
            sizes=sizes,
            errors=tuple(error or ()),
            truth_robot=truth_robot,
            target_error=target_error,
            noise=noise,
            repeatability=repeatability,
            angle_noise=angle_noise,
            encoder=tuple(encoder or ()),
            outliers=outliers,
            outlier_size=outlier_size,
            moved_target=moved_target,
            drift=drift,
        )
        prepared = prepare(load(robot, setup), setup, asked)
        if study is not None:
            from calib.cli.study import check_alone, print_study

            check_alone({"-o": output, "--truth": truth, "--truth-urdf": truth_urdf})
            print_study(
                prepared,
                study,
                fit_model,
                executor,
                json,
                planned=planned,
                force=force,
                quiet=quiet,
            )
            return
        of_study: dict[str, object] = {
            "--fit-model": fit_model,
            "--workers": workers,
            "--dask": dask,
            "--json": json,
        }
        _check_no_study(planned, of_study)
        table, beside = _outputs(
            output, truth, [*inputs, *([str(truth_urdf)] if truth_urdf else [])], force=force
        )
        written, text = _simulate(prepared, table, beside, truth_urdf, force=force)
        if not quiet:
            typer.echo(text + "\n")
            for path in written:
                typer.echo(f"Written: {path}")
            words = {
                "--base": base,
                "--tip": tip,
                "--target": target,
                "--frame": frame,
                "--kind": kind,
                "--payload": payload,
                "--cell": None if cell is None else str(cell),
            }
            typer.echo(f"\nNext:  {_next(robot, table, words, hold or [])}")


def _check_no_study(planned: bool, given: dict[str, object]) -> None:
    """Refuse what only a study takes.

    Raises:
        CalibError: Something was given.
    """
    names = [*(["--planned"] if planned else []), *(n for n, v in given.items() if v is not None)]
    if names:
        message = (
            f"{choices(names)} is for a study of many robots; add --study 200, or leave it out."
        )
        raise CalibError(message)


def _outputs(
    output: Path | None, truth: Path | None, others: list[str], *, force: bool
) -> tuple[Path, Path]:
    """The table's path and the truth's, which stands beside it if not named.

    Raises:
        CalibError: No table was named.
        FileError: One of them cannot be written.
    """
    from calib.cli.setup import check_outputs

    if output is None:
        message = "Name the table to write: -o table.csv."
        raise CalibError(message)
    beside = output.with_name(f"{output.stem}_truth.json") if truth is None else truth
    check_outputs([output, beside], others, force=force)
    return output, beside


def _simulate(
    prepared: Prepared, output: Path, truth: Path, truth_urdf: Path | None, *, force: bool
) -> tuple[list[Path], str]:
    """Simulate, and write; what was written, and what is to be said."""
    from calib.cli.simulate_text import simulated_text
    from calib.measure.scenario import outside_limits
    from calib.measure.truth_file import write_true_urdf, write_truth

    cell = prepared.scenario.draw(prepared.seed)
    q, sets = prepared.all_poses(prepared.seed)
    made = cell.measure(q, prepared.seed, sets)
    text = simulated_text(cell, made, outside_limits(cell.robot, q))
    made.measurements.write(output, overwrite=force)
    written = [output, write_truth(cell, made, truth, overwrite=force)]
    if truth_urdf is not None:
        written.append(write_true_urdf(cell.truth, truth_urdf, overwrite=force))
    return written, text


def _next(robot: str, table: Path, words: dict[str, str | None], held: list[str]) -> str:
    """The command that fits what was simulated, in lines that a shell joins again."""
    parts = [shlex.join(["calib", "fit", robot, str(table)])]
    parts += [shlex.join([o, value]) for o, value in words.items() if value is not None]
    parts += [shlex.join(["--hold", value]) for value in held]
    lines = [""]
    for part in [*parts, "-o corrected.urdf"]:
        if lines[-1] and len(lines[-1]) + len(part) > _WIDTH:
            lines.append("")
        lines[-1] += f" {part}" if lines[-1] else part
    return " \\\n         ".join(lines)


simulate.__doc__ = _HELP
