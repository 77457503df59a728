"""``calib view``: robots and measurements in the browser, or as a page."""

from __future__ import annotations

import os
import signal
import sys
import textwrap
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.options import (
    Base,
    CellFile,
    Columns,
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
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.show.live import Viewer
    from calib.show.view import View

#: So many shapes that are not drawn as they should be are named.
_MOST_WARNINGS = 3

_HELP = """Show robots, and what was measured, in the browser.

\b
Examples:
  calib view robot.urdf --base base
  calib view robot.urdf corrected.urdf --base base --data data.csv
  calib view robot.urdf --calibration result.json --data data.csv -o view.html

One robot, or the nominal and the calibrated side by side: the two URDFs given, or with --calibration the joint origins
before and after it. --data adds the measured points and goes through the poses of the table.

The page is served to this computer only, until Ctrl-C; -o writes it as a file instead, which opens without calib.
"""


def view(
    robot: RobotFile,
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
    debug: Debug = False,
) -> None:
    """See `_HELP`."""
    with reporting(debug=debug):
        from calib.cli.setup import check_outputs, read_cell
        from calib.cli.view_setup import Sources, view_asked_for

        if output is not None and port is not None:
            raise CalibError(
                "--port is where the page is served, and -o writes it as a file; leave out one of them."
            )
        inputs: list[str | Path] = [
            robot,
            *(path for path in (other, data, cell, calibration, points) if path),
        ]
        check_outputs([output], inputs, force=force)
        about_table = {
            "--points": points,
            "--points-unit": points_unit,
            "--columns": columns,
            "--kind": kind,
            "--frame": frame,
        }
        _check_table(data, about_table)
        setup = read_cell(
            cell, base=base, tip=tip, target=target, frame=frame, kind=kind, hold=hold
        )
        sources = Sources(
            robot=robot,
            other=other,
            data=data,
            calibration=calibration,
            points=points,
            points_unit=points_unit,
            columns=tuple(columns or ()),
            frame_given=frame is not None,
            target_given=target is not None,
        )
        shown = view_asked_for(sources, setup, quiet=quiet)
        if output is not None:
            _write(shown, output, force=force, quiet=quiet)
            return
        from calib.show.live import Viewer

        with Viewer(shown, port=port or 0) as viewer:
            _serve(viewer, browser=not no_browser, quiet=quiet)


def _check_table(data: Path | None, given: dict[str, Any]) -> None:
    """Refuse options that say how a table is read where there is none."""
    idle = [name for name, value in given.items() if value]
    if data is None and idle:
        raise CalibError(f"{idle[0]} says how a table is read; name the table with --data.")


def _write(shown: View, output: Path, *, force: bool, quiet: bool) -> None:
    """The page as a file."""
    from calib.show.page import view_page

    page = view_page(shown)
    page.write(output, overwrite=force)
    if not quiet:
        _say_warnings(page.warnings)
        typer.echo(f"Written: {output}")


def _serve(viewer: Viewer, *, browser: bool, quiet: bool) -> None:
    """Show the page until Ctrl-C, or until the process is asked to end."""
    # Whoever ends the process means what Ctrl-C means.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if not quiet:
            _say_warnings(viewer.warnings)
            typer.echo(f"The picture is at {viewer.url} on this computer. Ctrl-C stops it.")
        if browser and not _opened(viewer.url) and not quiet:
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


def _opened(url: str) -> bool:
    """Whether a browser was asked to show the page; one that would take over the terminal is not."""
    windows = sys.platform in ("win32", "darwin") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    )
    return windows and webbrowser.open(url)


def _say_warnings(warnings: tuple[str, ...]) -> None:
    """What could not be drawn as the URDF says: the first few; the page names all."""
    lines = [f"Not drawn as in the URDF: {warning}" for warning in warnings[:_MOST_WARNINGS]]
    if len(warnings) > _MOST_WARNINGS:
        lines.append(f"{len(warnings) - _MOST_WARNINGS} more are named on the page.")
    for line in lines:
        typer.echo(textwrap.fill(line, 100, break_on_hyphens=False, subsequent_indent="  "))


view.__doc__ = _HELP
