"""The program: all verbs of the command line, and the options before them."""

from __future__ import annotations

import typer

from calib.cli.verb import Verb
from calib.verbs.base_frame.command import base_frame
from calib.verbs.board.command import board
from calib.verbs.calibrate.command import calibrate
from calib.verbs.compare.command import compare
from calib.verbs.compensate.command import compensate
from calib.verbs.convert.command import convert
from calib.verbs.demo.command import demo
from calib.verbs.detect.command import detect
from calib.verbs.evaluate.command import evaluate
from calib.verbs.fleet.command import fleet
from calib.verbs.inspect.command import inspect
from calib.verbs.plan.command import plan
from calib.verbs.simulate.command import simulate
from calib.verbs.view.command import view
from calib.verbs.workspace.command import workspace

app = typer.Typer(
    name="calib",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Kinematic calibration of robot arms: URDF in, corrected URDF out.",
    epilog="Start with:  calib demo     then:  calib calibrate robot.urdf data.csv -o corrected.urdf",
)
#: The verbs, in the order of ``calib --help``.
_VERBS = (
    demo,
    detect,
    calibrate,
    fleet,
    evaluate,
    compare,
    compensate,
    inspect,
    base_frame,
    board,
    plan,
    simulate,
    convert,
    view,
    workspace,
)
for command in _VERBS:
    app.command(cls=Verb)(command)
# The earlier name of `calibrate`, kept for one release.
app.command("fit", cls=Verb, hidden=True)(calibrate)


def _print_version(given: bool) -> None:
    """Print the version and stop, if the option is given."""
    if given:
        from calib.version import __version__

        typer.echo(f"calib {__version__}")
        raise typer.Exit


_VERSION = typer.Option(
    False, "--version", callback=_print_version, is_eager=True, help="Print the version and stop."
)


@app.callback()
def _options(version: bool = _VERSION) -> None:
    """Take the options before the verb."""
    del version
