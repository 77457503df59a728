"""``calib evaluate``: how far a robot is off, without changing it."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from calib.cli.options import (
    Base,
    CellFile,
    Columns,
    DataFile,
    Debug,
    Force,
    Frame,
    Hold,
    MeasuredKind,
    PointsFile,
    PointsUnit,
    Quiet,
    ResultTarget,
    RobotFile,
    Tip,
    reporting,
)
from calib.cli.setup import parse_pair
from calib.errors import CalibError, choices

if TYPE_CHECKING:
    from calib.identify.evaluation import Evaluation
    from calib.identify.result import Calibration
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot

_HELP = """Compare a robot with measurements, and hold its accuracy against a tolerance.

\b
Examples:
  calib evaluate corrected.urdf data.csv --calibration result.json
  calib evaluate robot.urdf fresh.csv --base base --tip tool0 --target "70 -70 22.5 mm"
  calib evaluate corrected.urdf fresh.csv --calibration result.json --tolerance "0.5 mm"

With --calibration, targets, measurement frames and held joints are those of that result, and the robot is evaluated
as its URDF is, with the origins that the result began with, with those it found, and with its larger model if it has
one. Without it, what is not given is registered to the rows: the target (unless the URDF has the link that
'calib fit --target-link' adds), and with --frame estimate the frame.

With --tolerance the pose accuracy of ISO 9283 is judged: the exit code is 0 if it is shown to be within the tolerance,
and 3 if not. Judge on rows that the calibration was not fitted to.
"""


class Judge(str, Enum):
    """Which robot is judged."""

    nominal = "nominal"
    urdf = "urdf"
    calibration = "calibration"
    larger = "larger"


class Criterion(str, Enum):
    """What is held against the tolerance."""

    max = "max"
    mean = "mean"
    single = "single"


#: The robots that a calibration answers for.
_FITTED = ("calibration", "larger")

#: A tolerance that could be typed.
_TOLERANCE = "0.5 mm 0.1 deg"

#: A length [m] and an angle [rad]; None for what is not named.
Pair: TypeAlias = tuple[float | None, float | None]

#: The exit code where a tolerance was not shown to be kept.
NOT_PASSED = 3


def evaluate(
    robot: RobotFile,
    data: DataFile,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Result that 'calib fit --json' wrote.")
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar='"LENGTH [ANGLE]"',
            help='What the accuracy must be within, such as "0.5 mm" or "0.5 mm 0.1 deg".',
        ),
    ] = None,
    uncertainty: Annotated[
        str | None,
        typer.Option(
            metavar='"LENGTH [ANGLE]"',
            help="Expanded uncertainty (k = 2) of what was measured; it counts against the outcome. Default: none.",
        ),
    ] = None,
    criterion: Annotated[
        Criterion | None,
        typer.Option(
            help="What must be within: the AP of every pose (max, default), their mean, or every single repeat."
        ),
    ] = None,
    judge: Annotated[
        Judge | None,
        typer.Option(
            help="Which robot is judged. Default: with the joint origins of --calibration, or else the URDF as it is."
        ),
    ] = None,
    base: Base = None,
    tip: Tip = None,
    target: ResultTarget = None,
    frame: Frame = None,
    kind: MeasuredKind = None,
    points: PointsFile = None,
    points_unit: PointsUnit = None,
    hold: Hold = None,
    columns: Columns = None,
    cell: CellFile = None,
    json: Annotated[Path | None, typer.Option("--json", help="Write the errors as JSON.")] = None,
    force: Force = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug):
        from dataclasses import replace

        import numpy as np

        from calib.cli.evaluate_text import evaluation_text, names_of, own_urdf, unseen_text
        from calib.cli.setup import (
            check_chain,
            check_outputs,
            load_with_data,
            read_cell,
            say_ignored,
            with_target_link,
        )
        from calib.cli.terminal import say
        from calib.identify.acceptance import acceptance
        from calib.identify.acceptance_rows import fitted_rows
        from calib.identify.accuracy import accuracy
        from calib.identify.evaluation import check_measured
        from calib.identify.evaluation_file import (
            acceptance_table,
            accuracy_table,
            evaluation_table,
        )
        from calib.identify.result_file import read_result, write_table

        inputs: list[str | Path] = [
            robot,
            data,
            *(path for path in (cell, calibration, points) if path),
        ]
        check_outputs([json], inputs, force=force)
        limits, sure = _limits(tolerance, uncertainty, criterion, judge)
        setup = read_cell(
            cell, base=base, tip=tip, target=target, frame=frame, kind=kind, hold=hold
        )
        stored = None if calibration is None else read_result(calibration)
        if stored is not None:
            check_chain(setup, stored, str(calibration))
            setup = replace(
                setup,
                base=setup.base or stored.nominal.base,
                tip=setup.tip or stored.nominal.tip,
                held={**stored.nominal.held, **setup.held},
            )
        arm, table = load_with_data(robot, setup, data, columns, points, points_unit)
        check_measured(arm if stored is None else stored.uncorrected(arm), table)
        source = "as given" if stored is None or target is not None else "as the result has it"
        if stored is None and setup.target is None and not setup.targets:
            setup, source = (
                with_target_link(arm, setup),
                "as the URDF's link 'calib_target' has it",
            )

        which = tuple(
            what for what, given in (("frame", frame), ("target", target)) if given is None
        )
        found = _evaluations(arm, table, setup, stored, which)
        seen = np.zeros(len(table), dtype=bool)
        if stored is not None:
            seen = fitted_rows(stored, arm, table, setup)
        name = None if calibration is None else calibration.name
        judged = _judged(judge, found, name)
        figures = {who: accuracy(one, seen=seen) for who, one in found.items()}
        accepted = None
        if tolerance is not None:
            accepted = acceptance(
                found[judged],
                *limits,
                uncertainty=sure[0] or 0.0,
                uncertainty_angle=sure[1] or 0.0,
                criterion=(criterion or Criterion.max).value,
                seen=seen,
            )
        advice = _advice(found, setup, stored, anew=frame is not None or target is not None)
        notes = [
            unseen_text(stored, found[judged], figures[judged])
            if stored is not None and judged in _FITTED
            else "",
            own_urdf(found, judged),
            advice,
        ]
        notes = [note for note in notes if note]
        written = None
        if json is not None:
            content = evaluation_table(
                found["urdf"],
                *(found.get(who) for who in ("calibration", "larger", "nominal")),
            ) | {
                "accuracy": accuracy_table(figures),
                "acceptance": None
                if accepted is None
                else acceptance_table(accepted, judged, names_of(name or "")[judged], notes),
            }
            written = write_table(content, json, overwrite=force)
        if not quiet:
            say_ignored(table, arm)
            say(
                evaluation_text(
                    found,
                    figures,
                    accepted,
                    judged=judged,
                    result=name or "",
                    source=source,
                    notes=notes,
                )
            )
            if advice and accepted is None:
                typer.echo("\n" + textwrap.fill(advice, 100, break_on_hyphens=False))
            if written is not None:
                typer.echo(f"\nWritten: {written}")
    if accepted is not None and not accepted.passed:
        raise typer.Exit(NOT_PASSED)


def _limits(
    tolerance: str | None,
    uncertainty: str | None,
    criterion: Criterion | None,
    judge: Judge | None,
) -> tuple[Pair, Pair]:
    """Tolerances and expanded uncertainties, each of lengths [m] and angles [rad]; None for what is not named.

    Raises:
        CalibError: A text is none of its kind, or there is no tolerance that something could count for.
    """
    given = {"uncertainty": uncertainty, "criterion": criterion, "judge": judge}
    useless = [f"--{name}" for name, value in given.items() if value is not None]
    if tolerance is None and useless:
        raise CalibError(
            f"{' and '.join(useless)} without --tolerance: nothing is judged without one. State it, such as "
            f'--tolerance "{_TOLERANCE}".'
        )
    limits: Pair = (None, None)
    sure: Pair = (None, None)
    if tolerance is not None:
        limits = parse_pair(tolerance, "--tolerance", _TOLERANCE)
    if uncertainty is not None:
        sure = parse_pair(uncertainty, "--uncertainty", "0.05 mm 0.01 deg")
    for limit, stated, what in zip(limits, sure, ("length", "angle"), strict=True):
        if limit is None and stated is not None:
            raise CalibError(
                f'--uncertainty was given as "{uncertainty}", and --tolerance as "{tolerance}", which has no {what}; '
                "state a tolerance for each uncertainty."
            )
    return limits, sure


def _judged(judge: Judge | None, found: Iterable[str], name: str | None) -> str:
    """The key of the robot that is judged.

    Args:
        judge: What was asked for.
        found: The robots that there are.
        name: Name of the result's file.

    Raises:
        CalibError: There is none such.
    """
    who = ("urdf" if name is None else "calibration") if judge is None else judge.value
    if who not in found:
        reason = (
            "takes --calibration"
            if name is None
            else f"is none of {name}, which has no larger model"
        )
        raise CalibError(f"--judge {who} {reason}; choose one of {choices(found)}.")
    return who


def _evaluations(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    result: Calibration | None,
    which: tuple[str, ...],
) -> dict[str, Evaluation]:
    """Of the robot as it is; and of a result's nominal robot, its joint origins, and its larger model if it has one.

    Args:
        robot: The robot.
        table: The rows.
        cell: The set-up.
        result: The result.
        which: Whether its frames and its targets are used, see `calib.identify.evaluation.evaluate`.
    """
    from calib.identify.evaluation import evaluate, evaluate_larger

    if result is None:
        return {"urdf": evaluate(robot, table, cell)}
    larger = evaluate_larger(result, robot, table, cell, which)
    states = {
        "nominal": (result.uncorrected(robot), result.nominal_setup),
        "urdf": (robot, result.setup),
        "calibration": (result.corrected(robot), result.setup),
    }
    found = {
        who: evaluate(one, table, cell, known=known, which=which)
        for who, (one, known) in states.items()
    }
    return {**found, **({} if larger is None else {"larger": larger})}


def _advice(
    found: Mapping[str, Evaluation], cell: Cell, stored: Calibration | None, *, anew: bool
) -> str:
    """A sentence that names a set-up which explains the rows far better, or nothing.

    Args:
        found: What `_evaluations` found.
        cell: The set-up.
        stored: The result.
        anew: Whether frame or target of the result were put aside already.
    """
    from calib.identify.evaluation import hint, moved

    if stored is None:
        return hint(found["urdf"], cell)
    one = found["calibration"]
    return "" if anew else moved(one.robot, one.measurements, cell, stored.setup)


evaluate.__doc__ = _HELP
