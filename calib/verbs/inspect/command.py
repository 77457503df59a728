"""``calib inspect``: a robot's chain, and what measurements can identify of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from calib.cli.loading import load, load_with_data
from calib.cli.notices import say_ignored
from calib.cli.options import ModelOptions, TableOptions
from calib.cli.verb import verb
from calib.errors import CalibError


@dataclass(frozen=True, slots=True)
class InspectOptions(ModelOptions):
    """Options of the cell; tip and target hold without a table too."""

    helps: ClassVar[Mapping[str, str]] = {
        "tip": "Link that the target is mounted on. Default: the end of the longest chain, with DATA of the longest "
        "one whose joints all have a column, before a gripper or hand.",
        "target": 'Position of the target in the tip, such as "70 -70 22.5 mm". Default: it is estimated from DATA; '
        "without DATA it is 50, 70, 30 mm off the tip.",
    }


@verb("""Show a robot's chain, its DH rows, the parameters of a model and which of them can be identified; or a folder.

\b
Examples:
  calib inspect .
  calib inspect ur3 --base base --tip tool0
  calib inspect robot.urdf data.csv --model hayati

Of a folder it says what is there, which robots, tables, cells and results belong together, and the next command.
With a table, identifiability is that of its poses; without one, of 200 poses spread over the joint limits.
""")
def inspect(
    robot: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT|FOLDER",
            help="URDF or xacro file (a xacro's arguments follow its name in the same quotes), DH rows, or the name of "
            "a robot in example-robot-data, such as 'ur3'; or a folder.",
        ),
    ],
    cell_options: InspectOptions,
    table_options: TableOptions,
    data: Annotated[
        Path | None,
        typer.Argument(metavar="[DATA]", help="Table whose poses are used instead of random ones."),
    ] = None,
) -> None:
    """Load the robot, and the table if there is one, and print what can be identified; or look into a folder."""
    if Path(robot).is_dir():
        if data is not None or cell_options.file or cell_options.given or table_options.columns:
            raise CalibError(
                f"'{robot}' is a folder, which is looked into without a table or options: calib inspect {robot}"
            )
        from calib.verbs.inspect.folder import look_into
        from calib.verbs.inspect.folder_text import folder_text

        typer.echo(folder_text(look_into(Path(robot))))
        return
    from calib.verbs.inspect.inspection import inspect as inspect_robot
    from calib.verbs.inspect.text import inspection_text
    from calib.verbs.plan.forecast import forecast_of_table

    cell = cell_options.cell()
    measurements, forecast = None, None
    if data is None:
        arm = load(robot, cell)
    else:
        arm, measurements = load_with_data(robot, cell, data, table_options)
        say_ignored(measurements, arm)
        forecast = forecast_of_table(arm, cell, measurements)
    inspection = inspect_robot(arm, cell, measurements)
    typer.echo(inspection_text(arm, inspection, forecast))
