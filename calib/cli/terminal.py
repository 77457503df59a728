"""Text for whoever reads it: with sober colours on a terminal, and without a single escape code anywhere else."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator

import typer

#: How a verdict is coloured; the word says it too.
VERDICTS = {
    "use": "bold green",
    "use with care": "bold yellow",
    "do not use": "bold red",
    "pass": "bold green",
    "undecided": "bold yellow",
    "fail": "bold red",
}

#: Lines that are the head of a table or name one.
_HEAD = re.compile(
    r"((Position|Length|Position or length|Orientation) error "
    r"|(Pose|Length) accuracy[, ]|Orientation, |Validation rows  |Models tried  |Parameter  |Larger model '"
    r"|Table \d+: )"
)

#: The line under a heading.
_RULE = re.compile(r"(=+|-+)$")

#: Characters that control a terminal; file names may hold them.
_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def say(text: str) -> None:
    """Print a text to stdout: verdict and headings stand out on a terminal; elsewhere it is printed as it is."""
    if not sys.stdout.isatty():
        typer.echo(text)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False, markup=False, emoji=False)
    for line, style in styled(text):
        # The lines are set already: a narrow terminal wraps them itself, and what is copied stays whole.
        console.print(Text(line, style), soft_wrap=True)


def styled(text: str) -> Iterator[tuple[str, str]]:
    r"""The lines of a text, each with the style that it has on a terminal; ``""`` for none.

    Example:
        >>> list(styled("Verdict: use\n  It is better."))
        [('Verdict: use', 'bold green'), ('  It is better.', '')]
    """
    lines = [_CONTROLS.sub(_written_out, line) for line in text.split("\n")]
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        under = len(following) >= len(line.rstrip()) > 0 and _RULE.match(following) is not None
        if line.startswith("Verdict: "):
            verdict = line.removeprefix("Verdict: ")
            yield line, VERDICTS.get(verdict, "bold")
        elif under or _HEAD.match(line):
            yield line, "bold"
        else:
            yield line, "dim" if _RULE.match(line) else ""


def command_line() -> str:
    """The command that runs, as it can be typed again."""
    return shlex.join(["calib", *sys.argv[1:]])


def _written_out(control: re.Match[str]) -> str:
    r"""A control character as Python would print it, such as ``\x1b``."""
    return control[0].encode("unicode_escape").decode("ascii")
