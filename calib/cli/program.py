"""The program: all verbs of the command line, and the options before them."""

from __future__ import annotations

import typer

from calib.cli.verb import Verb
from calib.cli.verbs.base_frame import base_frame
from calib.cli.verbs.board import board
from calib.cli.verbs.calibrate import calibrate
from calib.cli.verbs.compare import compare
from calib.cli.verbs.compensate import compensate
from calib.cli.verbs.convert import convert
from calib.cli.verbs.demo import demo
from calib.cli.verbs.detect import detect
from calib.cli.verbs.evaluate import evaluate
from calib.cli.verbs.fleet import fleet
from calib.cli.verbs.inspect import inspect
from calib.cli.verbs.plan import plan
from calib.cli.verbs.simulate import simulate
from calib.cli.verbs.view import view
from calib.cli.verbs.workspace import workspace

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
