"""``calib simulate``: a table of a robot whose errors are known, and the truth beside it; or a study of many."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import (
    CellOptions,
    Dask,
    Force,
    ModelOptions,
    Quiet,
    RobotFile,
    RobotTip,
    Workers,
    verb,
)
from calib.cli.setup import (
    AUTO,
    check_model,
    check_outputs,
    executor_of,
    load,
    parse_amount,
    parse_pair,
    parse_point,
    read_cell,
)
from calib.errors import CalibError, choices, did_you_mean

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.data.surroundings import TrackerNoise
    from calib.model.parameters import Parameter
    from calib.simulation.truth import Encoder, MovedTarget, Outliers

_NONE = "none"

#: Noise of an orientation about each axis, of a tracker's 6D probe [deg].
_PROBE_DEG = 0.01


@dataclass(frozen=True, slots=True)
class VirtualCellOptions(ModelOptions):
    """The set-up as the line has it, with what a virtual one means by it."""

    tip: RobotTip = None
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Where the target is said to sit in the tip. Default: "50 50 50 mm".',
        ),
    ] = None
    frame: Annotated[
        str | None,
        typer.Option(
            metavar="known|estimate|LIST",
            help="'known': measured in the base frame, or in the cell's (default). 'estimate': in the frame of a "
            "tracker that stands somewhere 3 m away.",
        ),
    ] = None
    model: Annotated[
        str | None,
        typer.Option(
            metavar="SET[+FAMILY...]",
            help="Error model of the simulated robot, such as dh or placement+gain+compliance. Default: placement.",
        ),
    ] = None


@verb("""Simulate measurements of a robot whose errors are known.

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
""")
def simulate(
    robot: RobotFile,
    setup: VirtualCellOptions,
    poses: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Poses of a plan or a table. Default: random ones."),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Random poses inside the limits. Default: 30."),
    ] = None,
    validation: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Random poses to validate with. Default: 10; 0 with --poses."
        ),
    ] = None,
    visits: Annotated[
        int, typer.Option(min=1, metavar="N", help="How often each pose is measured.")
    ] = 1,
    seed: Annotated[
        int, typer.Option(min=0, metavar="S", help="The same S gives the same files.")
    ] = 0,
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
            metavar='"NAME=VALUE"', help='One error, "elbow_joint.rx=2 mrad". Can be repeated.'
        ),
    ] = None,
    truth_robot: Annotated[Path | None, typer.Option(help="URDF of the true robot.")] = None,
    target_error: Annotated[
        str, typer.Option(metavar="LENGTH", help="Standard deviation of the target's true place.")
    ] = "1 mm",
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
        typer.Option(metavar="LENGTH", help="Of the robot. Default: 0.02 mm; 0 with --noise."),
    ] = None,
    angle_noise: Annotated[
        str | None,
        typer.Option(metavar="ANGLE", help="Of orientations. Default: 0.01 deg, or the cell's."),
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"', help='In the base. Default: "3000 0 0 mm", or the cell\'s.'
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
        typer.Option(metavar="LENGTH", help="How far they are off. Default: 5 mm."),
    ] = None,
    moved_target: Annotated[
        str | None,
        typer.Option(
            metavar='"ROW: X Y Z UNIT"',
            help='The target is knocked before a row, such as "25: 0 0 0.5 mm", along the tip\'s axes.',
        ),
    ] = None,
    drift: Annotated[
        str,
        typer.Option(metavar='"X Y Z UNIT"', help="Of the instrument, first to last row."),
    ] = "0 0 0 mm",
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
            help="Simulate, calibrate and verify N robots, and print their spread; 200 is a good number.",
        ),
    ] = None,
    planned: Annotated[
        bool,
        typer.Option("--planned", help="Of a study: plan the --count poses, anew each time."),
    ] = False,
    fit_model: Annotated[
        str | None,
        typer.Option(
            metavar="SET[+FAMILY...]", help="Of a study: what is estimated. Default: auto."
        ),
    ] = None,
    workers: Workers = None,
    dask: Dask = None,
    json: Annotated[
        Path | None, typer.Option(help="Of a study: write every trial as JSON.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    of_one = {"-o": output, "--truth": truth, "--truth-urdf": truth_urdf}
    of_study = {"--fit-model": fit_model, "--workers": workers, "--dask": dask, "--json": json}
    of_study["--planned"] = planned or None
    other = of_study if study is None else of_one
    if unfit := [name for name, value in other.items() if value is not None]:
        raise CalibError(
            f"{choices(unfit)} is for a study of many robots; add --study 200, or leave it out."
            if study is None
            else f"A study writes no table and no truth; leave {choices(unfit)} out. --json keeps every trial."
        )
    if poses is not None and (planned or count is not None):
        raise CalibError(
            "--poses gives the poses; leave --count and --planned out, which make some."
        )
    # Workers begin first: they import what they need while robot and scenario are prepared here.
    with executor_of(workers, dask, study) as executor:
        from calib.cli.surroundings_words import parse_tracker
        from calib.design.plan_file import read_pose_list
        from calib.model.error_model import error_model
        from calib.robot.robot import Robot
        from calib.simulation.scenario import DEFAULT_MODEL, Scenario

        truth = truth or (output and output.with_name(f"{output.stem}_truth.json"))
        inputs = [robot, *(str(path) for path in (poses, setup.cell, truth_robot) if path)]
        check_outputs([output, truth, truth_urdf, json], inputs, force=force)
        cell = read_cell(**asdict(setup))
        check_model(fit_model or AUTO, "--fit-model")
        if tracker is not None:
            cell = replace(cell, tracker=parse_tracker(tracker, cell.tracker))
        arm = load(robot, cell)
        wrong = DEFAULT_MODEL if cell.model == AUTO else cell.model
        errors = parse_errors(error or (), error_model(arm, wrong, target=False).parameters)
        noises = noise_of(cell, noise, repeatability)
        scenario = Scenario(
            robot=arm,
            cell=cell,
            model=wrong,
            sizes=sizes_of(cell, sizes, named=bool(errors)),
            errors=errors,
            true_robot=None
            if truth_robot is None
            else Robot.load(truth_robot, arm.base, arm.tip, held=arm.held),
            target_error=parse_amount(target_error, "--target-error", "a length", "1 mm"),
            noise=noises,
            sigma_angle=angle_noise_of(cell, angle_noise, any_noise=noises is not None),
            encoder=parse_encoder(encoder or ()),
            outliers=parse_outliers(outliers, outlier_size),
            moved=parse_moved(moved_target),
            drift=parse_point(drift, "--drift"),
            visits=visits,
        )
        given, sets = (None, ()) if poses is None else read_pose_list(poses, arm)
        count = 30 if count is None else count
        validation = (10 if given is None else 0) if validation is None else validation
        if study is not None:
            from calib.cli.terminal import progress_bar
            from calib.result.calibration_file import write_table
            from calib.simulation import study as studies
            from calib.text.simulation import study_text

            # The fit knows what a person would tell it, and not what the robot is wrong in.
            told = replace(cell, model=fit_model or AUTO)
            trials = studies.Trials(scenario, told, given, sets, count, validation, planned)
            with progress_bar("trials", quiet=quiet) as progress:
                found = studies.study(trials, study, seed, executor, progress)
            text, written = study_text(found, trials), []
            if json is not None:
                table = studies.study_table(found, trials, seed)
                written.append(write_table(table, json, overwrite=force))
        else:
            from calib.simulation.truth_file import write_simulated
            from calib.text.simulation import simulated_text

            if output is None or truth is None:
                raise CalibError("Name the table to write: -o table.csv.")
            q, sets = scenario.poses(seed, count, validation, given, sets)
            made = scenario.draw(seed).measure(q, seed, sets)
            written = write_simulated(scenario, made, output, truth, truth_urdf, overwrite=force)
            text = simulated_text(scenario, made, q)
    if not quiet:
        typer.echo("\n".join([f"{text}\n", *(f"Written: {path}" for path in written)]))
        if output is not None:
            typer.echo(f"\nNext:  {next_command(robot, output, setup)}")


def sizes_of(cell: Cell, sizes: str | None, *, named: bool) -> Mapping[str, float] | None:
    """``--sizes``: ``length 0.5 mm, angle 3 mrad`` or ``none``; else none with named errors, the cell's, or typical."""
    from calib.model.families import FAMILIES

    if sizes is None and not named:
        return {f: cell.priors.of(f) for f in FAMILIES} if cell.priors.sizes == "given" else {}
    if sizes is None or sizes.strip() == _NONE:
        return None
    found: dict[str, float] = {}
    for part in sizes.split(","):
        name, _, value = part.strip().partition(" ")
        if name not in FAMILIES or name in found:
            raise CalibError(
                f"--sizes was given as \"{sizes}\"; it must be '{_NONE}', or sizes with commas between them such as "
                f'"length 0.5 mm, angle 3 mrad", each once of {choices(FAMILIES)}.'
            )
        unit = FAMILIES[name].unit
        found[name] = parse_amount(value, f"--sizes, {name}", unit.quantity, unit.example)
    return found


def parse_errors(pairs: Iterable[str], known: Iterable[Parameter]) -> tuple[tuple[str, float], ...]:
    """``--error`` as values of single errors, in their units: ``elbow_joint.rx=2 mrad`` each."""
    from calib.model.families import unit_of

    units = {parameter.name: parameter.unit for parameter in known}
    found: dict[str, float] = {}
    for pair in pairs:
        name, equals, value = (part.strip() for part in pair.rpartition("="))
        if not (name and equals and value) or name in found:
            raise CalibError(
                f"--error was given '{pair}'; it must be 'name=value' with a unit, such as 'elbow_joint.rx=2 mrad', "
                "and each name once."
            )
        if name not in units:
            raise CalibError(
                f"--error '{pair}': the robot has no error '{name}' in this model{did_you_mean(name, units)}. It has "
                f"{choices(units)}; calib inspect prints all, --model chooses others."
            )
        unit = unit_of(units[name])
        found[name] = parse_amount(value, "--error", unit.quantity, unit.example, signed=True)
    return tuple(found.items())


def noise_of(cell: Cell, noise: str | None, repeatability: str | None) -> TrackerNoise | None:
    """The noise that the line says, ``15 um + 6 um/m``, ``0.05 mm`` or ``none``, else the cell's; None: none at all."""
    from calib.data.surroundings import TrackerNoise, parse_noise

    found = TrackerNoise() if cell.tracker is None else cell.tracker.noise
    if noise is None and cell.sigma is not None:
        found = TrackerNoise(cell.sigma, 0.0, 0.0)
    constant, per_length, own = found.constant, found.per_length, found.repeatability
    if noise is not None:
        constant = per_length = own = 0.0
        if noise.strip() not in (_NONE, "0"):
            # Read beside a repeatability, so that a noise of "0 mm" is not refused as such.
            read = parse_noise(noise, "--noise", 1.0)
            constant, per_length = read.constant, read.per_length
    if repeatability is not None:
        own = parse_amount(repeatability, "--repeatability", "a length", "0.02 mm")
    return TrackerNoise(constant, per_length, own) if constant or per_length or own else None


def angle_noise_of(cell: Cell, said: str | None, *, any_noise: bool) -> float:
    """The noise of an orientation: as said, the cell's, or a tracker's 6D probe's; none where there is no noise."""
    from calib.data.kinds import get as kind_of

    if said is not None:
        if not kind_of(cell.kind or "point").angles:
            raise CalibError(
                "--angle-noise is the noise of orientations; they are measured with --kind pose."
            )
        return parse_amount(said, "--angle-noise", "an angle", "0.01 deg")
    if not any_noise:
        return 0.0
    return math.radians(_PROBE_DEG) if cell.sigma_angle is None else cell.sigma_angle


def parse_encoder(texts: Iterable[str]) -> Encoder:
    """``--encoder``: the step of joints that turn, ``0.001 deg``, and of those that slide, ``0.01 mm``."""
    from calib.simulation.truth import Encoder

    steps = ", ".join(texts)
    length, angle = parse_pair(steps, "--encoder", "0.001 deg") if steps else (None, None)
    return Encoder(angle or 0.0, length or 0.0)


def parse_outliers(text: str | None, size: str | None = None) -> Outliers | None:
    """``--outliers``: a number of rows, ``3``, or a share of them, ``5 %``; and ``--outlier-size``."""
    from calib.simulation.truth import Outliers

    if text is None and size is not None:
        raise CalibError(
            "--outlier-size says how far outliers are off; say how many there are, such as --outliers 3."
        )
    if text is None:
        return None
    off = parse_amount(size or "5 mm", "--outlier-size", "a length", "5 mm")
    number = re.fullmatch(r"\s*(\d{1,9}|\d*\.?\d+(?=\s*%))\s*(%?)\s*", text)
    if number is None or (number[2] and float(number[1]) > 100.0):
        raise CalibError(
            f'--outliers was given as "{text}"; it must be a number of rows, such as "3", or a share of those to '
            'estimate from, such as "5 %", 100 % at most.'
        )
    if number[2]:
        return Outliers(share=float(number[1]) / 100.0, size=off)
    return Outliers(count=int(number[1]), size=off)


def parse_moved(text: str | None) -> MovedTarget | None:
    """``--moved-target``: ``25: 0 0 0.5 mm``, or with the target's name, ``25 upper: 0 0 0.5 mm``."""
    from calib.simulation.truth import MovedTarget

    if text is None:
        return None
    match = re.fullmatch(r"\s*(\d{1,9})(?:\s+(\S.*?))?\s*:\s*(\S.*)", text)
    if match is None:
        raise CalibError(
            f'--moved-target was given as "{text}"; it must be the first row that finds it moved, and by how much '
            'along the tip\'s axes, such as "25: 0 0 0.5 mm"; with the name of one of several targets "25 upper: 0 0 '
            '0.5 mm".'
        )
    return MovedTarget(int(match[1]), parse_point(match[3], "--moved-target"), match[2])


def next_command(robot: str, table: Path, setup: CellOptions) -> str:
    """The command that fits what was simulated, in lines that a shell joins again."""
    from calib.text.plan import command_text

    parts = [shlex.join(["calib", "fit", robot, str(table)])]
    for name, value in asdict(setup).items():
        if value is not None and name != "model":
            values = value if isinstance(value, list) else [value]
            parts += [shlex.join([f"--{name}", str(one)]) for one in values]
    return command_text([*parts, "-o corrected.urdf"], 9)
