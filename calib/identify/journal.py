"""journal: finished parts of a long run, kept beside its result so that a run that was killed can go on.

Each record is one line of JSON behind the SHA-256 of it, appended and brought to the disk. What a kill leaves of a line
does not match its sum, and is cut off when the journal is opened again. The first line says what the run was, by a
`fingerprint`: another run's records are never used.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import IO, Any

from calib.errors import FileError
from calib.model.files import read_bytes

Record = dict[str, Any]

_DIGITS = 64

#: What is written is brought to the disk no more often than this [s].
_SYNCED = 1.0


@contextmanager
def journal(
    path: str | Path | None, run: str, *, overwrite: bool = False
) -> Iterator[tuple[list[Record], Callable[[Record], None]]]:
    """Open a journal, or begin it.

    Args:
        path: Its file; None: nothing is kept.
        run: The fingerprint of all that the records hang on.
        overwrite: Whether the journal of another run may be replaced.

    Yields:
        The records of an earlier run, and a function that appends one.

    Raises:
        FileError: It is another run's, is being written by another process, or cannot be read or written.
    """
    if path is None:
        yield [], lambda _: None
        return
    path = Path(path)
    file = _opened(path)
    try:
        lock(file, path)
        records = _kept(path, file, run, overwrite=overwrite)
        synced = time.monotonic()

        def append(record: Record) -> None:
            nonlocal synced
            now = time.monotonic()
            # A process that is killed loses nothing that was written; the disk is for power cuts, and takes its time.
            _append(path, file, record, sync=now - synced > _SYNCED)
            synced = now if now - synced > _SYNCED else synced

        yield records, append
    finally:
        file.close()


def lock(file: IO[bytes], path: Path) -> None:
    """Claim an open file for this process until it is closed; where the system knows no such claims, do nothing.

    Raises:
        FileError: Another process has it.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        message = f"{path} is in use by another run of calib; wait for its end, or end it."
        raise FileError(message) from error
    except OSError:  # a network disk without locks
        return


def _opened(path: Path) -> FileIO:
    """The file, made if there is none.

    Raises:
        FileError: It is a symbolic link, or no file, or it cannot be opened.
    """

    def opener(name: str, flags: int) -> int:
        # Its name is calib's own: a link there would have another file written over. Opening a pipe must not wait.
        flags |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        return os.open(name, flags, 0o666)

    file: FileIO | None = None
    try:
        found = path.lstat().st_mode
    except (OSError, ValueError):
        found = stat.S_IFREG  # none yet; what else is wrong is said when it is opened
    try:
        if stat.S_ISREG(found):  # or it stays shut: opening some devices does something
            # Nothing is left to be written when it is closed.
            file = open(path, "a+b", buffering=0, opener=opener)  # noqa: SIM115
            found = os.fstat(file.fileno()).st_mode
    except OSError as error:
        if error.errno != errno.ELOOP:
            message = f"'{path}' cannot be written: {error.strerror}; choose another folder"
            raise FileError(message) from error
        found = stat.S_IFLNK  # made a link since it was looked at
    if file is None or not stat.S_ISREG(found):
        raise FileError(_no_file(path, found))
    return file


def _no_file(path: Path, mode: int) -> str:
    """The message for something else in the journal's place."""
    kinds = {stat.S_IFLNK: "a symbolic link", stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe"}
    kind = kinds.get(stat.S_IFMT(mode), "a device")
    return (
        f"'{path}' is {kind}, and calib keeps the finished parts of a long run in a "
        "file of that name; delete it or move it away, or choose another name for the result."
    )


def _kept(path: Path, file: FileIO, run: str, *, overwrite: bool) -> list[Record]:
    """The records that are whole; the file is cut behind them, and has a first line.

    Raises:
        FileError: It is another run's, or cannot be written.
    """
    records, end = _whole(read_bytes(path, "The journal"))
    if records and records[0] != {"run": run}:
        if not overwrite:
            message = (
                f"{path} holds {len(records) - 1} finished parts of another command, or of another version of calib. "
                "Give that command again to go on with it; to begin anew add --force, or delete the file."
            )
            raise FileError(message)
        records, end = [], 0
    if not records and file.seek(0, os.SEEK_END) > end and not overwrite:
        message = (
            f"{path} exists already and is no journal of calib; add --force or choose another name."
        )
        raise FileError(message)
    file.truncate(end)
    if not records:
        _append(path, file, {"run": run}, sync=True)
    return records[1:]


def _whole(data: bytes) -> tuple[list[Record], int]:
    """The records up to the first that is damaged, and where they end [bytes]."""
    records, end = [], 0
    for line in data.splitlines(keepends=True):
        told, text = line[:_DIGITS], line[_DIGITS + 1 : -1]
        if not line.endswith(b"\n") or hashlib.sha256(text).hexdigest().encode() != told:
            break
        records.append(json.loads(text))
        end += len(line)
    return records, end


def _append(path: Path, file: FileIO, record: Record, *, sync: bool) -> None:
    """Write a record; with ``sync`` it and those before it are on the disk then.

    Raises:
        FileError: It cannot be written.
    """
    text = json.dumps(record).encode()
    line = hashlib.sha256(text).hexdigest().encode() + b" " + text + b"\n"
    try:
        while line:
            line = line[file.write(line) :]
        if sync:
            os.fsync(file.fileno())
    except OSError as error:
        message = f"'{path}' cannot be written: {error.strerror}"
        raise FileError(message) from error
