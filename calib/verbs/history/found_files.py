"""The files of a history: results, checks and corrected URDFs in a folder and those below it.

Files are told apart by what they hold, not by their names. Of a result only what a history needs is kept; its checksums
show whether it was changed. A file that cannot be read is noted, and the others are read.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from enum import Enum, auto
from pathlib import Path
from typing import Any

from calib.basics.dates import parse_date
from calib.basics.files import read_bytes
from calib.basics.json_files import Json, damage, parse_json, parsed_digest
from calib.errors import CalibError, FileError
from calib.result.calibration_file import EXPECTED, SCHEMA, check_unchanged

#: The comment of a corrected URDF that states its run, see `calib.robot.urdf.Urdf.with_comments`.
_RUN = re.compile(rb"<!--\s*calib run: ([0-9a-f]{12})\s*-->")

#: The beginning of another JSON file of calib, which need not be parsed.
_OTHER = re.compile(rb'\s*\{\s*"schema"\s*:\s*"(?!evaluation )')

#: Robots that an evaluation may judge, and that are not the calibrated one.
_NOT_CALIBRATED = ("nominal",)


class DateFrom(Enum):
    """Source of a file's date."""

    #: The record of the measurement
    MEASURED = auto()
    #: The file states when it was made
    CALIBRATED = auto()
    #: Neither is stated: the date of the file itself
    FILE = auto()


class What(Enum):
    """Subject of a note of a history."""

    #: A file cannot be read, is damaged, or was changed; with the message
    DAMAGED = auto()
    #: A record states a date in another form than ISO 8601; with the date
    OTHER_DATE = auto()
    #: The date of a file is that of the file system
    FILE_DATE = auto()
    #: Results have no serial number
    NO_SERIAL = auto()
    #: A file holds the run of another one
    COPY = auto()
    #: A run stands under several serial numbers
    SHARED_RUN = auto()
    #: Two results of a robot have the same date
    SAME_DATE = auto()
    #: A corrected URDF is not what its result says
    CHANGED_URDF = auto()


@dataclass(frozen=True, slots=True)
class Note:
    """Something that is to be said about files of a history."""

    #: What it is
    what: What
    #: The files that it is about, in the folder; of `What.COPY` and `What.SAME_DATE` the one that counts comes last
    paths: tuple[str, ...]
    #: Message, date, or serial numbers
    text: str = ""


@dataclass(frozen=True, slots=True)
class FoundResult:
    """The file of a calibration result."""

    #: Its path in the folder
    path: str
    #: SHA-256 of its bytes
    sha256: str
    #: Id of its run; that of a file of version 0.1.0 is its hash
    run: str
    #: Serial number of the robot; empty if it is not known
    serial: str
    #: When it was measured, else when it was calibrated, else the date of the file
    date: datetime
    date_from: DateFrom
    #: When it was calibrated, as stated; empty if it is not
    calibrated_on: str
    #: Such as ``"use"``; empty without cross-validation
    verdict: str
    #: Code of the first reason of the verdict; empty without
    reason: str
    #: Parameter set of the geometry
    model: str
    #: Name of the table that was measured
    data: str
    #: SHA-256 of the corrected URDF; empty if an earlier version wrote the result
    urdf_sha256: str


@dataclass(frozen=True, slots=True)
class FoundCheck:
    """The file of an acceptance test of a robot, by ``calib evaluate --tolerance``."""

    #: Its path in the folder
    path: str
    #: Serial number of the robot; empty if it is not known
    serial: str
    #: When it was measured, else when it was evaluated, else the date of the file
    date: datetime
    #: ``"pass"``, ``"undecided"`` or ``"fail"``
    outcome: str
    #: SHA-256 of the URDF that was tested
    urdf_sha256: str


@dataclass(frozen=True, slots=True)
class FoundUrdf:
    """A corrected URDF, which states its run."""

    #: Its path in the folder
    path: str
    run: str
    #: SHA-256 of its bytes
    sha256: str


@dataclass(frozen=True, slots=True)
class FoundFiles:
    """All files of a history, ordered by their paths."""

    results: tuple[FoundResult, ...]
    checks: tuple[FoundCheck, ...]
    urdfs: tuple[FoundUrdf, ...]
    notes: tuple[Note, ...]


def find_files(folder: Path, *, by_folder: bool) -> FoundFiles:
    """Read the files of a history in a folder and those below it; hidden files and folders are left out.

    Args:
        folder: The folder.
        by_folder: Whether a result without a serial number has the name of its folder as one.

    Returns:
        The files, and notes on those that cannot be read and on their dates.

    Raises:
        FileError: There is no such folder.
    """
    if not folder.is_dir():
        raise FileError(
            f"'{folder}' is no folder; name the folder in which the results are, in any folders below it."
        )
    results: list[FoundResult] = []
    checks: list[FoundCheck] = []
    urdfs: list[FoundUrdf] = []
    notes: list[Note] = []
    for path in _visible_files(folder):
        name = path.relative_to(folder).as_posix()
        try:
            if path.suffix.lower() == ".urdf":
                data = read_bytes(path, "URDF")
                match = _RUN.search(data)
                if match is not None:
                    sha256 = hashlib.sha256(data).hexdigest()
                    urdfs.append(FoundUrdf(name, match[1].decode(), sha256))
                continue
            data = read_bytes(path, "file")
            if _OTHER.match(data):
                continue
            table = parse_json(data, name, whole=True)
            schema = table.get("schema") if isinstance(table, dict) else None
            if isinstance(schema, str) and schema.startswith("evaluation "):
                checks.extend(_checks(table, path, name, notes))
            elif isinstance(schema, int) and "robot" in table:
                if schema != SCHEMA:
                    raise FileError(f"its 'schema' is {schema}; {EXPECTED}")
                check_unchanged(table, name, parsed_digest)
                sha256 = hashlib.sha256(data).hexdigest()
                results.append(_result(table, path, name, sha256, by_folder, notes))
        except CalibError as error:
            notes.append(Note(What.DAMAGED, (name,), str(error).removeprefix(f"{name}: ")))
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            notes.append(Note(What.DAMAGED, (name,), f"the file is damaged ({damage(error)})."))
    return FoundFiles(tuple(results), tuple(checks), tuple(urdfs), tuple(notes))


def _visible_files(folder: Path) -> Iterator[Path]:
    """Yield the JSON files and URDFs below a folder, sorted, without hidden ones and those in hidden folders."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_dir():
            if not path.is_symlink():  # which may lead in a circle
                yield from _visible_files(path)
        elif path.suffix.lower() in (".json", ".urdf"):
            yield path


def _result(
    table: Json, path: Path, name: str, sha256: str, by_folder: bool, notes: list[Note]
) -> FoundResult:
    """Return what a history needs of a result's tables, and add notes on its date."""
    record = table.get("record") or {}
    serial = str(record.get("robot_serial") or "")
    if not serial and by_folder:
        serial = path.resolve().parent.name
    date, date_from = _date(table, path, name, notes)
    verdict: Any = table["verdict"] or {}
    reasons = verdict.get("reasons") or ()
    outputs = table.get("outputs") or {}
    return FoundResult(
        path=name,
        sha256=sha256,
        run=str(table.get("run") or sha256),
        serial=serial,
        date=date,
        date_from=date_from,
        calibrated_on=str(table.get("time") or ""),
        verdict=str(verdict.get("use") or ""),
        reason=str(reasons[0]["code"]) if reasons else "",
        model=str(table["model"]["set"]),
        data=str(table["inputs"]["measurements"]["name"]),
        urdf_sha256=str(outputs["urdf"]["sha256"]) if outputs else "",
    )


def _checks(table: Json, path: Path, name: str, notes: list[Note]) -> Iterator[FoundCheck]:
    """Yield the acceptance test of an evaluation, if it has one of the calibrated robot, and add notes on its date."""
    accepted = table["acceptance"]
    if accepted is None or accepted["robot"] in _NOT_CALIBRATED:
        return
    date, _ = _date(table, path, name, notes)
    record = table.get("record") or {}
    yield FoundCheck(
        path=name,
        serial=str(record.get("robot_serial") or ""),
        date=date,
        outcome=str(accepted["outcome"]),
        urdf_sha256=str(table["inputs"]["urdf"]["sha256"]),
    )


def _date(table: Json, path: Path, name: str, notes: list[Note]) -> tuple[datetime, DateFrom]:
    """Return the date of a result or check, and where it is from; add a note if it is not the one that was wanted."""
    stated = str((table.get("record") or {}).get("date") or "")
    measured = parse_date(stated)
    if measured is not None:
        return measured, DateFrom.MEASURED
    if stated:
        notes.append(Note(What.OTHER_DATE, (name,), stated))
    made = parse_date(str(table.get("time") or ""))
    if made is not None:
        return made, DateFrom.CALIBRATED
    notes.append(Note(What.FILE_DATE, (name,)))
    modified = datetime.fromtimestamp(int(path.stat().st_mtime), timezone.utc)
    return modified, DateFrom.FILE
