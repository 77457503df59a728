"""Output for a person: lines of 100 columns, colours and progress on a terminal, no escape code elsewhere."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Literal

import typer

if TYPE_CHECKING:
    from rich.progress import TaskID


#: Colour of a verdict, beside the word.
VERDICTS = {
    "use": "bold green",
    "use with care": "bold yellow",
    "do not use": "bold red",
    "pass": "bold green",
    "undecided": "bold yellow",
    "fail": "bold red",
}

#: Heads and titles of tables.
_HEAD = re.compile(
    r"((Position|Length|Position or length|Orientation) error "
    r"|(Pose|Length) accuracy[, ]|Orientation, |Models tried  |Parameter  |Non-geometric model '"
    r"|Table \d+: )"
)

#: The line under a heading.
_RULE = re.compile(r"(=+|-+)$")

#: Characters that control a terminal; file names may hold them.
_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


#: The first columns of a table of robots hold words, the others numbers.
_WORD_COLUMNS = 4


def say(text: str) -> None:
    """Print a text to stdout: verdict and headings stand out on a terminal; a file gets it as it is."""
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
    r"""Yield the lines of a text, control characters as escapes, each with its style of rich; ``""`` for none.

    Example:
        >>> list(styled("Verdict: use\n  It is better."))
        [('Verdict: use', 'bold green'), ('  It is better.', '')]
    """
    visible = _CONTROLS.sub(lambda control: repr(control[0])[1:-1], text)
    lines = visible.split("\n")
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        is_underlined = len(following) >= len(line.rstrip()) > 0 and _RULE.match(following)
        if line.startswith("Verdict: "):
            verdict = line.removeprefix("Verdict: ")
            yield line, VERDICTS.get(verdict, "bold")
        elif is_underlined or _HEAD.match(line):
            yield line, "bold"
        else:
            yield line, "dim" if _RULE.match(line) else ""


def say_table(title: str, heads: list[str], rows: list[list[str]]) -> None:
    """Print a table: on a terminal long names are folded and verdicts coloured; a file gets plain text.

    Args:
        title: The line above it.
        heads: Heads of the columns; the first four hold words, the others numbers.
        rows: Cells, a list for each row; without rows nothing is printed.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for k, head in enumerate(heads):
        justify: Literal["left", "right"] = "left" if k < _WORD_COLUMNS else "right"
        table.add_column(head, justify=justify, overflow="fold")
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
    """Return the command that runs, as it can be typed again."""
    return shlex.join(["calib", *sys.argv[1:]])


@contextmanager
def stages_bar(*, quiet: bool, first: str = "") -> Iterator[Callable[[str, int, int], None] | None]:
    """Show a bar on stderr for each stage of the work in the block.

    Args:
        quiet: Whether no bar is wanted.
        first: The name of work before the first stage, whose amount is not known: its bar moves to and fro.

    Yields:
        A function of the stage's name, the work done and all of its work; None if ``quiet``, or if stderr is not a
        terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, TaskID] = {}
        if first:
            tasks[first] = bar.add_task(first, total=None)

        def advance(stage: str, done: int, total: int) -> None:
            """Show how much of a stage is done, in a bar that its first call adds; of 0 in all: it moves to and fro."""
            if first in tasks:
                bar.remove_task(tasks.pop(first))
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total or None)
            bar.update(tasks[stage], completed=done, total=total or None)

        yield advance


@contextmanager
def progress_bar(
    label: str, *, quiet: bool, first: str = ""
) -> Iterator[Callable[[int, int], None] | None]:
    """Show a bar on stderr for the work in the block.

    Args:
        label: The name of the work.
        quiet: Whether no bar is wanted.
        first: The name of what comes before it, whose amount is not known.

    Yields:
        A function of the work done and all of the work; None if ``quiet``, or if stderr is not a terminal.
    """
    with stages_bar(quiet=quiet, first=first) as advance:
        yield None if advance is None else partial(advance, label)


@contextmanager
def moving_bar(label: str, *, quiet: bool) -> Iterator[None]:
    """Show a bar on stderr that moves to and fro while the work in the block lasts, whose amount is not known.

    Args:
        label: The name of the work.
        quiet: Whether no bar is wanted; nor is there one if stderr is not a terminal.
    """
    with progress_bar(label, quiet=quiet) as progress:
        if progress is not None:
            progress(0, 0)
        yield
