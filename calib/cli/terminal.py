"""What a person reads: lines of 100 columns, sober colours and progress on a terminal, no escape code elsewhere."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rich.progress import TaskID


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
    r"|(Pose|Length) accuracy[, ]|Orientation, |Models tried  |Parameter  |Non-geometric model '"
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
    lines = [
        _CONTROLS.sub(lambda control: repr(control[0])[1:-1], line) for line in text.split("\n")
    ]
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        under = len(following) >= len(line.rstrip()) > 0 and _RULE.match(following) is not None
        if line.startswith("Verdict: "):
            verdict = line.removeprefix("Verdict: ")
            yield line, VERDICTS.get(verdict, "bold")
        elif under or _HEAD.match(line):
            yield line, "bold"
        else:
            yield line, "dim" if _RULE.match(line) else ""


def say_table(title: str, heads: list[str], rows: list[list[str]]) -> None:
    """Print a table: on a terminal long names are folded and verdicts coloured; elsewhere it is plain text.

    Its first four columns are words, the others numbers.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for k, head in enumerate(heads):
        table.add_column(head, justify="left" if k < 4 else "right", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell, VERDICTS.get(cell, "")) for cell in row))
    # A file is as wide as its longest name.
    width = None if sys.stdout.isatty() else 10_000
    console = Console(width=width, highlight=False, markup=False, emoji=False)
    with console.capture() as printed:
        console.print(table)
    lines = [line.rstrip() for line in printed.get().splitlines()]
    typer.echo("\n".join([title, *lines, ""]) if rows else "", nl=bool(rows))


def command_line() -> str:
    """The command that runs, as it can be typed again."""
    return shlex.join(["calib", *sys.argv[1:]])


@contextmanager
def stages_bar(*, quiet: bool) -> Iterator[Callable[[str, int, int], None] | None]:
    """A bar on stderr for each stage of the work in the block; None where nobody is watching."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield advance


@contextmanager
def progress_bar(label: str, *, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """The same for work in one stage, ``label``."""
    with stages_bar(quiet=quiet) as advance:
        yield None if advance is None else partial(advance, label)
