"""``calib view``: robots and measurements in the browser, or as a page."""

from __future__ import annotations

import os
import signal
import sys
import textwrap
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import (
    CellOptions,
    Force,
    Quiet,
    ResultTarget,
    RobotFile,
    TableOptions,
    verb,
)
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.estimate.setup import Setup
    from calib.result.evaluation import Evaluation
    from calib.robot.robot import Robot
    from calib.viewer.live import Viewer
    from calib.viewer.view import View

#: So many shapes that are not drawn as they should be are named.
_MOST_WARNINGS = 3

#: What a result says of the measurements, where the line does not.
FOUND = ("frame", "target")


@dataclass(frozen=True, slots=True)
class ViewOptions(CellOptions):
    """The set-up, with the target that a result or a URDF has."""

    target: ResultTarget = None


@verb("""Show robots, and what was measured, in the browser.

\b
Examples:
  calib view robot.urdf --base base
  calib view robot.urdf corrected.urdf --base base --data data.csv
  calib view robot.urdf --calibration result.json --data data.csv -o view.html

One robot, or the nominal and the calibrated side by side: the two URDFs given, or with --calibration the joint origins
before and after it. --data adds the measured points and goes through the poses of the table.

The page is served to this computer only, until Ctrl-C; -o writes it as a file instead, which opens without calib.
""")
def view(
    robot: RobotFile,
    setup: ViewOptions,
    table: TableOptions,
    other: Annotated[
        str | None,
        typer.Argument(
            metavar="[OTHER]", help="The calibrated robot's URDF, shown beside the first."
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            "--data", help="CSV table of joint values and measured points, drawn with the robots."
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="Result that 'calib fit --json' wrote."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write the page as a file, and serve nothing."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Port of 127.0.0.1 to serve the page at. Default: 0, any that is free.",
        ),
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Do not open the browser.")
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import check_outputs, read_cell

    if output is not None and port is not None:
        raise CalibError(
            "--port is where the page is served, and -o writes it as a file; leave out one of them."
        )
    files = (other, data, setup.cell, calibration, table.points)
    check_outputs([output], [robot, *(path for path in files if path)], force=force)
    about = {**asdict(table), "kind": setup.kind, "frame": setup.frame}
    idle = [name.replace("_", "-") for name, value in about.items() if value]
    if data is None and idle:
        raise CalibError(f"--{idle[0]} says how a table is read; name the table with --data.")
    found = tuple(name for name in FOUND if getattr(setup, name) is None)
    cell = read_cell(**asdict(setup))
    shown = asked_view(robot, other, data, calibration, cell, table, found=found, quiet=quiet)
    if output is not None:
        from calib.viewer.page import view_page

        page = view_page(shown)
        page.write(output, overwrite=force)
        if not quiet:
            _say_warnings(page.warnings)
            typer.echo(f"Written: {output}")
        return
    from calib.viewer.live import Viewer

    with Viewer(shown, port=port or 0) as viewer:
        _serve(viewer, browser=not no_browser, quiet=quiet)


def asked_view(
    robot: str,
    other: str | None,
    data: Path | None,
    calibration: Path | None,
    cell: Cell,
    table: TableOptions,
    *,
    found: tuple[str, ...] = FOUND,
    quiet: bool = True,
) -> View:
    """The view that a call asks for: robots, poses, targets, and the errors that `calib evaluate` finds.

    ``found`` are those of ``"frame"`` and ``"target"`` that the result says, for the line does not.

    Raises:
        CalibError: A file cannot be read, or they do not fit together.
    """
    from calib.cli.setup import check_chain, load, load_with_data, say_ignored
    from calib.robot.robot import Robot
    from calib.robot.xacro_file import XacroCall, is_xacro
    from calib.viewer.view import translated, view_of_robots

    result = None
    if calibration is not None:
        from calib.result.calibration_file import read_result

        result = read_result(calibration)
        check_chain(cell, result, str(calibration))
        base, tip = cell.base or result.nominal.base, cell.tip or result.nominal.tip
        cell = replace(cell, base=base, tip=tip, held={**result.nominal.held, **cell.held})
    if data is None:
        rows, arm = None, load(robot, cell)
    else:
        arm, rows = load_with_data(robot, cell, data, **asdict(table))
        if not quiet:
            say_ignored(rows, arm)

    given, second = (
        XacroCall.parse(one).name if is_xacro(one) else Path(one).name
        for one in (robot, other or "")
    )
    robots: list[Robot] = [arm]
    names = ((arm.name or "Robot", given), ("", ""))
    setups: list[Setup | None] = [None if result is None else result.setup] * 2
    if other is not None:
        robots.append(Robot.load(other, arm.base, arm.tip, held=arm.held))
        names = ("Nominal", given), ("Calibrated", second)
    elif result is not None and calibration is not None:
        robots = [result.uncorrected(arm), result.corrected(arm)]
        origins = f"joint origins of {calibration.name}"
        names = ("Nominal", "before the calibration"), ("Calibrated", origins)
        setups[0] = result.nominal_setup
    cells = [_with_own_target(one, cell) for one in robots]

    evaluations: list[Evaluation] = []
    if rows is not None:
        from calib.result.evaluation import evaluate

        # Each with the frames and targets that its errors are given with elsewhere.
        evaluations = [
            evaluate(one, rows, own if its is None else cell, known=its, which=found)
            for one, own, its in zip(robots, cells, setups, strict=False)
        ]
    flagged: frozenset[int] = frozenset()
    if rows is not None and result is not None and result.source.sha256 == rows.sha256:
        flagged = frozenset(one.row for one in (*result.outliers, *result.suspects))
    verdict = None if result is None else result.verdict
    shown = view_of_robots(
        *robots,
        names=names,
        evaluations=(evaluations[0], evaluations[-1]) if evaluations else None,
        flagged=flagged,
        title=robots[0].name if len(robots) == 1 else "",
        verdict="" if verdict is None else verdict.use,
        note="" if verdict is None else " ".join(map(str, verdict.reasons[:1])),
    )
    if rows is not None:
        return shown
    targets = []
    for own, its in zip(cells, setups, strict=False):
        points = [*own.targets.values(), *([own.target] if own.target is not None else [])]
        place = translated(points[0] if points else (0.0, 0.0, 0.0))
        targets.append(its.T_tip_target[0] if its is not None and "target" in found else place)
    return replace(shown, nominal_target=targets[0], calibrated_target=targets[-1])


def _with_own_target(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF carries, where none was given."""
    from calib.cli.setup import with_target_link

    given = cell.target is not None or cell.targets
    return cell if given else with_target_link(robot, cell)


def _serve(viewer: Viewer, *, browser: bool, quiet: bool) -> None:
    """Show the page until Ctrl-C, or until the process is asked to end."""
    # Whoever ends the process means what Ctrl-C means.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if not quiet:
            _say_warnings(viewer.warnings)
            typer.echo(f"The picture is at {viewer.url} on this computer. Ctrl-C stops it.")
        # A browser that would take over the terminal is not asked.
        windows = sys.platform in ("win32", "darwin") or any(
            os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
        )
        if browser and not (windows and viewer.open()) and not quiet:
            at = viewer.port
            typer.echo(
                "No browser was found; open that address. From another computer: "
                f"ssh -L {at}:127.0.0.1:{at} and this one's name."
            )
        sys.stdout.flush()
        viewer.wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()
        signal.signal(signal.SIGTERM, before)
    if not quiet:
        typer.echo("Stopped.")


def _say_warnings(warnings: tuple[str, ...]) -> None:
    """What could not be drawn as the URDF says: the first few; the page names all."""
    lines = [f"Not drawn as in the URDF: {warning}" for warning in warnings[:_MOST_WARNINGS]]
    if len(warnings) > _MOST_WARNINGS:
        lines.append(f"{len(warnings) - _MOST_WARNINGS} more are named on the page.")
    for line in lines:
        typer.echo(textwrap.fill(line, 100, break_on_hyphens=False, subsequent_indent="  "))
