"""What a browser sends: files, which go to disk piece by piece up to a limit, and short forms.

A file that is too large is refused while it arrives: the rest is dropped as it comes, so that the browser shows the
answer instead of a broken connection, and what was written is removed.
"""

from __future__ import annotations

import re
import secrets
import shutil
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO
from urllib.parse import parse_qsl

from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import ClientDisconnect, Request

from calib.basics.files import make_folder
from calib.boards.detection.picture import ENDINGS as PICTURES
from calib.errors import CalibError

_MB = 1_000_000

#: Largest file that is no picture, and largest picture [bytes].
MOST_BYTES = 50 * _MB
MOST_OF_A_PICTURE = 100 * _MB

#: Most files of one upload, and their largest size together [bytes].
MOST_FILES = 2000
MOST_TOGETHER = 4000 * _MB

#: Largest text of a field of a form, and of a form without files [bytes].
_MOST_OF_A_FIELD = 20_000
_MOST_OF_A_FORM = 400_000

#: What is dropped of an upload that was refused before the connection is closed [bytes].
_MOST_DROPPED = 1000 * _MB

#: Files that are taken: descriptions of robots and their meshes, tables, lists, cells, boards, results; and pictures.
ENDINGS = frozenset(
    (
        *(".urdf", ".xacro", ".xml", ".mjcf", ".stl", ".dae", ".obj"),
        *(".csv", ".tsv", ".txt", ".dat", ".asc", ".xlsx", ".xlsm"),
        *(".toml", ".yaml", ".yml", ".json"),
        *PICTURES,
    )
)

#: Characters of names that stay as they are; others become underscores.
_OTHERS = re.compile(r"[^\w .()+-]")

#: Letters of a name at most.
_LONGEST = 100

#: Names that Windows keeps for devices.
_DEVICES = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


class UploadError(CalibError):
    """An upload that is too large, or none; the text says the limit."""

    #: Status of the answer.
    status = 400


class TooLargeError(UploadError):
    """An upload that is too large."""

    status = 413


@dataclass(frozen=True, slots=True)
class Received:
    """An upload: the texts of its fields, and its files in a folder."""

    folder: Path
    fields: Mapping[str, str]
    #: Names of the files in the folder, each once
    files: tuple[str, ...]


def safe_name(sent: str) -> str:
    """Return the name by which a file that a browser sent is kept: a plain name in one folder, no option, no sheet.

    Example:
        >>> safe_name("../../etc/my robot.urdf"), safe_name("-o=x.csv"), safe_name("..")
        ('my robot.urdf', '_o_x.csv', 'file')
    """
    name = unicodedata.normalize("NFC", re.split(r"[/\\]", sent)[-1])
    name = _OTHERS.sub("_", name).strip(" .")
    if name.startswith("-"):
        name = f"_{name[1:]}"
    if len(name) > _LONGEST:
        stem, dot, ending = name.rpartition(".")
        name = (
            stem[: _LONGEST - len(ending) - 1] + dot + ending
            if len(ending) < 10
            else name[:_LONGEST]
        )
    if _DEVICES.fullmatch(name):
        name = f"_{name}"
    return name or "file"


def is_picture(name: str) -> bool:
    """Return True for the name of a picture."""
    return Path(name).suffix.lower() in PICTURES


def free_name(wanted: str, taken: set[str]) -> str:
    """Return a name, or the first with a number that nobody has; upper and lower case count as the same."""
    folded = {name.casefold() for name in taken}
    stem, ending = Path(wanted).stem, Path(wanted).suffix
    name, number = wanted, 2
    while name.casefold() in folded:
        name, number = f"{stem}-{number}{ending}", number + 1
    return name


@contextmanager
def incoming(folder: Path) -> Iterator[Path]:
    """Make a folder for an upload below a folder, and remove it with what is left in it at the end."""
    place = make_folder(folder / ".incoming" / secrets.token_hex(8))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


@dataclass
class _Parts:
    """The parts of an upload while they arrive: fields in memory, files on disk."""

    folder: Path
    fields: dict[str, str] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    _header: tuple[bytearray, bytearray] = field(default_factory=lambda: (bytearray(), bytearray()))
    _disposition: bytes = b""
    _name: str = ""
    _text: bytearray | None = None
    _file: IO[bytes] | None = None
    _size: int = 0

    def on_part_begin(self) -> None:
        """Forget the part before."""
        self._disposition, self._text, self._file, self._size = b"", None, None, 0

    def on_header_field(self, data: bytes, start: int, end: int) -> None:
        """Take a piece of a header's name."""
        self._header[0].extend(data[start:end])

    def on_header_value(self, data: bytes, start: int, end: int) -> None:
        """Take a piece of a header's value."""
        self._header[1].extend(data[start:end])

    def on_header_end(self) -> None:
        """Keep the header that names the part."""
        if bytes(self._header[0]).lower() == b"content-disposition":
            self._disposition = bytes(self._header[1])
        self._header = (bytearray(), bytearray())

    def on_headers_finished(self) -> None:
        """Open the part's file, or begin its text; a file without a name was not chosen, and is empty."""
        _, options = parse_options_header(self._disposition)
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        if b"filename" not in options:
            self._text = bytearray()
            return
        sent = options[b"filename"].decode("utf-8", "replace")
        if not sent:
            return
        name = safe_name(sent)
        if Path(name).suffix.lower() not in ENDINGS:
            raise UploadError(
                f"'{name}' is no file that calib reads. It reads robots (.urdf, .xacro, .xml), tables and lists "
                "(.csv, .tsv, .txt, .xlsx), cells, boards and cameras (.toml, .yaml), results (.json) and pictures "
                "(.png, .jpg)."
            )
        if len(self.files) == MOST_FILES:
            raise TooLargeError(f"These are more than {MOST_FILES:,} files; send fewer at a time.")
        name = free_name(name, set(self.files))
        self.files.append(name)
        self._file = (self.folder / name).open("wb")

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        """Write a piece of a file, or keep a piece of a text; UploadError beyond its limit."""
        self._size += end - start
        if self._file is not None:
            name = self.files[-1]
            most = MOST_OF_A_PICTURE if is_picture(name) else MOST_BYTES
            if self._size > most:
                raise TooLargeError(
                    f"'{name}' has more than {most // _MB} MB, the most that a {_word(name)} may have here. A table "
                    "of a calibration has some kB: is it the right file? Larger ones are read by the command line, "
                    "calib calibrate."
                )
            self._file.write(data[start:end])
        elif self._text is not None:
            if self._size > _MOST_OF_A_FIELD:
                raise TooLargeError(f"The field '{self._name}' is too long.")
            self._text.extend(data[start:end])

    def on_part_end(self) -> None:
        """Close the file, or keep the text."""
        self.close()
        if self._text is not None:
            self.fields[self._name] = self._text.decode("utf-8", "replace")

    def close(self) -> None:
        """Close the file that arrives."""
        if self._file is not None:
            self._file.close()
            self._file = None


def _word(name: str) -> str:
    """Say what a file is, for the message on its size."""
    return "picture" if is_picture(name) else "table or description"


async def receive_upload(request: Request, folder: Path) -> Received:
    """Take an upload, its files into a folder.

    Args:
        request: A form that was sent as ``multipart/form-data``.
        folder: An empty folder.

    Returns:
        The fields and the names of the files.

    Raises:
        UploadError: It is none, or is too large.
    """
    kind, options = parse_options_header(request.headers.get("content-type"))
    boundary = options.get(b"boundary")
    if kind != b"multipart/form-data" or not boundary:
        raise UploadError("This is no upload of files: send it from the page.")
    stated = request.headers.get("content-length", "")
    if stated.isdigit() and int(stated) > MOST_TOGETHER:
        raise TooLargeError(
            f"These files have more than {MOST_TOGETHER // _MB:,} MB together; send fewer at a time."
        )
    parts = _Parts(folder)
    names = [name for name in vars(_Parts) if name.startswith("on_")]
    parser = MultipartParser(boundary, {name: getattr(parts, name) for name in names})  # type: ignore[arg-type]
    fault: UploadError | None = None
    arrived = dropped = 0
    try:
        async for piece in request.stream():
            arrived += len(piece)
            if fault is not None:
                dropped += len(piece)
                if dropped > _MOST_DROPPED:
                    break
                continue
            try:
                if arrived > MOST_TOGETHER:
                    raise TooLargeError(
                        f"These files have more than {MOST_TOGETHER // _MB:,} MB together; send fewer at a time."
                    )
                parser.write(piece)
            except UploadError as error:
                fault = error
            except MultipartParseError as error:
                fault = UploadError(f"The upload is damaged ({error}); send it again.")
            except OSError as error:
                fault = UploadError(
                    f"The files cannot be stored in '{folder.parent}': {error.strerror or error}."
                )
        if fault is None:
            parser.finalize()
    except ClientDisconnect as error:
        raise UploadError("The browser broke off the upload.") from error
    except MultipartParseError as error:
        raise UploadError(f"The upload is damaged ({error}); send it again.") from error
    finally:
        parts.close()
    if fault is not None:
        raise fault
    return Received(folder, parts.fields, tuple(parts.files))


async def receive_form(request: Request) -> dict[str, str]:
    """Take a short form without files, as ``application/x-www-form-urlencoded``; UploadError if it is none."""
    kind, _ = parse_options_header(request.headers.get("content-type"))
    if kind != b"application/x-www-form-urlencoded":
        raise UploadError("This is no form of a page of calib.")
    body = bytearray()
    async for piece in request.stream():
        body.extend(piece)
        if len(body) > _MOST_OF_A_FORM:
            raise TooLargeError("This form is too long.")
    try:
        pairs = parse_qsl(body.decode("ascii"), keep_blank_values=True, max_num_fields=2000)
    except ValueError as error:
        raise UploadError("This is no form of a page of calib.") from error
    return dict(pairs)
