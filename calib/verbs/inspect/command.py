"""``calib inspect``: a robot's chain, and what measurements can identify of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.notices import say_ignored
from calib.cli.options import ModelOptions, RobotFile, TableOptions
from calib.cli.setup import load, load_with_data, read_cell
from calib.cli.verb import verb


@dataclass(frozen=True, slots=True)
class SetupOptions(ModelOptions):
    """Measurement setup; what is given of tip and target holds without a table too."""

    tip: Annotated[
        str | None,
        typer.Option(
            help="Link that the target is mounted on. Default: the end of the longest chain, with "
            "DATA of joints that are in it, before a gripper or hand."
        ),
    ] = None
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Target in the tip, such as "70 -70 22.5 mm". Default: estimated from DATA; '
            "without it 50, 70, 30 mm off the tip.",
        ),
    ] = None


@verb("""Show a robot's chain, its DH rows, the parameters of a model and which of them can be identified.

\b
Examples:
  calib inspect ur3 --base base --tip tool0
  calib inspect robot.urdf data.csv --model hayati

With a table, identifiability is that of its poses; without one, of 200 poses spread over the joint limits.
""")
def inspect(
    robot: RobotFile,
    setup: SetupOptions,
    table: TableOptions,
    data: Annotated[
        Path | None, typer.Argument(metavar="[DATA]", help="CSV table, to judge its poses.")
    ] = None,
) -> None:
    """Run the verb; its help is the text of `verb`."""
    from calib.verbs.inspect.inspection import inspect as inspect_robot
    from calib.verbs.inspect.text import inspection_text
    from calib.verbs.plan.forecast import forecast_of_table

    cell = read_cell(**asdict(setup))
    measurements, forecast = None, None
    if data is None:
        arm = load(robot, cell)
    else:
        arm, measurements = load_with_data(robot, cell, data, table)
        say_ignored(measurements, arm)
        forecast = forecast_of_table(arm, cell, measurements)
    inspection = inspect_robot(arm, cell, measurements)
    typer.echo(inspection_text(arm, inspection, forecast))
