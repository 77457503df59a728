"""Output for a person: lines of 100 columns, colours and progress on a terminal, no escape code elsewhere."""

from __future__ import annotations

import re
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Literal

import typer

from calib.basics.progress import Stage, counted, is_watched, watching

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


#: What the stages of a calibration are called while they last.
WORK = {
    Stage.READING: "reading",
    Stage.MISTAKES: "usual mistakes",
    Stage.MODELS: "models",
    Stage.FOLDS: "cross-validation",
    Stage.VERDICT: "residuals and verdict",
    Stage.BOOTSTRAP: "bootstrap",
    Stage.PROFILE: "profile likelihood",
    Stage.WRITING: "writing",
}

#: Stages that try an unknown number of models or mistakes, which are numbered.
_NUMBERED = (Stage.MISTAKES, Stage.MODELS)

#: Columns of a terminal below which the line says less.
_NARROW = 60

#: The first columns of a table of robots hold words, the others numbers.
_WORD_COLUMNS = 4


def say(text: str) -> None:
    """Print a text to stdout: verdict and headings stand out on a terminal; a file gets it as it is."""
    if not sys.stdout.isatty():
        typer.echo(text)
        return
    say_lines(styled(text))


def say_lines(lines: Iterable[tuple[str, str]]) -> None:
    """Print lines to stdout, each with its style of rich on a terminal; a file gets them as they are.

    Args:
        lines: Texts and styles; ``""`` is none.
    """
    if not sys.stdout.isatty():
        for text, _ in lines:
            typer.echo(text)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False, markup=False, emoji=False)
    for text, style in lines:
        # The lines are set already: a narrow terminal wraps them itself, and what is copied stays whole.
        for line in _visible(text).split("\n"):
            console.print(Text(line, style), soft_wrap=True)


def styled(text: str) -> Iterator[tuple[str, str]]:
    r"""Yield the lines of a text, control characters as escapes, each with its style of rich; ``""`` for none.

    Example:
        >>> list(styled("Verdict: use\n  It is better."))
        [('Verdict: use', 'bold green'), ('  It is better.', '')]
    """
    lines = _visible(text).split("\n")
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        is_underlined = len(following) >= len(line.rstrip()) > 0 and _RULE.match(following)
        if line.startswith("Verdict: "):
            verdict = line.removeprefix("Verdict: ")
            yield line, VERDICTS.get(verdict, "bold")
        elif is_underlined or _HEAD.match(line):
            yield line, "bold"
        else:
            yield line, "dim" if _RULE.match(line) else ""


def _visible(text: str) -> str:
    """Return a text with control characters as escapes."""
    return _CONTROLS.sub(lambda control: repr(control[0])[1:-1], text)


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
def stages_bar(*, quiet: bool) -> Iterator[Callable[[str, int, int], None] | None]:
    """Show a bar on stderr for each stage of the work in the block; whoever watches the progress hears of it instead.

    Args:
        quiet: Whether no bar is wanted.

    Yields:
        A function of the stage's name, the work done and all of its work; None if ``quiet``, or if stderr is not a
        terminal and nobody watches.
    """
    if is_watched():
        yield lambda _stage, done, total: counted(done, total)
        return
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(stage: str, done: int, total: int) -> None:
            """Show how much of a stage is done, in a bar that its first call adds; of 0 in all: it moves to and fro."""
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total or None)
            bar.update(tasks[stage], completed=done, total=total or None)

        yield advance


@contextmanager
def progress_bar(label: str, *, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show a bar on stderr for the work in the block.

    Args:
        label: The name of the work.
        quiet: Whether no bar is wanted.

    Yields:
        A function of the work done and all of the work; None if ``quiet``, or if stderr is not a terminal.
    """
    with stages_bar(quiet=quiet) as advance:
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


class Pace:
    """Tells the time that a stage still takes, by the time that its parts took so far."""

    def __init__(self, now: float) -> None:
        """Begin a stage at a time [s]."""
        self._began = now
        self._ends: float | None = None

    def count(self, done: int, of: int, now: float) -> None:
        """Count the parts that are done at a time [s]: each of the others takes as long as one of these did."""
        if done > 0:
            self._ends = now + (now - self._began) / done * (of - done)
        else:  # what precedes the first part is none of its time
            self._began = now

    def left(self, now: float) -> float | None:
        """Return the time that is left [s], >= 0; None before a part is done."""
        return None if self._ends is None else max(self._ends - now, 0.0)


@contextmanager
def work_line(*, quiet: bool) -> Iterator[None]:
    """Show in one line on stderr what the work in the block does, see `calib.basics.progress`.

    The line has the stage, a bar if the number of its parts is known, what is tried, the time that is left of the
    stage, and the time since the beginning. Where the terminal is narrow, the bar and what is tried are shortened. It
    is gone at the end.

    Args:
        quiet: Whether no line is wanted; nor is there one if stderr is not a terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
    from rich.table import Column
    from rich.text import Text

    console = Console(stderr=True)
    began = time.monotonic()
    pace, now_in, tried = Pace(began), Stage.READING, 0

    class Tried(ProgressColumn):
        """Column with the work in progress, in one line."""

        def render(self, task: Task) -> Text:
            """Return the text, which ends in an ellipsis if there is no room for it."""
            overflow: Literal["crop", "ellipsis"] = "ellipsis"
            if console.options.ascii_only:
                overflow = "crop"
            return Text(task.fields["what"], no_wrap=True, overflow=overflow)

    class Times(ProgressColumn):
        """The time that is left of the stage, if it is known, and the time since the beginning."""

        def render(self, task: Task) -> Text:  # noqa: ARG002
            """Return the text for this moment."""
            now = time.monotonic()
            left = pace.left(now)
            since = f"{now - began:.0f} s"
            if console.width >= _NARROW:
                since += " so far"
            return Text(since if left is None else f"stage: {left:.0f} s left | {since}")

    # Columns that may wrap are shortened first: the bar, and what is tried, which does not wrap itself.
    spinner = "line" if console.options.ascii_only else "dots"
    columns = (
        SpinnerColumn(spinner, table_column=Column(no_wrap=True)),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        Tried(),
        Times(table_column=Column(no_wrap=True)),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        line = bar.add_task("", total=None, what="")

        def show(stage: Stage | None, what: str, done: int, of: int) -> None:
            """Show what is said."""
            nonlocal pace, now_in, tried
            now = time.monotonic()
            if stage is not None:
                pace, now_in, tried = Pace(now), stage, 0
                bar.reset(line, total=None, description=WORK[stage], what="")
                bar.refresh()
            if what:
                tried += 1
                shown = _visible(what)
                bar.update(line, what=f"{tried}: {shown}" if now_in in _NUMBERED else shown)
            if of:
                pace.count(done, of, now)
                bar.update(line, completed=done, total=of)

        with watching(show):
            yield
