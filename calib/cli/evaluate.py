"""``calib evaluate``: how far a robot is off, without changing it."""

from __future__ import annotations

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
    Quiet,
    RobotFile,
    Target,
    Tip,
    reporting,
)

if TYPE_CHECKING:
    from calib.identify.evaluation import Evaluation
    from calib.measure.cell import Cell
    from calib.model.robot import Robot

_HELP = """Compare a robot with measurements.

\b
Examples:
  calib evaluate corrected.urdf data.csv --calibration result.json
  calib evaluate robot.urdf fresh.csv --base base --tip tool0 --target "70 -70 22.5 mm"

With --calibration, target and measurement frame are those of that result, and the robot is evaluated twice: as its
URDF is, and with the result's joint origins. Without it, what is not given is registered to the rows: the target, and
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
        from calib.identify.result_file import errors_table, read_result, write_table

        check_outputs([json], [robot, data, *(p for p in (cell, calibration) if p)], force=force)
        setup = read_cell(cell, base=base, tip=tip, target=target, frame=frame, model=None)
        stored = None if calibration is None else read_result(calibration)
        if stored is not None:
            setup = replace(
                setup,
                base=setup.base or stored.base,
                tip=setup.tip or stored.tip,
                target=stored.target if target is None else setup.target,
                T_frame_base=stored.T_frame_base if frame is None else setup.T_frame_base,
            )
        arm, table = load_with_data(robot, setup, data, columns)
        if setup.target is None:
            setup = _with_target_link(arm, setup)
        results = {"the URDF as it is": evaluate_robot(arm, table, setup)}
        if stored is not None:
            label = f"with the joint origins of {Path(str(calibration)).name}"
            results[label] = evaluate_robot(stored.corrected(arm), table, setup)
        if not quiet:
            say_ignored(table)
            typer.echo(_text(results))
        if json is not None:
            errors = {
                label: {name: errors_table(e) for name, e in result.errors.items()}
                for label, result in results.items()
            }
            written = write_table({"errors": errors}, json, overwrite=force)
            if not quiet:
                typer.echo(f"\nWritten: {written}")


def _with_target_link(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF's link ``calib_target`` carries, if it has one at this tip."""
    from calib.identify.calibration import TARGET_LINK
    from calib.model.robot import Robot as RobotClass

    if TARGET_LINK not in robot.urdf.links or robot.tip == TARGET_LINK:
        return cell
    with_link = RobotClass.from_urdf(robot.urdf, robot.base, TARGET_LINK)
    if with_link.joint_names != robot.joint_names:
        return cell
    T_last_target, T_last_tip = with_link.placements[-1], robot.placements[-1]
    point = T_last_tip[:3, :3].T @ (T_last_target[:3, 3] - T_last_tip[:3, 3])
    return cell.with_target(point, estimate=cell.estimate_target)


def _text(results: dict[str, Evaluation]) -> str:
    """The errors of each robot as a table."""
    from calib.identify.summary import error_head, error_row

    first = next(iter(results.values()))
    place = ", ".join(f"{1e3 * v:.3f}" for v in first.target)
    how = "registered to the rows" if "target" in first.registered else "as given"
    lines = [f"Target at ({place}) mm in {first.robot.tip}, {how}."]
    if "frame" in first.registered:
        lines.append("Measurement frame: registered to the rows.")
    lines += ["", error_head()]
    for label, result in results.items():
        lines.append(f"{label}:")
        for name, errors in result.errors.items():
            if errors.n and not (
                name == "all"
                and errors.n in (result.errors["estimation"].n, result.errors["validation"].n)
            ):
                lines.append(error_row(f"  {name} rows", errors))
    return "\n".join(lines)


evaluate.__doc__ = _HELP
