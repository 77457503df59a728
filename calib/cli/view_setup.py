"""Which view a call of ``calib view`` asks for: robots, poses, targets, and the errors that `calib evaluate` finds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.setup import check_chain, load, load_with_data, say_ignored, with_target_link

if TYPE_CHECKING:
    from calib.identify.evaluation import Evaluation
    from calib.identify.result import Calibration
    from calib.identify.setup import Setup
    from calib.measure.cell import Cell
    from calib.measure.measurements import Measurements
    from calib.model.robot import Robot
    from calib.show.view import View

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
    from calib.show.view import view_of_robots

    stored = None
    if sources.calibration is not None:
        from calib.identify.result_file import read_result

        stored = read_result(sources.calibration)
        check_chain(cell, stored, str(sources.calibration))
        cell = replace(
            cell,
            base=cell.base or stored.nominal.base,
            tip=cell.tip or stored.nominal.tip,
            held={**stored.nominal.held, **cell.held},
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
    known = nominal_known = None if stored is None else stored.setup
    if stored is not None and sources.other is None:
        nominal_known = stored.nominal_setup
    which = tuple(
        what
        for what, given in (("frame", sources.frame_given), ("target", sources.target_given))
        if not given
    )
    shown = view_of_robots(
        first,
        second,
        names=_names(first, sources),
        evaluations=None
        if rows is None
        else _evaluations(first, second, rows, cell, (nominal_known, known), which),
        flagged=_flagged(stored, rows),
        title=first.name if second is None else "",
        verdict=_verdict(stored)[0],
        note=_verdict(stored)[1],
    )
    return shown if rows is not None else _with_targets(shown, cell, (nominal_known, known), which)


def _robots(arm: Robot, sources: Sources, stored: Calibration | None) -> tuple[Robot, Robot | None]:
    """The two URDFs, or the one with a result's origins before and after, or the one."""
    if sources.other is not None:
        from calib.model.robot import Robot

        return arm, Robot.load(sources.other, arm.base, arm.tip, held=arm.held)
    if stored is not None:
        return stored.uncorrected(arm), stored.corrected(arm)
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


def _evaluations(
    first: Robot,
    second: Robot | None,
    rows: Measurements,
    cell: Cell,
    known: tuple[Setup | None, Setup | None],
    which: tuple[str, ...],
) -> tuple[Evaluation, Evaluation | None]:
    """The errors of each robot: each with the frames and targets that its errors are given with elsewhere."""
    from calib.identify.evaluation import evaluate

    def errors(robot: Robot, its: Setup | None) -> Evaluation:
        own = _with_own_target(robot, cell) if its is None else cell
        return evaluate(robot, rows, own, known=its, which=which)

    return errors(first, known[0]), None if second is None else errors(second, known[1])


def _with_own_target(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF carries, where none was given."""
    given = cell.target is not None or cell.targets
    return cell if given else with_target_link(robot, cell)


def _with_targets(
    view: View, cell: Cell, known: tuple[Setup | None, Setup | None], which: tuple[str, ...]
) -> View:
    """The view of robots that were not measured, with the target in the tip where it is known."""
    from calib.show.view import translated

    places = {}
    for who, robot in view.robots.items():
        its = known[0] if who == "nominal" else known[1]
        if its is not None and "target" in which:
            places[who] = its.T_tip_target[0]
        else:
            own = _with_own_target(robot, cell)
            points = [*own.targets.values(), *([own.target] if own.target is not None else [])]
            places[who] = translated(points[0] if points else (0.0, 0.0, 0.0))
    return replace(
        view,
        nominal_target=places["nominal"],
        calibrated_target=places.get("calibrated", places["nominal"]),
    )


def _flagged(result: Calibration | None, rows: Measurements | None) -> frozenset[int]:
    """Rows that the result flagged, if it was made from this table."""
    if rows is None or result is None or result.source.sha256 != rows.sha256:
        return frozenset()
    return frozenset(one.row for one in (*result.outliers, *result.suspects))


def _verdict(result: Calibration | None) -> tuple[str, str]:
    """The result's verdict, and what it stands on first."""
    if result is None or result.verdict is None:
        return "", ""
    return result.verdict.use, " ".join(map(str, result.verdict.reasons[:1]))
