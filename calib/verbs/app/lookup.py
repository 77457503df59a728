"""Results that are stored in the app's folder: those to check against, and the history of each robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

from calib.show.blocks import Verdict as VerdictBlock
from calib.verbs.app.job import RECORD
from calib.verbs.history.found_files import FoundResult, find_files
from calib.verbs.history.history import Entry, History

#: Digits of a run that are shown.
_RUN_DIGITS = 12

#: Width of the timeline, and the least width of a bar, in its own units.
_WIDTH, _LEAST = 600.0, 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultLine:
    """A result in a list."""

    run: str
    date: str
    #: Path of its file in the folder
    path: str
    #: Name of the job that made it; empty: none of the app's
    job: str
    verdict: str
    shade: str
    sign: str
    #: Whether its corrected URDF is given out
    has_urdf: bool
    #: What ended its validity, as of `Entry`
    end: Literal["", "replaced", "check failed", "never"] = ""
    until: str = ""
    accepted: bool = False


@dataclass(frozen=True, slots=True)
class Bar:
    """The time in which a calibration was valid, on the timeline."""

    x: float
    width: float
    shade: str


@dataclass(frozen=True, slots=True)
class RobotHistory:
    """The calibrations of a robot, the latest first."""

    serial: str
    #: The run that is valid now; empty: none
    valid: str
    lines: tuple[ResultLine, ...]
    bars: tuple[Bar, ...]
    #: First and last date of the timeline
    first: str
    last: str


def stored_results(folder: Path) -> list[FoundResult]:
    """Return the results below a folder, the latest first."""
    return sorted(
        find_files(folder, by_folder=False).results, key=lambda one: one.date, reverse=True
    )


def robots_of(history: History, now: datetime) -> Iterator[RobotHistory]:
    """Yield the calibrations of each robot.

    Args:
        history: The history of the folder.
        now: The end of the timeline.
    """
    for serial, entries in history.robots.items():
        valid = [entry.result.run[:_RUN_DIGITS] for entry in entries if entry.is_valid]
        lines = tuple(line_of(history.folder, entry.result, entry) for entry in reversed(entries))
        first = entries[0].result.date
        last = max(now, entries[-1].result.date)
        bars = tuple(_bars(entries, first, last))
        yield RobotHistory(serial, valid[-1] if valid else "", lines, bars, _day(first), _day(last))


def line_of(folder: Path, result: FoundResult, entry: Entry | None = None) -> ResultLine:
    """Return a result as a line of a list; with its entry in a history, its validity too."""
    block = VerdictBlock(result.verdict or "none", ())
    parent = (folder / result.path).parent
    ending = {}
    if entry is not None:
        until = "" if entry.until is None else _day(entry.until)
        ending = {"end": entry.end, "until": until, "accepted": entry.accepted}
    return ResultLine(
        run=result.run[:_RUN_DIGITS],
        date=_day(result.date),
        path=result.path,
        job=parent.name if (parent / RECORD).is_file() else "",
        verdict=block.use,
        shade=block.shade,
        sign=block.sign,
        has_urdf=result.verdict in ("use", "use with care"),
        **ending,  # type: ignore[arg-type]
    )


def _bars(entries: tuple[Entry, ...], first: datetime, last: datetime) -> Iterator[Bar]:
    """Yield the times in which calibrations were valid, on an axis from the first date to the last."""
    whole = max((last - first).total_seconds(), 1.0)
    for entry in entries:
        begun = _WIDTH * (entry.result.date - first).total_seconds() / whole
        end = last if entry.until is None else entry.until
        width = _WIDTH * (end - entry.result.date).total_seconds() / whole
        if entry.end == "never":
            width = 0.0
        shade = VerdictBlock(entry.result.verdict or "none", ()).shade
        x = min(begun, _WIDTH - _LEAST)
        yield Bar(round(x, 1), round(min(max(width, _LEAST), _WIDTH - x), 1), shade)


def _day(date: datetime) -> str:
    """Write the day of a date."""
    return date.strftime("%Y-%m-%d")
