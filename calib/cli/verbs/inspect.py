"""``calib inspect``: what a robot is made of, and what measurements can tell of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.options import ModelOptions, RobotFile, TableOptions, verb
from calib.text.lines import fill

if TYPE_CHECKING:
    from calib.design.forecast import Forecast


@dataclass(frozen=True, slots=True)
class _Options(ModelOptions):
    """The set-up; what is said of tip and target holds without a table too."""

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
    from calib.result.inspection import inspect as inspect_robot
    from calib.text.inspection import inspection_text

    setup = read_cell(**asdict(said))
    if data is None:
        arm, table = load(robot, setup), None
    else:
        arm, table = load_with_data(robot, setup, data, **asdict(read))
        say_ignored(table, arm)
    typer.echo(inspection_text(arm, inspect_robot(arm, setup, table)))
    if table is not None:
        from calib.design.forecast import forecast_of_table, planned_model

        foreseen = forecast_of_table(arm, setup, table)
        if foreseen is not None:
            typer.echo(f"\n{_forecast_text(foreseen, planned_model(setup))}")


def _forecast_text(foreseen: Forecast, model: str) -> str:
    """What a fit of these poses can reach, and what the best poses could."""
    bound = foreseen.sigma * (foreseen.workspace_rank / foreseen.poses) ** 0.5
    return fill(
        f"Forecast for a fit of these {foreseen.poses} poses, with the model '{model}' and a noise of "
        f"{1e3 * foreseen.sigma:.3f} mm a coordinate: position error {1e3 * foreseen.rms:.3f} mm rms over the joint "
        f"limits (90 % of calibrations: {1e3 * foreseen.rms_low:.3f} to {1e3 * foreseen.rms_high:.3f}), "
        f"{1e3 * foreseen.max:.3f} mm where it is worst. The best {foreseen.poses} poses would give about "
        f"{1e3 * bound:.3f} mm rms; calib plan finds such.",
        hang="  ",
    )
