"""What ``calib fleet`` prints: a table of the robots, the odd ones with their reasons, and how many failed."""

from __future__ import annotations

import sys
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import typer

from calib.cli.terminal import VERDICTS

if TYPE_CHECKING:
    from rich.table import Table

    from calib.fleets.fleet import Fleet
    from calib.fleets.outliers import Odd
    from calib.fleets.record import FleetRow

_WIDTH = 100

#: More robots than this are counted, and those are listed that need somebody to look at them.
LISTED = 40

#: Reasons that are told of one robot; fleet.json has them all.
_REASONS = 4

#: What `Odd.figure` says of data that are another robot's too.
DATA = "data"

#: Robots of one reason that are named.
_NAMES = 5

_HEADS = ("robot", "verdict", "model", "nominal", "calibrated", "unseen", "noise", "rows", "out")

#: The first columns hold words.
_WORDS = 3

#: Behind "unseen" where that is of validation rows: what robots are compared by.
_CROSS = "cross-val."


def print_fleet(found: Fleet) -> None:
    """Print a fleet: a table with colours on a terminal, plain text elsewhere."""
    from calib.fleets.record import DONE

    done = [row for row in found.rows if row.status == DONE]
    shown = shown_rows(found)
    if shown:
        typer.echo("Errors and noise, rms [mm]" + _which(len(shown), len(done)))
        if sys.stdout.isatty():
            from rich.console import Console

            Console(highlight=False, markup=False, emoji=False).print(_table(shown))
        else:
            typer.echo("\n".join(table_lines(cells_of(shown))))
        typer.echo("")
    for paragraph in paragraphs(found):
        typer.echo(paragraph)


def shown_rows(found: Fleet) -> list[FleetRow]:
    """The robots that are listed: all of a small fleet, and of a large one those that are odd or not to be used."""
    from calib.fleets.record import DONE

    done = [row for row in found.rows if row.status == DONE]
    if len(done) <= LISTED:
        return done
    odd = {one.name for one in found.odd}
    return [row for row in done if row.name in odd or row.verdict not in ("use", "")]


def paragraphs(found: Fleet) -> Iterator[str]:
    """The odd ones, the failed ones, what could not be said, and how many there were."""
    reasons: dict[str, list[str]] = {}
    for one in odd_figures(found):
        reasons.setdefault(one.name, []).append(one.text)
    if reasons:
        yield "Odd ones out:"
        for name, texts in reasons.items():
            yield _hung(f"{name}: {'; '.join(texts[:_REASONS])}{_more(len(texts) - _REASONS)}")
        yield ""
    twice = [one for one in found.odd if one.figure == DATA]
    if twice:
        yield "Data given twice, which count once in what is usual:"
        yield from (_hung(f"{one.name}: {one.text}") for one in twice)
        yield ""
    if found.failed:
        yield "Failed:"
        yield from map(_hung, failed_lines(found.failed))
        yield ""
    for note in found.notes:
        yield textwrap.fill(note, _WIDTH, break_on_hyphens=False)
    yield _counts(found)


def cells_of(rows: Sequence[FleetRow]) -> list[tuple[str, ...]]:
    """The table's header and its cells, row by row."""
    cross = any(row.unseen == "validation" and row.left_out_rms == row.left_out_rms for row in rows)
    heads = tuple(
        head for name in _HEADS for head in (name, *((_CROSS,) * (cross and name == "unseen")))
    )
    return [heads, *(_cells(row, cross=cross) for row in rows)]


def odd_figures(found: Fleet) -> list[Odd]:
    """What is odd about robots; data given twice are told apart."""
    return [one for one in found.odd if one.figure != DATA]


def table_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """Cells as lines: the first columns, words, from the left, numbers from the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if k < _WORDS else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines


def _table(rows: Sequence[FleetRow]) -> Table:
    """The same for a terminal."""
    from rich.table import Table as RichTable
    from rich.text import Text

    table = RichTable(box=None, pad_edge=False, header_style="bold")
    heads, *lines = cells_of(rows)
    for k, head in enumerate(heads):
        table.add_column(head, justify="left" if k < _WORDS else "right", overflow="fold")
    for row, line in zip(rows, lines, strict=True):
        cells = [Text(cell) for cell in line]
        cells[1].stylize(VERDICTS.get(row.verdict, ""))
        table.add_row(*cells)
    return table


def _cells(row: FleetRow, *, cross: bool) -> tuple[str, ...]:
    """A robot's cells."""
    model = f"{row.model} ({row.larger})" if row.larger else row.model
    left_out = (row.left_out_rms,) if cross else ()
    numbers = (row.nominal_rms, row.calibrated_rms, row.unseen_rms, *left_out, row.sigma)
    shown = ("" if value != value else f"{1e3 * value:.3f}" for value in numbers)
    return (row.name, row.verdict or "-", model, *shown, str(row.rows), str(row.outliers))


def _which(shown: int, done: int) -> str:
    """Which robots the table has."""
    if shown == done:
        return ":"
    return f", of the {shown} of {done} robots that are odd or not simply to be used:"


def _counts(found: Fleet) -> str:
    """How many robots, with which verdicts."""
    from calib.fleets.record import DONE, STALE

    done = [row for row in found.rows if row.status == DONE]
    verdicts = Counter(row.verdict or "no verdict" for row in done)
    words = ", ".join(f"{count} {word}" for word, count in verdicts.most_common())
    text = f"{len(done)} of {len(found.rows)} robots calibrated" + (f" ({words})" if words else "")
    kept = f", {found.kept} of them by an earlier run" if found.kept else ""
    odd = len({one.name for one in odd_figures(found)})
    twice = sum(one.figure == DATA for one in found.odd)
    said = f", {twice} with the data of another" if twice else ""
    stale = sum(row.status == STALE for row in found.failed)
    stand = f" ({stale} of them with a result of earlier inputs in the folder)" if stale else ""
    return f"{text}{kept}; {odd} odd{said}, {len(found.failed)} failed{stand}."


def failed_lines(rows: Sequence[FleetRow]) -> Iterator[str]:
    """Each reason once, with the robots that it is of."""
    from calib.fleets.record import STALE

    groups: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        groups.setdefault((row.message, row.status), []).append(row.name)
    for (message, status), names in groups.items():
        more = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
        whose = (
            "Their folders hold the results" if len(names) > 1 else "Its folder holds the result"
        )
        stand = f"{'' if message.endswith('.') else '.'} {whose} of earlier inputs." * (
            status == STALE
        )
        yield f"{', '.join(names[:_NAMES])}{more}: {message}{stand}"


def _more(count: int) -> str:
    """How many reasons are not told."""
    return f"; and {count} more in fleet.json" if count > 0 else ""


def _hung(text: str) -> str:
    """A paragraph whose further lines are set in."""
    return textwrap.fill(
        text, _WIDTH, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False, break_long_words=False
    )  # fmt: skip
