"""``calib view``: robots and measurements in the browser, or as a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from calib.cli.loading import (
    load,
    load_with_data,
    with_chain_of_result,
    with_target_link,
)
from calib.cli.options import (
    TARGET_OF_RESULT,
    CellOptions,
    Force,
    Quiet,
    RobotFile,
    TableOptions,
)
from calib.cli.output_files import check_outputs
from calib.cli.verb import verb
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.data.measurements import Measurements
    from calib.robot.robot import Robot
    from calib.verbs.view.view import View


@dataclass(frozen=True, slots=True)
class ViewOptions(CellOptions):
    """Options of the cell; targets are those of the result or of the URDF, if it has any."""

    helps: ClassVar[Mapping[str, str]] = TARGET_OF_RESULT


@verb("""Show robots and measurements in the browser.

\b
Examples:
  calib view robot.urdf --base base
  calib view robot.urdf corrected.urdf --base base --data data.csv
  calib view robot.urdf --calibration result.json --data data.csv -o view.html

One robot, or the nominal and the calibrated one side by side: the two URDFs given, or with --calibration the joint
origins before and after. --data adds the measured points. The page is a file that opens without calib. Without -o it is
a temporary file, which is opened in the browser if there is one.
""")
def view(
    robot: RobotFile,
    cell_options: ViewOptions,
    table_options: TableOptions,
    other: Annotated[
        str | None, typer.Argument(metavar="[OTHER]", help="The calibrated robot's URDF.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Table of joint values and measured points to show.")
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Result of a calibration, as 'calib calibrate --json' writes it."),
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
    if data is None and (
        any(asdict(table_options).values()) or {*cell_options.given} & {"kind", "frame"}
    ):
        raise CalibError("--points, --columns, --kind, --frame: name the table with --data.")
    inputs = [robot, other, data, cell_options.file, calibration, table_options.points]
    check_outputs([output], inputs, force=force)
    cell = cell_options.cell()
    if calibration is None:
        arm, measurements = _load(robot, cell, data, table_options)
        shown = _view_of_robots(arm, other, measurements, cell)
    else:
        shown = _view_of_result(robot, cell, cell_options, data, table_options, calibration)
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
    table_options: TableOptions,
) -> tuple[Robot, Measurements | None]:
    """Load the robot, and the table if there is one."""
    if data is None:
        return load(robot, cell), None
    return load_with_data(robot, cell, data, table_options)


def _view_of_result(
    robot: str,
    cell: Cell,
    cell_options: ViewOptions,
    data: Path | None,
    table_options: TableOptions,
    calibration: Path,
) -> View:
    """Return the view of a result: the robot with the joint origins before and after it."""
    from calib.result.calibration_file import read_result
    from calib.verbs.view.view import view_of_result

    result = read_result(calibration)
    cell = with_chain_of_result(cell, result, str(calibration))
    arm, measurements = _load(robot, cell, data, table_options)
    from_result = [name for name in ("frame", "target") if name not in cell_options.given]
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
