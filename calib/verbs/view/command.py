"""``calib view``: robots and measurements in the browser, or as a page."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import CellOptions, Force, Quiet, ResultTarget, RobotFile, TableOptions
from calib.cli.outputs import check_outputs
from calib.cli.setup import (
    load,
    load_with_data,
    read_cell,
    with_chain_of_result,
    with_target_link,
)
from calib.cli.verb import verb
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.robot.robot import Robot
    from calib.verbs.view.view import View


@dataclass(frozen=True, slots=True)
class SetupOptions(CellOptions):
    """Frames, targets and cameras; by default the targets of the result, or of the URDF if it has any."""

    target: ResultTarget = None


@verb("""Show robots and measurements in the browser.

\b
Examples:
  calib view robot.urdf --base base
  calib view robot.urdf corrected.urdf --base base --data data.csv
  calib view robot.urdf --calibration result.json --data data.csv -o view.html

One robot, or the nominal and the calibrated side by side: the two URDFs given, or with --calibration the joint origins
before and after it. --data adds the measured points. The page is a file that opens without calib: the one given with
-o, or a temporary one, which the browser opens, if there is one.
""")
def view(
    robot: RobotFile,
    setup: SetupOptions,
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
        Path | None, typer.Option("-o", "--output", help="Write the page to this file.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Load the robots and the table, write the page, and open it if it is a temporary file."""
    if other is not None and calibration is not None:
        raise CalibError("OTHER and --calibration are both the second robot; leave out one.")
    if data is None and any((*asdict(table).values(), setup.kind, setup.frame)):
        raise CalibError("--points, --columns, --kind, --frame: name the table with --data.")
    inputs = [robot, other, data, setup.cell, calibration, table.points]
    check_outputs([output], inputs, force=force)
    cell = read_cell(**asdict(setup))
    if calibration is None:
        arm, measurements = _load(robot, cell, data, table)
        shown = _view_of_robots(arm, other, measurements, cell)
    else:
        shown = _view_of_result(robot, cell, setup, data, table, calibration)
    from calib.verbs.view.page import view_page, write_or_open

    page = view_page(shown)
    written = write_or_open(page, output, overwrite=force)
    if not quiet:
        for warning in page.warnings:
            typer.echo(f"Not drawn as in the URDF: {warning}")
        typer.echo(f"Written: {written}")


def _load(
    robot: str,
    cell: Cell,
    data: Path | None,
    table: TableOptions,
) -> tuple[Robot, Measurements | None]:
    """Load the robot, and the table if there is one."""
    if data is None:
        return load(robot, cell), None
    return load_with_data(robot, cell, data, table)


def _view_of_result(
    robot: str,
    cell: Cell,
    setup: SetupOptions,
    data: Path | None,
    table: TableOptions,
    calibration: Path,
) -> View:
    """Return the view of a result: the robot with the joint origins before and after it."""
    from calib.result.calibration_file import read_result
    from calib.verbs.view.view import view_of_result

    result = read_result(calibration)
    cell = with_chain_of_result(cell, result, str(calibration))
    arm, measurements = _load(robot, cell, data, table)
    from_result = [name for name in ("frame", "target") if getattr(setup, name) is None]
    return view_of_result(
        result, arm, measurements, cell, known=from_result, source=calibration.name
    )


def _view_of_robots(
    arm: Robot,
    other: str | None,
    measurements: Measurements | None,
    cell: Cell,
) -> View:
    """Return the view of one URDF or of two."""
    from calib.verbs.view.view import view_of_robots

    second = None
    if other is not None:
        second = load(other, replace(cell, base=arm.base, tip=arm.tip))
    cells = [cell, cell]
    if cell.target is None and not cell.targets:
        cells = [with_target_link(shown, cell) for shown in (arm, second or arm)]
    return view_of_robots(arm, second, measurements, cells=cells)
