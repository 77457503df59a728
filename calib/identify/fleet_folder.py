"""fleet_folder: the results of a fleet on the disk, one folder a robot, each whole or not there.

A robot's files go into a folder beside its own, then to the disk, then the folder gets the robot's name. With them goes
``made.json``: the fingerprint of all that they hang on, their own hashes, and the robot's row of the fleet's table. By
these a later run knows what it may keep, and which files are its own: any other file in a robot's folder is somebody's,
and goes with the folder. A folder is replaced by a whole new one only.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Mapping
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
    """The folder of a fleet, made if missing, for this run alone; what killed runs have left in it is put in order.

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
        _put_in_order(path)
        yield
    finally:
        file.close()


def kept_row(folder: Path, told: Collection[str], names: Collection[str] = ()) -> FleetRow | None:
    """The row of a robot whose folder is whole and was made of just this; None of any other.

    Args:
        folder: The robot's.
        told: The fingerprints that its inputs may have.
        names: Files that it must have; it may have more.
    """
    table = _made_table(folder)
    if table is None or table.get("fingerprint") not in told:
        return None
    try:
        if not set(names) <= table["files"].keys():
            return None
        for name, wanted in table["files"].items():
            if hashlib.sha256(_own_bytes(folder / name)).hexdigest() != wanted:
                return None
        return FleetRow.read(table["row"])
    except (OSError, KeyError, TypeError, AttributeError):
        return None


def holds_result(folder: Path) -> bool:
    """Whether a robot's folder is there and an earlier run has made it."""
    return _made_table(folder) is not None


def write_folder(
    folder: Path, told: str, row: FleetRow, files: Mapping[str, bytes]
) -> tuple[str, ...]:
    """Write a robot's folder, in the place of one that an earlier run made; files of other origin move into it.

    Returns:
        Names of the earlier run's files that have no successor and are gone.

    Raises:
        FileError: Something else has its name or that of a file, or it cannot be written.
    """
    table = {
        "schema": SCHEMA,
        "fingerprint": told,
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in files.items()},
        "row": row.table(),
    }
    check_own(folder)
    own = _own_files(folder)
    _check_free(folder, own, files)
    new = folder.with_name(f".calib-new-{secrets.token_hex(8)}")
    try:
        new.mkdir()
        for name, data in (*files.items(), (MADE, json_bytes(table))):
            with (new / name).open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        _sync(new)
        _swap(new, folder)
    except OSError as error:
        message = f"{folder}: this folder cannot be written: {error.strerror}."
        raise FileError(message) from error
    finally:
        shutil.rmtree(new, ignore_errors=True)
    return tuple(sorted(own - {MADE, *files}))


def _swap(new: Path, folder: Path) -> None:
    """Give a new folder the name of an old one, and what lay in that and is not calib's.

    A kill at any point leaves what `_put_in_order` brings to one of both ends.
    """
    old = None
    if folder.exists():
        old = folder.with_name(f".calib-old-{secrets.token_hex(8)}")
        try:
            folder.rename(old)
        except OSError as error:
            message = f"{folder}: this folder cannot be replaced: {error.strerror}."
            raise FileError(message) from error
    try:
        new.rename(folder)
    except OSError:
        if old is not None:
            old.rename(folder)
        raise
    if old is not None:
        _empty(old, folder)
    _sync(folder.parent)


def _empty(old: Path, folder: Path) -> None:
    """Move what is not calib's from an old folder into the new one, and remove the rest; no file is written over."""
    own = _own_files(old)
    for entry in [*old.iterdir()]:
        if entry.name not in own and not os.path.lexists(folder / entry.name):
            entry.rename(folder / entry.name)
    if all(entry.name in own for entry in old.iterdir()):
        shutil.rmtree(old, ignore_errors=True)


def _put_in_order(path: Path) -> None:
    """Finish what killed runs have begun: folders half written are removed, half replaced ones are one again."""
    for entry in [*path.iterdir()]:
        match = _TEMPORARY.fullmatch(entry.name)
        if match is None:
            continue
        if match[1] == "new":
            shutil.rmtree(entry, ignore_errors=True)
            continue
        row = (_made_table(entry) or {}).get("row")
        name = row.get("name") if isinstance(row, dict) else None
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            continue
        with contextlib.suppress(OSError):
            if os.path.lexists(path / name):
                _empty(entry, path / name)
            else:
                entry.rename(path / name)


def _own_files(folder: Path) -> set[str]:
    """Names of the files in a robot's folder that calib has written; of no folder none."""
    table = _made_table(folder)
    files = None if table is None else table.get("files")
    return set() if table is None else {MADE, *(files if isinstance(files, dict) else ())}


def _check_free(folder: Path, own: Collection[str], names: Iterable[str]) -> None:
    """Refuse to write over a file of other origin in a robot's folder.

    Raises:
        FileError: There is one with a name that is needed.
    """
    for name in names:
        if name not in own and os.path.lexists(folder / name):
            message = (
                f"{folder / name} is a file of other origin, and the result has one of that name; move it away and "
                "give the same command again."
            )
            raise FileError(message)


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


def _own_bytes(path: Path) -> bytes:
    """A file that calib wrote; what stands in its place and is no file, such as a pipe, would not end.

    Raises:
        OSError: It is not there, or no file.
    """
    if not stat.S_ISREG(path.lstat().st_mode):
        raise FileNotFoundError(path)
    return path.read_bytes()


def _made_table(folder: Path) -> dict[str, Any] | None:
    """What `MADE` says in a folder; None where there is no such file."""
    try:
        table = json.loads(_own_bytes(folder / MADE))
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
