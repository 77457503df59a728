"""``calib evaluate``: how far a robot is off, without changing it."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    RobotFile,
    Target,
    Tip,
    reporting,
)

if TYPE_CHECKING:
    from calib.identify.evaluation import Evaluation
    from calib.identify.statistics import Errors
    from calib.identify.stored import StoredResult
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot

_HELP = """Compare a robot with measurements.

\b
Examples:
  calib evaluate corrected.urdf data.csv --calibration result.json
  calib evaluate robot.urdf fresh.csv --base base --tip tool0 --target "70 -70 22.5 mm"

With --calibration, targets, measurement frames and held joints are those of that result, and the robot is evaluated
as its URDF is, with the result's joint origins, and with its larger model if it has one. Without it, what is not
given is registered to the rows: the target (unless the URDF has the link that 'calib fit --target-link' adds), and
with --frame estimate the frame.
"""


def evaluate(
    robot: RobotFile,
    data: DataFile,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Result that 'calib fit --json' wrote.")
    ] = None,
    base: Base = None,
    tip: Tip = None,
    target: Target = None,
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

        from calib.cli.known import check_chain, with_target_link
        from calib.cli.setup import check_outputs, load_with_data, read_cell, say_ignored
        from calib.identify.evaluation import hint
        from calib.identify.result_file import evaluation_table, read_result, write_table

        inputs: list[str | Path] = [
            robot,
            data,
            *(path for path in (cell, calibration, points) if path),
        ]
        check_outputs([json], inputs, force=force)
        setup = read_cell(
            cell, base=base, tip=tip, target=target, frame=frame, kind=kind, hold=hold
        )
        stored = None if calibration is None else read_result(calibration)
        if stored is not None:
            check_chain(setup, stored, str(calibration))
            setup = replace(
                setup,
                base=setup.base or stored.base,
                tip=setup.tip or stored.tip,
                held={**stored.held, **setup.held},
            )
        arm, table = load_with_data(robot, setup, data, columns, points, points_unit)
        source = "as given" if stored is None or target is not None else "as the result has it"
        if stored is None and setup.target is None and not setup.targets:
            setup, source = (
                with_target_link(arm, setup),
                "as the URDF's link 'calib_target' has it",
            )

        found = _evaluations(arm, table, setup, stored, frame=frame is None, target=target is None)
        written = None
        if json is not None:
            written = write_table(evaluation_table(*found), json, overwrite=force)
        if quiet:
            return
        say_ignored(table, arm)
        name = "" if calibration is None else calibration.name
        typer.echo(_text(found, name, source))
        advice = "" if stored is not None else hint(found[0], setup)
        if advice:
            typer.echo("\n" + textwrap.fill(advice, 100, break_on_hyphens=False))
        if written is not None:
            typer.echo(f"\nWritten: {written}")


def _evaluations(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    stored: StoredResult | None,
    *,
    frame: bool,
    target: bool,
) -> tuple[Evaluation, Evaluation | None, Evaluation | None]:
    """Of the robot as it is, with a result's joint origins, and with its larger model; None where there is none.

    Args:
        robot: The robot.
        table: The rows.
        cell: The set-up.
        stored: The result.
        frame: Whether the result's frames are used.
        target: Whether its targets are.
    """
    from dataclasses import replace

    from calib.identify.evaluation import evaluate

    if stored is None:
        return evaluate(robot, table, cell), None, None
    nothing: dict[str, Any] = {
        **({} if frame else {"frames": {}}),
        **({} if target else {"targets": {}}),
    }
    known = replace(stored.known, **nothing)
    of_larger = None if stored.larger is None else replace(stored.larger.known, **nothing)
    return (
        evaluate(robot, table, cell, known=known),
        evaluate(stored.corrected(robot), table, cell, known=known),
        stored.evaluate_larger(robot, table, cell, of_larger),
    )


def _text(
    found: tuple[Evaluation, Evaluation | None, Evaluation | None], name: str, source: str
) -> str:
    """The errors of each robot as a table.

    Args:
        found: What `_evaluations` found.
        name: Name of the result's file.
        source: Where the targets are from, if they were not registered.
    """
    from calib.identify.statements import error_title
    from calib.identify.summary import angle_head, angle_row, error_head, error_row

    labels = (
        "the URDF as it is",
        f"with the joint origins of {name}",
        f"with the larger model of {name}",
    )
    results = {label: one for label, one in zip(labels, found, strict=True) if one is not None}
    first = found[0]
    how = "registered to the rows" if "target" in first.registered else source
    lines = []
    targets = first.setup.targets
    for name, T in zip(targets, first.setup.T_tip_target, strict=True):
        place = ", ".join(f"{1e3 * v:.3f}" for v in T[:3, 3])
        label = f"Target '{name}'" if len(targets) > 1 else "Target"
        lines.append(textwrap.fill(f"{label} at ({place}) mm in {first.robot.tip}, {how}.", 100))
    if "frame" in first.registered:
        many = "s" if len(first.setup.groups) > 1 else ""
        lines.append(f"Measurement frame{many}: registered to the rows.")
    lines += ["", error_head(error_title(first.used)), *_table(results, error_row, "n")]
    if any(result.errors["all"].n_angle for result in results.values()):
        lines += ["", angle_head(), *_table(results, angle_row, "n_angle")]
    return "\n".join(lines)


def _table(
    results: dict[str, Evaluation], row: Callable[[str, Errors], str], count: str
) -> list[str]:
    """The rows of a table of lengths or angles; ``count`` names the attribute that says how many there are."""
    lines = []
    for label, result in results.items():
        lines.append(textwrap.shorten(label, 99, placeholder="...") + ":")
        sizes = {name: getattr(errors, count) for name, errors in result.errors.items()}
        for name, errors in result.errors.items():
            said = name == "all" and sizes["all"] in (sizes["estimation"], sizes["validation"])
            if sizes[name] and not said:
                lines.append(row(f"  {name} rows", errors))
    return lines


evaluate.__doc__ = _HELP
