"""The program: all verbs of the command line, and the options before them.

A verb's module is imported when the verb is called: ``calib --help`` needs none of them.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from calib.cli.exit_status import ExitStatus
from calib.cli.interrupt import INTERRUPTED
from calib.cli.verb import Verb

#: The verbs in the order of the work: look, plan, measure, calibrate, use. ``base-frame`` is that
#: of the folder ``base_frame``. The docstring of a verb's package is what it does in one line.
VERBS = (
    "demo",
    "app",
    "inspect",
    "workspace",
    "plan",
    "measure",
    "simulate",
    "board",
    "detect",
    "bag",
    "joints",
    "base-frame",
    "calibrate",
    "evaluate",
    "certificate",
    "check",
    "compare",
    "convert",
    "compensate",
    "view",
    "fleet",
    "history",
)

#: Earlier names of verbs, kept for one release.
_EARLIER = {"fit": "calibrate"}

#: Verbs that are meant by words of other programs, which are proposed in place of them.
_MEANT = {
    "acceptance": "evaluate",
    "certify": "certificate",
    "correct": "compensate",
    "diff": "compare",
    "estimate": "calibrate",
    "export": "convert",
    "identify": "calibrate",
    "info": "inspect",
    "poses": "plan",
    "show": "view",
    "test": "evaluate",
    "validate": "evaluate",
    "verify": "evaluate",
}

#: Columns of a terminal in which no line of help is broken.
_NO_BREAK = "1000"

#: Options that show the help, wherever they are given; and the word for them.
_HELP_OPTIONS = ("-h", "--help")
_HELP = "help"


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


def _summary(name: str) -> str:
    """Return what a verb does in one line."""
    package = importlib.import_module(f"calib.verbs.{name.replace('-', '_')}")
    return package.__doc__ or ""


class _Described(TyperCommand):
    """A command of which a shell is told no more than its name and what it does."""

    def get_short_help_str(self, limit: int = 0) -> str:
        """Return what it does, whole."""
        del limit
        return self.help or ""


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
        if options.get(
            "resilient_parsing"
        ):  # a shell completes words: no text for it is broken into lines
            os.environ["COLUMNS"] = _NO_BREAK
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

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:  # noqa: ANN401  typer's own
        """Return the verbs and options that a shell proposes, without importing a verb."""
        described: Any = {name: _Described(name, help=_summary(name)) for name in VERBS}
        self.commands = described
        proposed: list[Any] = super().shell_complete(ctx, incomplete)
        return proposed

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401  typer's own
        """Find the verb of a call; ``help`` is the help of all, before a verb or alone behind it that of the verb.

        Args:
            ctx: The context of the call.
            args: The verb and the words after it.

        Returns:
            Its name, the command, and the words after it.
        """
        verb, *words = args
        if verb == _HELP and not words:
            typer.echo(ctx.get_help())
            raise typer.Exit
        if verb == _HELP:
            verb, words = words[0], [*_HELP_OPTIONS[:1]]
        elif words == [_HELP] and not Path(_HELP).exists():
            words = [*_HELP_OPTIONS[:1]]
        if verb in _MEANT:
            ctx.fail(f"No such command '{verb}'. Did you mean '{_MEANT[verb]}'?")
        return super().resolve_command(ctx, [verb, *words])

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Write the verbs with what they do, without their commands."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([(name, _summary(name)) for name in VERBS])


app = typer.Typer(
    name="calib",
    cls=Program,
    no_args_is_help=True,
    context_settings={"help_option_names": [*_HELP_OPTIONS]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Kinematic calibration of robot arms: URDF in, corrected URDF out.",
    epilog="""\b
Start with:  calib demo
then:        calib calibrate robot.urdf data.csv -o corrected.urdf
in a folder: calib inspect .
""",
)


def _print_version(given: bool) -> None:
    """Print the version and stop, if the option is given."""
    if given:
        from calib.version import __version__

        typer.echo(f"calib {__version__}")
        raise typer.Exit


_VERSION = typer.Option(
    False,
    "--version",
    "-V",
    callback=_print_version,
    is_eager=True,
    help="Print the version and stop.",
)


@app.callback()
def _options(version: bool = _VERSION) -> None:
    """Take the options before the verb; ``--version`` has been handled by its callback."""
    del version
