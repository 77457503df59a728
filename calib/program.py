"""The program: all verbs of the command line, and the options before them.

A verb's module is imported when the verb is called: ``calib --help`` needs none of them.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from calib.cli.exit_status import ExitStatus
from calib.cli.interrupt import INTERRUPTED
from calib.cli.verb import Verb

#: The verbs, in the order of ``calib --help``; ``base-frame`` is that of the folder ``base_frame``. The docstring of a
#: verb's package is what it does in one line.
VERBS = (
    "demo",
    "bag",
    "detect",
    "calibrate",
    "fleet",
    "evaluate",
    "compare",
    "compensate",
    "inspect",
    "base-frame",
    "board",
    "plan",
    "simulate",
    "convert",
    "joints",
    "view",
    "workspace",
)

#: Earlier names of verbs, kept for one release.
_EARLIER = {"fit": "calibrate"}


class _Commands(Mapping[str, Any]):
    """The commands by name, each made when it is asked for."""

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401  a class of typer's own
        """Import a verb's module and make its command."""
        if name not in {*VERBS, *_EARLIER}:
            raise KeyError(name)
        return _command(name)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter((*VERBS, *_EARLIER))

    def __len__(self) -> int:
        """Return their number."""
        return len(VERBS) + len(_EARLIER)


@cache
def _command(name: str) -> Any:  # noqa: ANN401  a class of typer's own
    """Import a verb by its name, and return its command."""
    folder = _EARLIER.get(name, name).replace("-", "_")
    function = getattr(importlib.import_module(f"calib.verbs.{folder}.command"), folder)
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command(name, cls=Verb, hidden=name in _EARLIER)(function)
    return get_command(single)


@contextmanager
def _saying_interrupted() -> Iterator[None]:
    """Say that Ctrl-C ended the block, which typer does not, and what it says of the work that is kept."""
    try:
        yield
    except KeyboardInterrupt as error:
        typer.echo(f"{INTERRUPTED} {error}".rstrip(), err=True)
        raise typer.Exit(ExitStatus.INTERRUPTED) from error


class Program(TyperGroup):
    """The group of the verbs."""

    def __init__(self, **arguments: Any) -> None:  # noqa: ANN401  typer's own
        """Put the commands in place of those that typer knows."""
        super().__init__(**{**arguments, "commands": {}})
        self.commands = _Commands()  # type: ignore[assignment]

    def make_context(self, *arguments: Any, **options: Any) -> Any:  # noqa: ANN401  typer's own
        """Parse the options before the verb."""
        with _saying_interrupted():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401  typer's own
        """Import a verb and run it."""
        with _saying_interrupted():
            return super().invoke(ctx)

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401
        """Return the names of the verbs."""
        del ctx
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Write the verbs with what they do, without their commands."""
        del ctx
        rows = []
        for name in VERBS:
            package = importlib.import_module(f"calib.verbs.{name.replace('-', '_')}")
            rows.append((name, package.__doc__ or ""))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


app = typer.Typer(
    name="calib",
    cls=Program,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Kinematic calibration of robot arms: URDF in, corrected URDF out.",
    epilog="Start with:  calib demo     then:  calib calibrate robot.urdf data.csv -o corrected.urdf",
)


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
    """Take the options before the verb; ``--version`` has been handled by its callback."""
    del version
