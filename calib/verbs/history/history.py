"""History of a fleet: which calibration of each robot was valid when, and why it no longer is.

A calibration is valid from its date (when it was measured if the record says so, else when it was calibrated) until the
next one of the same robot replaces it, or a check of the robot fails. One whose verdict is ``do not use`` is never
valid, unless its corrected URDF was written all the same: then a URDF of its run is in the folder.

Everything is read from the files of a folder, each time; `calib.verbs.history.found_files` finds them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise, product
from pathlib import Path
from typing import Any, Literal

from calib.basics.arguments import check_flags, check_path, check_type
from calib.basics.dates import date_text, parse_date
from calib.basics.files import read_bytes
from calib.basics.values import Value, keep_read_only, one_line, shown_by
from calib.diagnosis.reasons import NO
from calib.errors import CalibError, VerdictError, choices, did_you_mean
from calib.result.calibration import Calibration
from calib.result.calibration_file import read_result, write_table
from calib.robot.urdf import Urdf
from calib.show.verdict_text import do_not_use_text, refusal
from calib.verbs.history.found_files import (
    FoundCheck,
    FoundFiles,
    FoundResult,
    FoundUrdf,
    Note,
    What,
    find_files,
)

#: Schema of `History.table`.
SCHEMA = "history 1"

#: Digits of a hash or a run that it takes to name a calibration.
_FEWEST_DIGITS = 6

#: What ended the time in which a calibration was valid; ``""``: nothing, it is valid; ``"never"``: it never was.
End = Literal["", "replaced", "check failed", "never"]


@dataclass(frozen=True, slots=True)
class Entry:
    """A calibration in a robot's history."""

    #: Its file
    result: FoundResult
    #: Whether a URDF of it was written in spite of the verdict ``do not use``
    accepted: bool = False
    #: What ended the time in which it was valid
    end: End = ""
    #: When; None while it is valid, and if it never was
    until: datetime | None = None
    #: The file that ended it: the next result, or the check; empty without
    by: str = ""

    @property
    def is_valid(self) -> bool:
        """True if it is the calibration that is valid now."""
        return self.end == ""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class History(Value):
    """The calibrations of a fleet over time, the result of `calib.history`."""

    #: The folder of the files
    folder: Path
    #: By serial number, the calibrations from the first to the last
    robots: Mapping[str, tuple[Entry, ...]]
    #: What is to be said about files
    notes: tuple[Note, ...]
    #: Corrected URDFs that are what their results say
    urdfs: tuple[FoundUrdf, ...] = ()

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "robots")

    def __repr__(self) -> str:
        """Return one line: numbers of robots, calibrations and notes."""
        count = sum(map(len, self.robots.values()))
        return one_line(
            "History",
            f"{len(self.robots)} robots",
            f"{count} calibrations",
            f"{len(self.notes)} notes",
        )

    def summary(self, serial: str | None = None) -> str:
        """Return the history as text, without colours.

        Args:
            serial: Of this robot, a line for each calibration; None: a line for each robot.

        Returns:
            The table, and the notes.

        Raises:
            CalibError: There is no robot of this serial number.
        """
        if serial is not None:
            self.of(serial)
        return str(shown_by("verbs.history.text").history_text(self, serial))

    def of(self, serial: str) -> tuple[Entry, ...]:
        """Return the calibrations of a robot, from the first to the last; CalibError if there is no such robot."""
        if serial not in self.robots:
            names = choices(self.robots) if self.robots else "none"
            raise CalibError(
                f"No result in '{self.folder}' has the serial number '{serial}'"
                f"{did_you_mean(serial, self.robots)}; there are {names}. Results state it if the cell has [record] "
                "with robot_serial; of others --by-folder (in Python by_folder=True) takes the name of the folder."
            )
        return self.robots[serial]

    def valid_on(self, serial: str, date: str | datetime) -> Entry | None:
        """Return the calibration that was valid on a date.

        Args:
            serial: Serial number of the robot.
            date: A date, see `calib.basics.dates`; a day without a time of day means its end.

        Returns:
            The calibration; None if none was valid then.

        Raises:
            CalibError: There is no such robot, or it is no date.
        """
        when = date if isinstance(date, datetime) else _end_of(date)
        if when is None:
            raise CalibError(f"'{date}' is no date; write it as 2026-03-01 or 2026-03-01 14:30.")
        for entry in self.of(serial):
            begun = entry.end != "never" and entry.result.date <= when
            if begun and (entry.until is None or when < entry.until):
                return entry
        return None

    def restore(
        self,
        serial: str,
        which: str,
        path: str | Path,
        *,
        overwrite: bool = False,
        accept: bool = False,
    ) -> Entry:
        """Write the corrected URDF of an earlier calibration again, byte for byte.

        Args:
            serial: Serial number of the robot.
            which: A date on which it was valid; or the first digits, 6 or more, of the calibration's run, or of the
                SHA-256 of its corrected URDF or of its result file.
            path: The URDF to write.
            overwrite: Whether a file that exists is replaced.
            accept: Whether it is written also where the verdict is ``do not use``.

        Returns:
            The calibration.

        Raises:
            ArgumentError: An argument of another type.
            CalibError: There is no such robot, none of its calibrations is meant or several are, or the URDF that this
                version writes is not the one that the result states.
            VerdictError: The verdict is ``do not use``, and ``accept`` is not given.
            FileError: The result cannot be read, or the file exists or cannot be written.
        """
        check_type("which", which, str, "a date, or the first digits of a run or a hash")
        check_path("path", path)
        entry, sha256 = self._meant(serial, which)
        result = read_result(self.folder / entry.result.path)
        if entry.result.verdict == NO and not accept:
            raise VerdictError(refusal(f"'{path}'", do_not_use_text(result.verdict)))
        urdf = result.checked_urdf()
        wanted = sha256 or entry.result.urdf_sha256
        if wanted and urdf.sha256 != wanted:
            urdf = self._stored(wanted, entry, urdf)
        urdf.write(path, overwrite=overwrite)
        return entry

    def _meant(self, serial: str, which: str) -> tuple[Entry, str]:
        """Return the calibration that a date or hash means, and the hash of its URDF if that was given, else ``""``."""
        entries = self.of(serial)
        if parse_date(which) is not None:
            entry = self.valid_on(serial, which)
            if entry is None:
                raise CalibError(f"No calibration of '{serial}' was valid on {which}.")
            return entry, ""
        digits = which.strip().lower()
        found: dict[str, tuple[Entry, str]] = {}
        for entry in entries:
            of_run = [urdf.sha256 for urdf in self.urdfs if urdf.run == entry.result.run]
            for sha256 in {*of_run, entry.result.urdf_sha256} - {""}:
                if sha256.startswith(digits):
                    found[entry.result.path] = (entry, sha256)
            if entry.result.run.startswith(digits) or entry.result.sha256.startswith(digits):
                found[entry.result.path] = (entry, "")
        if len(digits) < _FEWEST_DIGITS or len(found) != 1:
            runs = choices((entry.result.run for entry in entries), limit=12)
            count = "several" if len(found) > 1 else "none"
            raise CalibError(
                f"'{which}' is neither a date such as 2026-03-01 nor {_FEWEST_DIGITS} or more digits of a run or hash "
                f"of one calibration of '{serial}' ({count} begin so). Its runs are {runs}."
            )
        return next(iter(found.values()))

    def _stored(self, sha256: str, entry: Entry, made: Urdf) -> Urdf:
        """Return the URDF of this hash among those in the folder; CalibError if there is none."""
        for urdf in self.urdfs:
            if urdf.sha256 == sha256:
                return Urdf.from_bytes(
                    read_bytes(self.folder / urdf.path, "URDF"), made.source, made.path
                )
        raise CalibError(
            f"The URDF that this version makes of {entry.result.path} is not, byte for byte, the one that was written "
            f"then (SHA-256 {sha256[:12]}...), and no file in '{self.folder}' is. Its joint origins are the same: "
            f"calib convert {entry.result.path} --to urdf writes it."
        )

    def table(self) -> dict[str, Any]:
        """Return the history as nested tables of plain values; docs/history.md has the keys."""
        robots = []
        for serial, entries in self.robots.items():
            calibrations = []
            for entry in entries:
                result = entry.result
                calibrations.append(
                    {
                        "file": result.path,
                        "run": result.run,
                        "date": date_text(result.date),
                        "date_from": result.date_from.name.lower(),
                        "calibrated_on": result.calibrated_on or None,
                        "verdict": result.verdict or None,
                        "reason": result.reason or None,
                        "accepted": entry.accepted,
                        "end": entry.end or None,
                        "until": None if entry.until is None else date_text(entry.until),
                        "by": entry.by or None,
                        "result_sha256": result.sha256,
                        "urdf_sha256": result.urdf_sha256 or None,
                    }
                )
            robots.append({"serial": serial, "calibrations": calibrations})
        notes = [
            {"code": note.what.name.lower(), "files": list(note.paths), "text": note.text}
            for note in self.notes
        ]
        return {"schema": SCHEMA, "robots": robots, "notes": notes}

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the history as JSON.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        return write_table(self.table(), path, overwrite=overwrite)


def history(folder: str | Path, *, by_folder: bool = False) -> History:
    """Read which calibration of each robot was valid when from the result files in a folder and those below it.

    Results are told apart by the serial number of the robot in their record. Evaluations with an acceptance test, and
    corrected URDFs, are found too.

    Args:
        folder: The folder.
        by_folder: Whether a result without a serial number has the name of its folder as one.

    Returns:
        The calibrations of each robot, from the first to the last, and notes on damaged files, copies, results without
        serial number or of the same date, and URDFs that were changed.

    Raises:
        ArgumentError: An argument of another type.
        FileError: There is no such folder.

    Example:
        history = calib.history("fleet")
        history.restore("SN-17", "2026-03-01", "corrected.urdf")
    """
    check_type("folder", folder, (str, Path), "the path of a folder")
    check_flags(by_folder=by_folder)
    place = Path(folder)
    files = find_files(place, by_folder=by_folder)
    notes = list(files.notes)
    results = list(_without_copies(files.results, notes))
    nameless = tuple(result.path for result in results if not result.serial)
    if nameless:
        notes.append(Note(What.NO_SERIAL, nameless))
    urdfs = tuple(_unchanged(files, place, notes))
    runs_with_urdf = {urdf.run for urdf in files.urdfs}

    by_serial: dict[str, list[FoundResult]] = {}
    for result in results:
        if result.serial:
            by_serial.setdefault(result.serial, []).append(result)
    robots = {}
    for serial in sorted(by_serial):
        in_order = sorted(by_serial[serial], key=_order)
        notes += [
            Note(What.SAME_DATE, (earlier.path, later.path))
            for earlier, later in pairwise(in_order)
            if earlier.date == later.date
        ]
        robots[serial] = tuple(_entries(serial, in_order, files.checks, runs_with_urdf))
    return History(place, robots, tuple(notes), urdfs)


def _order(result: FoundResult) -> tuple[datetime, str, str]:
    """Return by what the results of a robot are ordered: date, then when they were calibrated, then path."""
    return result.date, result.calibrated_on, result.path


def _end_of(text: str) -> datetime | None:
    """Return the date of a text, at the end of the day if it states no time of day; None if it is no date."""
    stated = text.strip()
    return parse_date(stated) if ":" in stated else parse_date(f"{stated} 23:59:59.999999")


def _without_copies(results: Sequence[FoundResult], notes: list[Note]) -> Iterator[FoundResult]:
    """Yield the results, of each run of a robot the first; add notes on copies and on runs of several robots."""
    first: dict[tuple[str, str], FoundResult] = {}
    serials: dict[str, list[FoundResult]] = {}
    for result in sorted(results, key=_order):
        key = (result.run, result.serial)
        if key in first:
            notes.append(Note(What.COPY, (result.path, first[key].path)))
            continue
        first[key] = result
        serials.setdefault(result.run, []).append(result)
        yield result
    for same in serials.values():
        if len(same) > 1:
            names = choices(result.serial or "none" for result in same)
            notes.append(Note(What.SHARED_RUN, tuple(r.path for r in same), names))


def _entries(
    serial: str,
    results: Sequence[FoundResult],
    checks: Sequence[FoundCheck],
    runs_with_urdf: set[str],
) -> Iterator[Entry]:
    """Yield the calibrations of a robot, from the first to the last, with the time in which each was valid."""
    accepted = [result.verdict == NO and result.run in runs_with_urdf for result in results]
    usable = [result.verdict != NO or accepted[i] for i, result in enumerate(results)]
    hashes = {result.urdf_sha256 for result in results} - {""}
    of_robot = [
        check
        for check in checks
        if check.serial == serial or (not check.serial and check.urdf_sha256 in hashes)
    ]
    for i, result in enumerate(results):
        if not usable[i]:
            yield Entry(result, end="never")
            continue
        end: End = ""
        until, by = None, ""
        later = [other for j, other in enumerate(results) if j > i and usable[j]]
        if later:
            end, until, by = "replaced", later[0].date, later[0].path
        for check in of_robot:
            # A check of the URDF of another calibration says nothing about this one.
            of_this = check.urdf_sha256 == result.urdf_sha256
            if check.outcome != "fail" or (check.urdf_sha256 in hashes and not of_this):
                continue
            # On the day of the calibration itself another URDF was checked, unless it is this one.
            begun = result.date < check.date or (of_this and result.date == check.date)
            if begun and (until is None or check.date < until):
                end, until, by = "check failed", check.date, check.path
        yield Entry(result, accepted[i], end, until, by)


def _unchanged(files: FoundFiles, folder: Path, notes: list[Note]) -> Iterator[FoundUrdf]:
    """Yield the corrected URDFs that are what their results say; add notes on those that were changed since.

    URDFs whose result is not in the folder are left out.
    """
    by_run: dict[str, FoundResult] = {}
    for result in files.results:
        by_run.setdefault(result.run, result)
    for urdf in files.urdfs:
        found = by_run.get(urdf.run)
        if found is None:
            continue
        if urdf.sha256 == found.urdf_sha256:
            yield urdf
            continue
        # It may have links at targets or frames, or an earlier version made it, whose results do not state the hash.
        try:
            written = _hashes(read_result(folder / found.path))
        except CalibError as error:
            notes.append(Note(What.DAMAGED, (found.path,), str(error)))
            continue
        if urdf.sha256 in written:
            yield urdf
        else:
            notes.append(Note(What.CHANGED_URDF, (urdf.path, found.path)))


def _hashes(result: Calibration) -> set[str]:
    """Return the hashes of the URDFs that may have been written of a result: with and without links, of each robot."""
    hashes = set()
    for target_link, frame_link in product((False, True), repeat=2):
        try:
            urdf = result.checked_urdf(target_link=target_link, frame_link=frame_link)
        except CalibError:  # no frame has a pose, or another link has the name
            continue
        hashes.add(urdf.sha256)
    verdict_against = do_not_use_text(result.verdict)
    if result.robot.parts:
        for own in result.robot.own_urdfs().values():
            described = own.with_comments(run=result.run, verdict=verdict_against)
            hashes.add(described.sha256)
    return hashes
