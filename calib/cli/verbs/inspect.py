"""``calib inspect``: what a robot is made of, and what measurements can tell of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import ModelOptions, RobotFile, TableOptions, verb


@dataclass(frozen=True, slots=True)
class _Options(ModelOptions):
    """The set-up; what is given of tip and target holds without a table too."""

    tip: Annotated[
        str | None,
        typer.Option(
            help="Link that the target is mounted on. Default: the end of the longest chain, with DATA of joints that "
            "are in it."
        ),
    ] = None
    target: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z UNIT"',
            help='Target in the tip, such as "70 -70 22.5 mm". Default: found from DATA; without it 50, 70, 30 mm off '
            "the tip.",
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
    said: _Options,
    read: TableOptions,
    data: Annotated[
        Path | None, typer.Argument(metavar="[DATA]", help="CSV table, to judge its poses.")
    ] = None,
) -> None:
    """See the text of `verb`."""
    from calib.cli.setup import load, load_with_data, read_cell, say_ignored
    from calib.design.forecast import forecast_of_table
    from calib.estimate.inspection import inspect as inspect_robot
    from calib.text.inspection import inspection_text

    cell, table, foreseen = read_cell(**asdict(said)), None, None
    if data is None:
        arm = load(robot, cell)
    else:
        arm, table = load_with_data(robot, cell, data, **asdict(read))
        say_ignored(table, arm)
        foreseen = forecast_of_table(arm, cell, table)
    typer.echo(inspection_text(arm, inspect_robot(arm, cell, table), foreseen))
