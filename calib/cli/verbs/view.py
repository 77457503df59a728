"""``calib view``: robots and measurements in the browser, or as a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import CellOptions, Force, Quiet, ResultTarget, RobotFile, TableOptions, verb
from calib.errors import CalibError


@dataclass(frozen=True, slots=True)
class _Options(CellOptions):
    """The set-up; targets are those of the result or of the URDF where it has them."""

    target: ResultTarget = None


@verb("""Show robots, and what was measured, in the browser.

\b
Examples:
  calib view robot.urdf --base base
  calib view robot.urdf corrected.urdf --base base --data data.csv
  calib view robot.urdf --calibration result.json --data data.csv -o view.html

One robot, or the nominal and the calibrated side by side: the two URDFs given, or with --calibration the joint origins
before and after it. --data adds the measured points. The page is served to this computer only, until Ctrl-C; -o writes
it as a file, which opens without calib.
""")
def view(
    robot: RobotFile,
    setup: _Options,
    table: TableOptions,
    other: Annotated[
        str | None, typer.Argument(metavar="[OTHER]", help="The calibrated robot's URDF.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="CSV table of joint values and measured points.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Result that 'calib calibrate --json' wrote.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the page as a file.")
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, metavar="N", help="Port of 127.0.0.1; 0: any.")
    ] = 0,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Do not open the browser.")
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    import calib.cli.setup as words
    from calib.result.calibration_file import read_result
    from calib.viewer.page import serve, view_page
    from calib.viewer.view import view_of_result, view_of_robots

    if other is not None and calibration is not None:
        raise CalibError("OTHER and --calibration are both the second robot; leave out one.")
    if data is None and any((*asdict(table).values(), setup.kind, setup.frame)):
        raise CalibError("--points, --columns, --kind, --frame: name the table with --data.")
    files = (other, data, setup.cell, calibration, table.points)
    words.check_outputs([output], [robot, *(path for path in files if path)], force=force)
    cell = words.read_cell(**asdict(setup))
    if calibration is not None:
        result = read_result(calibration)
        words.check_chain(cell, result, str(calibration))
        own = result.nominal
        cell = replace(cell, base=own.base, tip=own.tip, held={**own.held, **cell.held})
    arm, rows = words.load(robot, cell), None
    if data is not None:
        arm, rows = words.load_with_data(robot, cell, data, **asdict(table))
    if calibration is not None:
        known = [name for name in ("frame", "target") if getattr(setup, name) is None]
        shown = view_of_result(result, arm, rows, cell, known=known, source=calibration.name)
    else:
        second = words.load(other, replace(cell, base=arm.base, tip=arm.tip)) if other else None
        given = cell.target is not None or cell.targets
        both = (arm, second or arm)
        cells = [cell if given else words.with_target_link(one, cell) for one in both]
        shown = view_of_robots(arm, second, rows, cells=cells)
    say: Callable[[str], None] = (lambda _: None) if quiet else partial(print, flush=True)
    if output is None:
        serve(shown, port=port, browser=not no_browser, say=say)
        return
    page = view_page(shown)
    page.write(output, overwrite=force)
    for text in page.warnings:
        say(f"Not drawn as in the URDF: {text}")
    say(f"Written: {output}")
