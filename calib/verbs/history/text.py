"""A history in words: a line for each robot or for each calibration of one, and notes on files."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from calib.basics.dates import date_text
from calib.show.as_text import page_text
from calib.show.blocks import Block, Bullets, Page, Paragraph, Section
from calib.show.lines import plural
from calib.show.tables import Column, Row, Table, name_column
from calib.verbs.history.found_files import DateFrom, Note, What
from calib.verbs.history.history import Entry, History

#: Files of a note that are named; the others are counted.
_MOST_FILES = 5

#: Notes of one kind that are listed; the others are counted.
_MOST_NOTES = 12

#: Digits of a run that are shown: enough to tell the calibrations of a robot apart, and to restore one.
_RUN_DIGITS = 12

#: Source of a date, where it is not the record of the measurement.
_SOURCES = {
    DateFrom.MEASURED: "",
    DateFrom.CALIBRATED: " (calibrated)",
    DateFrom.FILE: " (of the file)",
}

#: A sentence on the files of a note, with its files and its text.
_SENTENCES = {
    What.DAMAGED: "{files} is left out: {text}",
    What.OTHER_DATE: "{files}: the record's date '{text}' is not in the form 2026-03-01, so it is not used.",
    What.FILE_DATE: "{files}: neither measured nor calibrated when is stated; the date is that of the file.",
    What.NO_SERIAL: "Without a serial number ([record] robot_serial in the cell file), so in no robot's history: "
    "{files}. With --by-folder the name of the folder is taken as one.",
    What.COPY: "{first} has the run of {last} and counts once.",
    What.SHARED_RUN: "One run, of the same measurements, stands under several serial numbers ({text}): {files}.",
    What.SAME_DATE: "{first} and {last} are of the same date; {last} counts as the later one, by when it was "
    "calibrated or else by its name.",
    What.CHANGED_URDF: "{first} was changed since it was written: it is not the URDF of {last}.",
}


def history_text(history: History, serial: str | None) -> str:
    """Write a history: a line for each calibration of a robot, or for each robot if None, then the notes."""
    blocks: list[Block] = []
    if serial is None:
        blocks += _robots(history)
    else:
        blocks += _calibrations(serial, history.of(serial))
    concerned = set()
    if serial is not None:
        concerned = {entry.result.path for entry in history.of(serial)}
    lines = list(note_sentences(history.notes, concerned))
    if lines:
        blocks.append(Bullets(lines, "Notes:", "  "))
    return page_text(Page("History", str(history.folder), (Section(lambda: blocks),)))


def _robots(history: History) -> Iterator[Block]:
    """Count the robots, and show the state of each."""
    count = sum(map(len, history.robots.values()))
    robots = plural(len(history.robots), "robot")
    yield Paragraph(f"{robots} with {plural(count, 'calibration')} in {history.folder}")
    if not count:
        yield Paragraph(
            "No result file of a robot with a serial number is there. Results are written by 'calib calibrate --json' "
            "and 'calib fleet'; the serial number is [record] robot_serial in the cell file, or column serial of a "
            "fleet's manifest."
        )
    columns = [
        name_column("robot"),
        Column("calibrations"),
        Column("last", left=True, gap=2),
        Column("verdict", left=True, gap=2),
        Column("valid now", left=True, gap=2),
    ]
    rows: list[Row] = []
    for serial, entries in history.robots.items():
        last = entries[-1].result
        verdict = last.verdict or "none"
        rows.append((serial, len(entries), _date(last.date), verdict, _valid_now(entries)))
    yield Table("robot", columns, rows)


def _valid_now(entries: tuple[Entry, ...]) -> str:
    """Name the calibration that is valid now, or say why there is none."""
    for entry in entries:
        if entry.is_valid:
            return entry.result.run[:_RUN_DIGITS]
    for entry in reversed(entries):
        if entry.end == "check failed" and entry.until is not None:
            return f"none: check failed on {_date(entry.until)} ({entry.by})"
    return "none: every verdict is 'do not use'"


def _calibrations(serial: str, entries: tuple[Entry, ...]) -> Iterator[Block]:
    """Show the calibrations of a robot, and from when to when each was valid."""
    yield Paragraph(f"{serial}: {plural(len(entries), 'calibration')}")
    columns = [
        name_column("run"),
        Column("date", left=True, gap=2),
        Column("verdict", left=True, gap=2),
        Column("valid until", left=True, gap=2),
        Column("file", left=True, gap=2),
    ]
    rows: list[Row] = []
    for entry in entries:
        result = entry.result
        date = f"{_date(result.date)}{_SOURCES[result.date_from]}"
        run = result.run[:_RUN_DIGITS]
        verdict = result.verdict or "none"
        rows.append((run, date, verdict, _until(entry), result.path))
    yield Table("run", columns, rows)


def _until(entry: Entry) -> str:
    """Say until when a calibration was valid, and why no longer."""
    if entry.end == "never":
        return "never"
    accepted = " (accepted)" if entry.accepted else ""
    if entry.until is None:
        return f"now{accepted}"
    why = "replaced" if entry.end == "replaced" else f"check failed: {entry.by}"
    return f"{_date(entry.until)} {why}{accepted}"


def _date(date: datetime) -> str:
    """Write a date, and its time of day unless that is midnight."""
    return date_text(date).removesuffix("T00:00:00Z")


def note_sentences(notes: tuple[Note, ...], concerned: set[str]) -> Iterator[str]:
    """Write notes as sentences, of each kind the first ones.

    Args:
        notes: The notes.
        concerned: Files of the robot that is shown: notes on others are left out, apart from those on damaged files,
            which may be this robot's; empty: no note is left out.

    Yields:
        The sentences.
    """
    for what in What:
        of_kind = [
            note
            for note in notes
            if note.what is what
            and (not concerned or what is What.DAMAGED or concerned.intersection(note.paths))
        ]
        for note in of_kind[:_MOST_NOTES]:
            yield _SENTENCES[what].format(
                files=_files(note.paths), first=note.paths[0], last=note.paths[-1], text=note.text
            )
        if len(of_kind) > _MOST_NOTES:
            yield f"and {len(of_kind) - _MOST_NOTES} more like these; --json lists all."


def _files(paths: tuple[str, ...]) -> str:
    """Name files, the first few of many."""
    named = ", ".join(paths[:_MOST_FILES])
    more = len(paths) - _MOST_FILES
    return f"{named} and {more} more" if more > 0 else named
