"""``calib view``: robots and measurements in the browser, or as a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from calib.cli.loading import (
    load,
    load_with_data,
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
from calib.cli.terminal import moving_bar
from calib.cli.verb import verb
from calib.errors import CalibError


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
    from calib.result.calibration_file import read_result
    from calib.verbs.view.robots_page import view_page, write_or_open
    from calib.verbs.view.view import view_of_result, view_of_robots

    if other is not None and calibration is not None:
        raise CalibError("OTHER and --calibration are both the second robot; leave out one.")
    if data is None and (
        any(asdict(table_options).values()) or {*cell_options.given} & {"kind", "frame"}
    ):
        raise CalibError("--points, --columns, --kind, --frame: name the table with --data.")
    inputs = [robot, other, data, cell_options.file, calibration, table_options.points]
    check_outputs([output], inputs, force=force)
    cell = cell_options.cell()
    result = None
    if calibration is not None:
        from calib.result.chain_of_result import with_chain_of_result

        result = read_result(calibration)
        cell = with_chain_of_result(cell, result, str(calibration))
    measurements = None
    if data is None:
        arm = load(robot, cell, result=result)
    else:
        arm, measurements = load_with_data(robot, cell, data, table_options, result)

    if result is not None and calibration is not None:
        # The robot with the joint origins before and after the calibration.
        from_result = [name for name in ("frame", "target") if name not in cell_options.given]
        shown = view_of_result(
            result, arm, measurements, cell, known=from_result, source=calibration.name
        )
    else:
        second = None
        if other is not None:
            second = load(other, replace(cell, base=arm.base, tip=arm.tip))
        cells = [cell, cell]
        if cell.target is None and not cell.targets:
            cells = [with_target_link(one, cell) for one in (arm, second or arm)]
        shown = view_of_robots(arm, second, measurements, cells=cells)

    with moving_bar("page", quiet=quiet):
        page = view_page(shown)
    written = write_or_open(page, output, overwrite=force)
    if not quiet:
        for warning in page.warnings:
            typer.echo(f"Not drawn as in the URDF: {warning}")
        typer.echo(f"Written: {written}")
