"""Readers of files that another program writes: one file with rows, or a folder with files and pictures."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass
from pathlib import Path

from calib.basics.files import read_bytes
from calib.basics.tables import decoded, is_utf16, read_text
from calib.basics.workbook import SUFFIXES, split_sheet
from calib.boards.detection.picture import ENDINGS
from calib.errors import CalibError, DeviceError, MeasurementError
from calib.verbs.measure.devices.reading import Context, Reading
from calib.verbs.measure.devices.rows import GrowingText
from calib.verbs.measure.devices.waiting import WaitingReader

#: Time after which a file that has not changed counts as written [s]: longer than a program takes between two pieces.
_STILL = 0.4

#: Time after which a picture that has not changed and has no end is broken [s].
_BROKEN = 5.0

#: Endings of tables and of lists of points, in lower case.
_TEXTS = (".csv", ".txt", ".tsv", ".dat", ".asc", ".pts", ".xyz", *SUFFIXES)

#: How a whole picture ends, and in how many last bytes, by the file's ending: some cameras add bytes of their own.
_ENDS = {".png": (b"IEND", 64), ".jpg": (b"\xff\xd9", 4096), ".jpeg": (b"\xff\xd9", 4096)}

#: What changes when a file is written: its size and its time.
_Stamp = tuple[int, int]


def _stamp_of(path: Path) -> _Stamp | None:
    """Return the stamp of a file; None if there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


@dataclass(slots=True)
class _Seen:
    """A file at its last look."""

    stamp: _Stamp | None
    #: Since when the stamp has not changed, by `time.monotonic`.
    since: float
    #: Whether what the stamp stands for was read.
    is_read: bool = False

    def look(self, stamp: _Stamp | None) -> float:
        """Take the file's stamp of now, and return how long it has not changed [s]."""
        now = time.monotonic()
        if stamp != self.stamp:
            self.stamp, self.since, self.is_read = stamp, now, False
        return now - self.since


class RowsFile:
    """The rows of a file that another program writes."""

    def __init__(self, path: Path, context: Context) -> None:
        self._path = path
        self._rows = GrowingText(path.name, context)
        self._is_sheet = split_sheet(str(path))[1] is not None
        #: Whether the program ends its last line, as was seen when it paused: then one without an end is not complete.
        self._ends_lines = False

    def new(self, *, is_still: bool) -> tuple[list[Reading], list[MeasurementError]]:
        """Return the new rows of the file, and errors for new lines that are malformed.

        Args:
            is_still: Whether the file has not changed for a while, so that the program has paused.

        Raises:
            CalibError: The file cannot be read, such as a workbook that is just being written.
        """
        name = self._path.name
        if self._is_sheet:
            _, _, text = read_text(self._path, "The file")
        else:
            data = read_bytes(self._path, "The file")
            if is_utf16(data) and not is_still:  # not to be cut between two letters
                return [], []
            self._ends_lines |= is_still and data.endswith(b"\n")
            if not is_utf16(data) and (self._ends_lines or not is_still):
                data = data[: data.rfind(b"\n") + 1]
            text = decoded(data, name)
        rows, faults = self._rows.update(text)
        return [Reading.of(row.cells, source=f"{name}, line {row.line}") for row in rows], faults


class FileReader(WaitingReader):
    """Gives the rows that are added to a file, one after the other; those that it has at the beginning are old."""

    def __init__(self, argument: str, context: Context) -> None:
        super().__init__()
        if not argument:
            raise DeviceError("The reader 'file' needs the name of a file: file:points.txt")
        self._path = Path(argument).expanduser()
        file = Path(split_sheet(str(self._path))[0])
        if file.is_dir():
            raise DeviceError(
                f"'{file}' is a folder; its files are read by the reader watch:{file}"
            )
        if not file.parent.is_dir():
            raise DeviceError(f"'{file}' cannot appear: its folder does not exist. Check the name.")
        self._file = file
        self._rows = RowsFile(self._path, context)
        self._seen = _Seen(_stamp_of(file), time.monotonic())
        if self._seen.stamp is not None:
            readings, faults = self._rows.new(is_still=True)
            if faults and not readings:
                raise faults[0]
            self._seen.is_read = True

    def _look(self, seconds: float) -> None:
        """Read the file if it has changed, and once more when it has paused."""
        still = self._seen.look(_stamp_of(self._file))
        if self._seen.stamp is not None and not self._seen.is_read:
            is_still = still >= _STILL
            try:
                readings, faults = self._rows.new(is_still=is_still)
                self._ready.extend([*readings, *faults])
            except CalibError as error:
                if is_still:
                    self._ready.append(error)
            self._seen.is_read = is_still
        if not self._ready:
            self._closed.wait(seconds)


class FolderReader(WaitingReader):
    """Gives what appears in a folder: the rows of each table or list together, and each picture.

    Files that are there at the beginning are old, until they are written again.
    """

    def __init__(self, argument: str, context: Context) -> None:
        super().__init__()
        self._folder = Path(argument).expanduser()
        if not argument or not self._folder.is_dir():
            raise DeviceError(
                f"The reader 'watch' needs a folder that exists, and '{argument}' is none: watch:exports/"
            )
        self._context = context
        self._texts: dict[Path, RowsFile] = {}
        self._seen: dict[Path, _Seen] = {}
        #: Whether the folder cannot be read, which is said once.
        self._is_lost = False
        for path, stamp in self._listed():
            self._seen[path] = _Seen(stamp, time.monotonic(), is_read=True)
            if path.suffix.lower() in _TEXTS:
                self._texts[path] = RowsFile(path, context)
                with contextlib.suppress(CalibError):  # it is old, whatever it is
                    self._texts[path].new(is_still=True)

    def _listed(self) -> list[tuple[Path, _Stamp]]:
        """Return the files of the folder that may have readings with their stamps, as they were written."""
        files = []
        with os.scandir(self._folder) as entries:
            for entry in entries:
                path = Path(entry.path)
                is_named = path.suffix.lower() in (*_TEXTS, *ENDINGS)
                if not is_named or path.name.startswith((".", "~")) or not entry.is_file():
                    continue
                stamp = _stamp_of(path)
                if stamp is not None:
                    files.append((path, stamp))
        return sorted(files, key=lambda file: (file[1][1], file[0].name))

    def _look(self, seconds: float) -> None:
        """Take what has appeared and is complete."""
        try:
            files = self._listed()
            self._is_lost = False
        except OSError as error:
            files = []
            if not self._is_lost:
                self._ready.append(
                    DeviceError(
                        f"The folder '{self._folder}' cannot be read: {error.strerror}. Reading goes on when it is "
                        "there again."
                    )
                )
            self._is_lost = True
        for path, stamp in files:
            seen = self._seen.setdefault(path, _Seen(None, time.monotonic()))
            still = seen.look(stamp)
            if seen.is_read or still < _STILL or not stamp[0]:
                continue
            try:
                seen.is_read = self._take(path, still)
            except CalibError as error:
                self._ready.append(error)
                seen.is_read = True
        if not self._ready:
            self._closed.wait(seconds)

    def _take(self, path: Path, still: float) -> bool:
        """Take a file that has not changed for ``still`` seconds; False if it is not complete yet."""
        ending = path.suffix.lower()
        if ending in ENDINGS:
            if ending in _ENDS and not _has_end(path, *_ENDS[ending]):
                if still < _BROKEN:
                    return False
                raise MeasurementError(
                    f"The picture '{path.name}' has no end. It is left out; take it again."
                )
            self._ready.append(Reading(pictures=(path,), source=path.name))
            return True
        rows = self._texts.setdefault(path, RowsFile(path, self._context))
        readings, faults = rows.new(is_still=True)
        if readings:
            together = [row for reading in readings for row in reading.rows]
            self._ready.append(Reading.of(*together, source=path.name))
        self._ready.extend(faults)
        return True


def _has_end(path: Path, mark: bytes, within: int) -> bool:
    """Return True if a mark is in the last bytes of a file."""
    try:
        with path.open("rb") as file:
            file.seek(0, 2)
            file.seek(max(file.tell() - within, 0))
            return mark in file.read()
    except OSError:
        return False
