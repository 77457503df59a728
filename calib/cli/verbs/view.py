"""``calib view``: robots and measurements in the browser, or as a page."""

from __future__ import annotations

import signal
import sys
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
    from calib.viewer.view import View


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
before and after it. --data adds the measured points and goes through the poses of the table.

The page is served to this computer only, until Ctrl-C; -o writes it as a file instead, which opens without calib.
""")
def view(
    robot: RobotFile,
    setup: _Options,
    table: TableOptions,
    other: Annotated[
        str | None,
        typer.Argument(metavar="[OTHER]", help="The calibrated robot's URDF, shown beside it."),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="CSV table of joint values and measured points."),
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
            min=0,
            max=65535,
            metavar="N",
            help="Port of 127.0.0.1 to serve at. Default: any that is free.",
        ),
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Do not open the browser.")
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import check_outputs
    from calib.viewer.page import view_page

    if output is not None and port is not None:
        raise CalibError("-o writes the page as a file, --port serves it; leave out one of them.")
    files = (other, data, setup.cell, calibration, table.points)
    check_outputs([output], [robot, *(path for path in files if path)], force=force)
    shown = _shown(robot, other, data, calibration, setup, table)
    if output is None:
        _serve(shown, port or 0, browser=not no_browser, quiet=quiet)
        return
    page = view_page(shown)
    page.write(output, overwrite=force)
    if not quiet:
        typer.echo("\n".join([*map(_not_drawn, page.warnings), f"Written: {output}"]))


def _shown(
    robot: str,
    other: str | None,
    data: Path | None,
    calibration: Path | None,
    setup: _Options,
    table: TableOptions,
) -> View:
    """What the files say."""
    import calib.cli.setup as files
    from calib.result.calibration_file import read_result
    from calib.robot.robot import Robot
    from calib.viewer.view import view_of_result, view_of_robots

    if other is not None and calibration is not None:
        raise CalibError("OTHER and --calibration are both the second robot; leave out one.")
    if data is None and any((*asdict(table).values(), setup.kind, setup.frame)):
        raise CalibError("--points, --columns, --kind, --frame: name the table with --data.")
    cell = files.read_cell(**asdict(setup))
    result = None if calibration is None else read_result(calibration)
    if result is not None:
        files.check_chain(cell, result, str(calibration))
        own = result.nominal
        cell = replace(cell, base=own.base, tip=own.tip, held={**own.held, **cell.held})
    if data is None:
        arm, rows = files.load(robot, cell), None
    else:
        arm, rows = files.load_with_data(robot, cell, data, **asdict(table))
    if result is not None and calibration is not None:
        known = [name for name in ("frame", "target") if getattr(setup, name) is None]
        return view_of_result(result, arm, rows, cell, known=known, source=calibration.name)
    second = None if other is None else Robot.load(other, arm.base, arm.tip, held=arm.held)
    both = [arm] if second is None else [arm, second]
    given = cell.target is not None or cell.targets
    cells = [cell if given else files.with_target_link(one, cell) for one in both]
    words = ("Nominal", "Calibrated") if second else (arm.name or "Robot", "")
    names = [(word, Path(one.urdf.source).name) for word, one in zip(words, both, strict=False)]
    return view_of_robots(arm, second, rows, cells=cells, names=names)


def _serve(shown: View, port: int, *, browser: bool, quiet: bool) -> None:
    """Show the page until Ctrl-C, or until the process is asked to end."""
    from calib.viewer.live import Viewer

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Viewer(shown, port=port) as viewer:
        url, at = viewer.url, viewer.port
        lines = [f"The picture is at {url} on this computer. Ctrl-C stops it."]
        try:
            if browser and not viewer.open():
                lines.append(f"No browser found. From elsewhere: ssh -L {at}:127.0.0.1:{at} HOST")
            if not quiet:
                typer.echo("\n".join([*map(_not_drawn, viewer.warnings), *lines]))
                sys.stdout.flush()
            viewer.wait()
        except KeyboardInterrupt:
            pass
    if not quiet:
        typer.echo("Stopped.")


def _not_drawn(warning: str) -> str:
    """A line about a shape."""
    return f"Not drawn as in the URDF: {warning}"
