"""The journal of a session: a file of JSON, one event a line, that only grows and survives whatever ends the program.

An event counts when `Journal.append` returns: its line is then on the disk. A line that a killed process or a failed
disk left unfinished was promised to nobody, and is dropped when the journal is opened next. One process at a time has
the journal: it holds a lock that the operating system releases when the process ends, however that ends.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from calib.basics.json_files import parse_json, plain
from calib.errors import CalibError, FileError

#: Name of the file beside a journal whose lock says that a process has the session open.
LOCK = "session.lock"

#: Place of the byte that Windows locks: behind all that the file holds, which others can then read.
_LOCKED_BYTE = 1 << 20


class Journal:
    """Events of a session, in a file that this process alone appends to."""

    #: What was found at the end of the file and dropped, because its line is not complete; empty if nothing.
    torn: str

    def __init__(self, path: Path, file: BinaryIO, lock: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._lock = lock
        self._events: list[Mapping[str, Any]] = []
        #: Bytes of the file that hold the events.
        self._size = 0
        #: Whether bytes of a failed append may still follow them.
        self._unclean = False
        #: Threads of a program append one after the other.
        self._appending = threading.Lock()
        self.torn = ""

    @classmethod
    def create(cls, path: str | os.PathLike[str]) -> Journal:
        """Create the journal of a new session in a folder that exists, and take the folder's lock.

        Args:
            path: The file.

        Raises:
            FileError: It exists, cannot be created, or another process has a session open in the folder.
        """
        path = Path(path)
        lock = _take_lock(path.with_name(LOCK))
        try:
            file = path.open("x+b", buffering=0)
            _sync_folder(path.parent)
        except OSError as error:
            lock.close()
            if isinstance(error, FileExistsError):
                raise FileError(
                    f"'{path}' exists already: this folder has a session. Open it, or choose another folder."
                ) from error
            raise FileError(
                f"'{path}' cannot be created: {error.strerror}; choose another folder."
            ) from error
        return cls(path, file, lock)

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Journal:
        """Open the journal of a session, take its folder's lock, and read its events.

        A last line that is not complete is removed from the file and kept as `torn`.

        Args:
            path: The file.

        Raises:
            FileError: There is none, it cannot be read, it is damaged before its last line, or another process has the
                session open.
        """
        path = Path(path)
        if not path.is_file():
            raise FileError(
                f"'{path}' does not exist: this folder has no session. Check its name, or start a session there."
            )
        lock = _take_lock(path.with_name(LOCK))
        try:
            journal = cls(path, path.open("r+b", buffering=0), lock)
        except OSError as error:
            lock.close()
            raise FileError(f"'{path}' cannot be opened: {error.strerror}.") from error
        try:
            journal._read()
        except BaseException:
            journal.close()
            raise
        return journal

    @property
    def events(self) -> tuple[Mapping[str, Any], ...]:
        """The events, the first one first, as JSON states them: arrays are lists, NaN is None."""
        return tuple(self._events)

    def append(self, event: Mapping[str, Any]) -> None:
        """Append an event; when this returns, it is on the disk.

        Args:
            event: Numbers, texts, lists, arrays and nested mappings with texts as keys.

        Raises:
            FileError: It cannot be written, such as on a full disk; the file then has the events that it had before.
        """
        text = json.dumps(plain(event), ensure_ascii=False)
        # A byte of a file's name that is not UTF-8 is written as JSON's own escape.
        line = text.encode("utf-8", "backslashreplace") + b"\n"
        with self._appending:
            if self._file.closed:
                raise FileError(f"'{self._path}' is closed; open the session again.")
            self._check_in_place()
            try:
                self._write(line)
            except OSError as error:
                with contextlib.suppress(OSError):
                    self._clean()
                raise FileError(
                    f"'{self._path}' cannot be written: {error.strerror}. This event is not saved, the others are: "
                    "mend the cause and give it again."
                ) from error
            self._events.append(json.loads(line))

    def close(self) -> None:
        """Close the file and release the lock."""
        with self._appending:
            self._file.close()
            self._lock.close()

    def __enter__(self) -> Journal:
        """Return the journal, which is closed when the block ends."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file and release the lock."""
        self.close()

    def _read(self) -> None:
        """Read the events of the file, and remove what follows the last complete line."""
        content = self._file.read()
        lines = content.split(b"\n")
        last = len(lines) if lines[-1] else len(lines) - 1
        for number, line in enumerate(lines[:last], start=1):
            try:
                event = parse_json(line, f"'{self._path}', line {number}")
                if not isinstance(event, dict):
                    raise FileError(f"'{self._path}', line {number}: this is not an event.")
            except CalibError as error:
                if number < last:
                    raise FileError(
                        f"{error} The journal is damaged there: restore it from a copy, or remove this line."
                    ) from error
                self.torn = content[self._size :].decode("utf-8", "replace").rstrip("\r\n")
                self._clean()
                return
            self._events.append(event)
            self._size += len(line) + 1
        if self._size > len(content):  # only the last line's end is missing
            self._size = len(content)
            self._write(b"\n")

    def _write(self, data: bytes) -> None:
        """Write bytes behind the events and wait until they are on the disk; OSError leaves `_size` as it is."""
        if self._unclean:
            self._clean()
        self._unclean = True
        self._file.seek(self._size)
        written = 0
        while written < len(data):
            written += self._file.write(data[written:])
        os.fsync(self._file.fileno())
        self._size += len(data)
        self._unclean = False

    def _clean(self) -> None:
        """Cut the file behind the events, where an append failed or a process was killed."""
        self._file.truncate(self._size)
        os.fsync(self._file.fileno())
        self._unclean = False

    def _check_in_place(self) -> None:
        """Refuse to go on, by a FileError, with a file that was moved or replaced: events would be lost with it."""
        with contextlib.suppress(OSError):
            if os.path.samestat(self._path.stat(), os.fstat(self._file.fileno())):
                return
        raise FileError(
            f"'{self._path}' was moved, removed or replaced while this session was open; close the session, put the "
            "folder in order, and open it again."
        )


def _take_lock(path: Path) -> BinaryIO:
    """Return the open file whose lock this process now has, with its number inside; FileError if another has it."""
    try:
        file = path.open("a+b", buffering=0)
    except OSError as error:
        raise FileError(
            f"'{path}' cannot be written: {error.strerror}; choose a folder that exists and takes files."
        ) from error
    try:
        _lock(file)
        file.truncate(0)
        file.write(f"{os.getpid()}\n".encode())
    except BlockingIOError as error:
        file.seek(0)
        pid = file.read(20).decode("ascii", "replace").strip()
        file.close()
        holder = "this process" if pid == str(os.getpid()) else f"another process (number {pid})"
        raise FileError(
            f"'{path.parent}': {holder} has this session open. Close it there, or end that process; what it has "
            "measured is saved."
        ) from error
    except OSError as error:
        file.close()
        raise FileError(
            f"'{path}' cannot be locked: {error.strerror}; choose a folder on a local disk."
        ) from error
    return file


def _lock(file: BinaryIO) -> None:
    """Lock a file until it is closed or the process ends; BlockingIOError if another one has the lock."""
    if sys.platform == "win32":
        import msvcrt

        file.seek(_LOCKED_BYTE)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(*error.args) from error
        return
    import fcntl

    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _sync_folder(folder: Path) -> None:
    """Wait until the entry of a new file is on the disk; Windows does that by itself."""
    if sys.platform == "win32":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
