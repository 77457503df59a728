"""Which view a call of ``calib view`` asks for: robots, poses, targets, and the errors that `calib evaluate` finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.cli.known import check_chain, with_target_link
from calib.cli.setup import load, load_with_data, say_ignored

if TYPE_CHECKING:
    from calib.identify.evaluation import Evaluation, Known
    from calib.identify.stored import StoredResult
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot
    from calib.show.scene import View

    Names = tuple[tuple[str, str], tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Sources:
    """What a call names.

    Attributes:
        robot: The first robot's URDF, or its name.
        other: The second one's.
        data: The table.
        calibration: The result file.
        points: A list of points.
        points_unit: Its unit.
        columns: Columns that are renamed.
        frame_given: Whether the line says where the measurement frame is, so that the result's is not taken.
        target_given: Whether the line says where the target is, likewise.
    """

    robot: str
    other: str | None = None
    data: Path | None = None
    calibration: Path | None = None
    points: Path | None = None
    points_unit: str | None = None
    columns: tuple[str, ...] = ()
    frame_given: bool = False
    target_given: bool = False


def view_asked_for(sources: Sources, cell: Cell, *, quiet: bool) -> View:
    """The view that a call asks for.

    Args:
        sources: The files.
        cell: The set-up.
        quiet: Whether rows and columns that are not used go without saying.

    Raises:
        CalibError: A file cannot be read, or they do not fit together.
    """
    from calib.show.pictures import view_of_robots

    table: Mapping[str, Any] = {}
    stored = None
    if sources.calibration is not None:
        from calib.identify.result_file import read_table, stored_result

        table = read_table(sources.calibration)
        stored = stored_result(table, sources.calibration)
        check_chain(cell, stored, str(sources.calibration))
        cell = replace(
            cell,
            base=cell.base or stored.base,
            tip=cell.tip or stored.tip,
            held={**stored.held, **cell.held},
        )
    if sources.data is None:
        rows, arm = None, load(sources.robot, cell)
    else:
        arm, rows = load_with_data(
            sources.robot, cell, sources.data, sources.columns, sources.points, sources.points_unit
        )
        if not quiet:
            say_ignored(rows, arm)
    first, second = _robots(arm, sources, stored)
    known = None if stored is None else _known(sources, stored.known)
    nominal_known = known
    if stored is not None and sources.other is None and stored.nominal_known is not None:
        nominal_known = _known(sources, stored.nominal_known)
    shown = view_of_robots(
        first,
        second,
        names=_names(first, sources),
        evaluations=None
        if rows is None
        else _evaluations(first, second, rows, cell, nominal_known, known),
        flagged=_flagged(table, rows),
        title=first.name if second is None else "",
        verdict=_verdict(table)[0],
        note=_verdict(table)[1],
    )
    return shown if rows is not None else _with_targets(shown, cell, nominal_known, known)


def _robots(
    arm: Robot, sources: Sources, stored: StoredResult | None
) -> tuple[Robot, Robot | None]:
    """The two URDFs, or the one with a result's origins before and after, or the one."""
    if sources.other is not None:
        from calib.model.robot import Robot

        return arm, Robot.load(sources.other, arm.base, arm.tip, held=arm.held)
    if stored is not None:
        return stored.nominal(arm), stored.corrected(arm)
    return arm, None


def _names(first: Robot, sources: Sources) -> Names:
    """What the robots are called, and what that means."""
    given = _file_name(sources.robot)
    if sources.other is not None:
        return ("Nominal", given), ("Calibrated", _file_name(sources.other))
    if sources.calibration is not None:
        name = sources.calibration.name
        return ("Nominal", "before the calibration"), ("Calibrated", f"joint origins of {name}")
    return (first.name or "Robot", given), ("", "")


def _file_name(source: str) -> str:
    """A file without its folder; a xacro's with its arguments."""
    from calib.model.xacro_file import XacroCall, is_xacro

    return XacroCall.parse(source).name if is_xacro(source) else Path(source).name


def _known(sources: Sources, known: Known) -> Known:
    """A result's frames and targets, but for what the line says."""
    nothing: dict[str, Any] = {
        **({"frames": {}} if sources.frame_given else {}),
        **({"targets": {}} if sources.target_given else {}),
    }
    return replace(known, **nothing)


def _evaluations(
    first: Robot,
    second: Robot | None,
    rows: Measurements,
    cell: Cell,
    nominal_known: Known | None,
    known: Known | None,
) -> tuple[Evaluation, Evaluation | None]:
    """The errors of each robot: each with the frames and targets that its errors are given with elsewhere."""
    from calib.identify.evaluation import evaluate

    def errors(robot: Robot, its: Known | None) -> Evaluation:
        own = _with_own_target(robot, cell) if its is None else cell
        return evaluate(robot, rows, own, known=its)

    return errors(first, nominal_known), None if second is None else errors(second, known)


def _with_own_target(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF carries, where none was given."""
    given = cell.target is not None or cell.targets
    return cell if given else with_target_link(robot, cell)


def _with_targets(view: View, cell: Cell, nominal_known: Known | None, known: Known | None) -> View:
    """The view of robots that were not measured, with the target in the tip where it is known."""
    from calib.show.view import translated

    places = {}
    for who, robot in view.robots.items():
        its = nominal_known if who == "nominal" else known
        if its is not None and its.targets:
            places[who] = next(iter(its.targets.values()))
        else:
            own = _with_own_target(robot, cell)
            points = [*own.targets.values(), *([own.target] if own.target is not None else [])]
            places[who] = translated(points[0] if points else (0.0, 0.0, 0.0))
    return replace(
        view,
        nominal_target=places["nominal"],
        calibrated_target=places.get("calibrated", places["nominal"]),
    )


def _flagged(table: Mapping[str, Any], rows: Measurements | None) -> frozenset[int]:
    """Rows that the result flagged, if it was made from this table."""
    if rows is None or not table or table["inputs"]["measurements"]["sha256"] != rows.sha256:
        return frozenset()
    return frozenset(int(one["row"]) for one in (*table["outliers"], *table["suspects"]))


def _verdict(table: Mapping[str, Any]) -> tuple[str, str]:
    """The result's verdict, and what it stands on first."""
    verdict = table.get("verdict")
    if not verdict:
        return "", ""
    return str(verdict["use"]), " ".join(verdict["reasons"][:1])
