"""fleet_folder: the results of a fleet on the disk, one folder a robot, each whole or not there.

A robot's files go into a folder beside its own, then to the disk, then the folder gets the robot's name. With them goes
``made.json``: the fingerprint of all that they hang on, their own hashes, and the robot's row of the fleet's table. By
these a later run knows what it may keep.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
import shutil
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from calib.errors import CalibError, FileError
from calib.identify.fleet_rows import FleetRow
from calib.identify.journal import lock
from calib.model.files import make_folder
from calib.model.json_file import json_bytes

#: Beside a robot's files.
MADE = "made.json"
SCHEMA = "fleet robot 1"

_LOCK = ".calib-fleet.lock"
_TEMPORARY = re.compile(r"\.calib-(new|old)-[0-9a-f]{16}")

#: Letters and digits of any script, and a few signs; no dot in front, no blank at an end.
_NAME = re.compile(r"[^\W_](?:[\w .+-]{0,98}[\w+-])?")
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?|fleet\.(csv|json)", re.IGNORECASE)
_LONGEST_BYTES = 200


def check_names(names: Iterable[tuple[str, str]]) -> None:
    """Refuse names that are no folders' names, or not everywhere, or those of two robots.

    Args:
        names: Each with where it stands, for the message.

    Raises:
        CalibError: One of them.
    """
    seen: dict[str, tuple[str, str]] = {}
    for name, where in names:
        fits = _NAME.fullmatch(name) and len(name.encode("utf-8", "replace")) <= _LONGEST_BYTES
        if not fits or _RESERVED.fullmatch(name):
            message = (
                f"{where}: the name {name!r} cannot be that of a folder. A name has 1 to 100 letters, digits, and '_', "
                "'-', '+', '.' or blanks between them, and is none that systems keep for themselves."
            )
            raise CalibError(message)
        key = unicodedata.normalize("NFKC", name).casefold()
        if key in seen:
            other, place = seen[key]
            message = (
                f"{where}: the name '{name}' is that of another robot, '{other}' ({place}); folders may not tell "
                "capital letters. Give each robot a name of its own."
            )
            raise CalibError(message)
        seen[key] = name, where


@contextmanager
def results_folder(path: Path) -> Iterator[None]:
    """The folder of a fleet, made if missing, for this run alone; what killed runs have left in it is removed.

    Raises:
        FileError: It cannot be made, or another run has it.
    """
    make_folder(path)
    try:
        file = (path / _LOCK).open("a+b")
    except OSError as error:
        message = f"{path}: nothing can be written there: {error.strerror}. Choose another folder."
        raise FileError(message) from error
    try:
        lock(file, path)
        for entry in path.iterdir():
            if _TEMPORARY.fullmatch(entry.name):
                shutil.rmtree(entry, ignore_errors=True)
        yield
    finally:
        file.close()


def kept_row(folder: Path, told: str) -> FleetRow | None:
    """The row of a robot whose folder is whole and was made of just this; None of any other.

    Args:
        folder: The robot's.
        told: The fingerprint of its inputs.
    """
    table = _made_table(folder)
    if table is None or table.get("fingerprint") != told:
        return None
    try:
        for name, wanted in table["files"].items():
            if hashlib.sha256((folder / name).read_bytes()).hexdigest() != wanted:
                return None
        return FleetRow.read(table["row"])
    except (OSError, KeyError, TypeError, AttributeError):
        return None


def write_folder(folder: Path, told: str, row: FleetRow, files: Mapping[str, bytes]) -> None:
    """Write a robot's folder, in the place of one that an earlier run made.

    Raises:
        FileError: Something else has its name, or it cannot be written.
    """
    table = {
        "schema": SCHEMA,
        "fingerprint": told,
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in files.items()},
        "row": row.table(),
    }
    new = folder.with_name(f".calib-new-{secrets.token_hex(8)}")
    try:
        new.mkdir()
        for name, data in (*files.items(), (MADE, json_bytes(table))):
            with (new / name).open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        _sync(new)
        remove_folder(folder)
        new.rename(folder)
        _sync(folder.parent)
    except OSError as error:
        message = f"{folder}: this folder cannot be written: {error.strerror}."
        raise FileError(message) from error
    finally:
        shutil.rmtree(new, ignore_errors=True)


def remove_folder(folder: Path) -> None:
    """Remove the folder of a robot, at once and not file by file; one that is not there is no matter.

    Raises:
        FileError: It is none that a fleet's run has made.
    """
    check_own(folder)
    if folder.exists():
        old = folder.with_name(f".calib-old-{secrets.token_hex(8)}")
        try:
            folder.rename(old)
        except OSError as error:
            message = f"{folder}: this folder cannot be replaced: {error.strerror}."
            raise FileError(message) from error
        shutil.rmtree(old, ignore_errors=True)


def check_own(folder: Path) -> None:
    """Refuse to touch what no fleet's run has made.

    Raises:
        FileError: A folder or file of another origin has the name.
    """
    if os.path.lexists(folder) and _made_table(folder) is None:
        message = (
            f"{folder} exists already and was not made by 'calib fleet'; move it away, or choose another folder for "
            "the results."
        )
        raise FileError(message)


def strangers(path: Path, names: Iterable[str]) -> tuple[str, ...]:
    """Robots whose results lie in a fleet's folder and that are none of these."""
    known = set(names)
    found = (entry.name for entry in path.iterdir() if entry.name not in known)
    return tuple(sorted(name for name in found if _made_table(path / name) is not None))


def _made_table(folder: Path) -> dict[str, Any] | None:
    """What `MADE` says in a folder; None where there is no such file."""
    try:
        table = json.loads((folder / MADE).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return table if isinstance(table, dict) and table.get("schema") == SCHEMA else None


def _sync(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the system can."""
    with contextlib.suppress(OSError):
        place = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(place)
        finally:
            os.close(place)
