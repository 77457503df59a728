"""``calib evaluate``: how far a robot is off, without changing it."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.identify.evaluation import Evaluation
    from calib.identify.result_file import StoredResult
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

_HELP = """Compare a robot with measurements.

\b
Examples:
  calib evaluate corrected.urdf data.csv --calibration result.json
  calib evaluate robot.urdf fresh.csv --base base --tip tool0 --target "70 -70 22.5 mm"

With --calibration, target and measurement frame are those of that result, and the robot is evaluated twice: as its
URDF is, and with the result's joint origins. Without it, what is not given is registered to the rows: the target
(unless the URDF has the link that 'calib fit --target-link' adds), and with --frame estimate the frame.
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

        from calib.cli.setup import check_outputs, load_with_data, read_cell, say_ignored
        from calib.identify.evaluation import evaluate as evaluate_robot
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
            _check_chain(setup, stored, str(calibration))
            setup = replace(
                setup,
                base=setup.base or stored.base,
                tip=setup.tip or stored.tip,
                target=stored.target if target is None else setup.target,
                T_frame_base=stored.T_frame_base if frame is None else setup.T_frame_base,
            )
        arm, table = load_with_data(robot, setup, data, columns, points, points_unit)
        source = "as given" if stored is None or target is not None else "as the result has it"
        if setup.target is None and not setup.targets:
            setup, source = (
                _with_target_link(arm, setup),
                "as the URDF's link 'calib_target' has it",
            )
        as_it_is = evaluate_robot(arm, table, setup)
        corrected = None if stored is None else evaluate_robot(stored.corrected(arm), table, setup)
        written = (
            None
            if json is None
            else write_table(evaluation_table(as_it_is, corrected), json, overwrite=force)
        )
        if quiet:
            return
        say_ignored(table, arm)
        results = {"the URDF as it is": as_it_is}
        if corrected is not None:
            results[f"with the joint origins of {Path(str(calibration)).name}"] = corrected
        typer.echo(_text(results, source))
        advice = "" if stored is not None else hint(as_it_is, setup)
        if advice:
            typer.echo("\n" + textwrap.fill(advice, 100, break_on_hyphens=False))
        if written is not None:
            typer.echo(f"\nWritten: {written}")


def _check_chain(cell: Cell, stored: StoredResult, name: str) -> None:
    """Refuse another base or tip than the result's: its frame and its target would mean something else."""
    for option, given, wanted in (("base", cell.base, stored.base), ("tip", cell.tip, stored.tip)):
        if given is not None and given != wanted:
            message = (
                f"{name} is the result for --{option} {wanted}, and '{given}' was given; leave out --{option}, or "
                f"--calibration."
            )
            raise CalibError(message)


def _with_target_link(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF's link ``calib_target`` carries, if it has one at this tip."""
    from calib.identify.result import TARGET_LINK

    if robot.tip == TARGET_LINK:
        return cell.with_target((0.0, 0.0, 0.0), estimate=cell.estimate_target)
    if TARGET_LINK not in robot.urdf.links:
        return cell
    with_link = robot.rebuilt(tip=TARGET_LINK)
    if with_link.joint_names != robot.joint_names:
        return cell
    T_last_target, T_last_tip = with_link.placements[-1], robot.placements[-1]
    point = T_last_tip[:3, :3].T @ (T_last_target[:3, 3] - T_last_tip[:3, 3])
    return cell.with_target(point, estimate=cell.estimate_target)


def _text(results: dict[str, Evaluation], source: str) -> str:
    """The errors of each robot as a table; ``source`` says where the target is from, if it was not registered."""
    from calib.identify.summary import error_head, error_row

    first = next(iter(results.values()))
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
    lines += ["", error_head()]
    for label, result in results.items():
        lines.append(textwrap.shorten(label, 99, placeholder="...") + ":")
        for name, errors in result.errors.items():
            if errors.n and not (
                name == "all"
                and errors.n in (result.errors["estimation"].n, result.errors["validation"].n)
            ):
                lines.append(error_row(f"  {name} rows", errors))
    return "\n".join(lines)


evaluate.__doc__ = _HELP
