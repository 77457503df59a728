"""Files in and out: read within a limit, write whole or not at all."""

from __future__ import annotations

import contextlib
import os
import select
import stat
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path

from calib.errors import FileError
from calib.model.staging import staged, takes_files

#: How long to wait for somebody to write into a named pipe [s].
PATIENCE = 10.0

_STANDARD_INPUT = "/dev/stdin"

# How long to wait for it where the pipe gave something before [s].
_AGAIN = 0.2

# What pipes gave, by device and inode: a command looks at a table more than once, and finds them empty the second time.
_PIPED: dict[tuple[int, int], bytes] = {}


# The files of `together` so far: name, target, content, whether it may be there; None outside.
_WAITING: ContextVar[list[tuple[str | os.PathLike[str], Path, bytes, bool]] | None] = ContextVar(
    "calib files to be written together", default=None
)


class _NoFileError(Exception):
    """What is to be read is no file; the text says what it is."""


def read_bytes(path: str | os.PathLike[str], what: str, limit_bytes: int) -> bytes:
    """Read a whole file of at most ``limit_bytes``.

    A pipe is read to its end: standard input as ``-``, a shell's ``<(zcat table.csv.gz)``, a named pipe. It cannot be
    read twice, so what it gave is kept, and given to who asks again while nobody writes anew. A pipe into which nobody
    has begun to write within `PATIENCE` seconds is refused.

    Args:
        path: File to read.
        what: What the file should be, for the message: ``"URDF"``.
        limit_bytes: Largest size accepted [bytes].

    Returns:
        The bytes of the file.

    Raises:
        FileError: There is no such file, it is a folder or a device, it cannot be read, or it is too large.
    """
    try:
        data = _read(_STANDARD_INPUT if os.fspath(path) == "-" else path, limit_bytes + 1)
    except FileNotFoundError as error:
        message = f"{what} '{path}' does not exist; check the name and the folder"
        if ":=" in str(path):
            message += ". Arguments of a xacro stand behind its name, with it in one pair of quotes"
        raise FileError(message) from error
    except IsADirectoryError as error:
        message = f"{what} '{path}' is a folder; name the file inside it"
        raise FileError(message) from error
    except _NoFileError as error:
        message = f"{what} '{path}' is {error}; name a file"
        raise FileError(message) from error
    except (OSError, ValueError) as error:
        message = f"{what} '{path}' cannot be read: {_reason(error)}"
        raise FileError(message) from error
    if len(data) > limit_bytes:
        message = (
            f"{what} '{path}' is larger than {limit_bytes:,} bytes, the most that is read; "
            "check that it is the right file"
        )
        raise FileError(message)
    return data


def write_atomically(path: str | os.PathLike[str], data: bytes, *, overwrite: bool) -> Path:
    """Write a file so that it holds all of ``data`` or stays as it was.

    The bytes go to the disk under another name or none, see `calib.model.staging`, then under this one. A symbolic link
    is followed and stays one. A file that is overwritten keeps its permissions; a new one gets what the umask allows.
    Inside `together` the file appears at the end.

    Args:
        path: File to write.
        data: Its whole content.
        overwrite: Whether a file that exists already may be replaced.

    Returns:
        ``path`` as a `Path`.

    Raises:
        FileError: The file exists and ``overwrite`` is False, it is a folder or a device, or the
            folder is missing or not writable. Nothing is left behind.
    """
    with _reported(path):
        target = Path(os.path.realpath(path))
        _check_target(path, target, overwrite=overwrite)
        waiting = _WAITING.get()
        if waiting is not None:
            waiting.append((path, target, data, overwrite))
        else:
            with staged(target, data, overwrite=overwrite) as place:
                place()
    return Path(path)


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Write several files all or none: those that are written inside appear at the end, once all are on the disk.

    None is written if anything fails before. Between the first name and the last only a killed process, or a folder
    that is taken away, leaves some of them.

    Raises:
        FileError: One of them cannot be written.
    """
    waiting: list[tuple[str | os.PathLike[str], Path, bytes, bool]] = []
    token = _WAITING.set(waiting)
    try:
        yield
    finally:
        _WAITING.reset(token)
    with contextlib.ExitStack() as stack:
        places = []
        for path, target, data, overwrite in waiting:
            with _reported(path):
                places.append(stack.enter_context(staged(target, data, overwrite=overwrite)))
        for (path, *_), place in zip(waiting, places, strict=True):
            with _reported(path):
                place()


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse, before the work is done, a place where `write_atomically` cannot write; a file that exists may stay.

    Raises:
        FileError: It is a folder or a device, its name is too long, or its folder is missing or takes no files.
    """
    with _reported(path):
        target = Path(os.path.realpath(path))
        _check_target(path, target, overwrite=True)
        with contextlib.suppress(FileNotFoundError):
            target.lstat()  # its name may be too long for the disk
        takes_files(target.parent)


def expanded_name(path: str | os.PathLike[str]) -> str:
    """The name of the URDF that a xacro becomes.

    Example:
        >>> expanded_name("arms/ur.urdf.xacro"), expanded_name("ur.xacro")
        ('ur.urdf', 'ur.urdf')
    """
    stem = Path(path).stem
    return stem if stem.lower().endswith(".urdf") else f"{stem}.urdf"


def check_no_xacro(path: str | os.PathLike[str]) -> None:
    """Refuse the name of a xacro for what is written.

    Raises:
        FileError: The name ends in ``.xacro``.
    """
    if Path(path).name.lower().endswith(".xacro"):
        message = (
            f"'{path}' is the name of a xacro, and what is written is a URDF, with macros and arguments expanded; name "
            f"it {expanded_name(path)}. A xacro stays one if it takes the origins of its joints from a file: see calib "
            "convert --to origins."
        )
        raise FileError(message)


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder and those above it; one that exists is left as it is.

    Raises:
        FileError: A file has that name, or the folder cannot be made.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        message = f"{path}: this folder cannot be made: {_reason(error)}. Choose another name."
        raise FileError(message) from error
    return Path(path)


def _read(path: str | os.PathLike[str], most: int) -> bytes:
    """The first bytes of a file or of a pipe.

    Raises:
        _NoFileError: It is neither, or nobody writes into the pipe.
    """
    mode = Path(path).stat().st_mode  # before it is opened: opening some devices does something
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        terminal = stat.S_ISCHR(mode) and os.fspath(path) == _STANDARD_INPUT
        message = "the terminal" if terminal else "a device"
        raise _NoFileError(message)
    if stat.S_ISFIFO(mode) and hasattr(os, "O_NONBLOCK"):
        return _read_pipe(path, most)
    with Path(path).open("rb") as file:
        return file.read(most)


def _read_pipe(path: str | os.PathLike[str], most: int) -> bytes:
    """The first bytes of a pipe."""
    found = Path(path).stat()
    key = found.st_dev, found.st_ino
    patience = _AGAIN if key in _PIPED else PATIENCE
    parts: list[bytes] = []
    size = 0
    pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # without, opening waits for a writer
    try:
        poll = select.poll()
        poll.register(pipe, select.POLLIN)
        while size < most:
            silent = not poll.poll(patience * 1e3)
            try:
                part = os.read(pipe, min(most - size, 1 << 20))
            except BlockingIOError:  # somebody has it open, and takes time
                continue
            if not part and not parts and key in _PIPED:
                return _PIPED[key]
            if not part and silent:
                message = f"a pipe into which nothing was written for {PATIENCE:g} s"
                raise _NoFileError(message)
            if not part:
                break
            parts.append(part)
            size += len(part)
    finally:
        os.close(pipe)
    _PIPED[key] = data = b"".join(parts)
    return data


def _check_target(path: str | os.PathLike[str], target: Path, *, overwrite: bool) -> None:
    """Refuse what can be known before anything is written."""
    if target.is_dir():
        message = f"'{path}' is a folder; name a file inside it"
        raise FileError(message)
    if Path(path).exists() and not Path(path).is_file():
        # Asked of the name given: /dev/stdout leads to a pipe that has no folder.
        message = f"'{path}' is a device or a pipe, not a file; choose another name"
        raise FileError(message)
    if not target.parent.is_dir():
        message = (
            f"'{path}' cannot be written: the folder '{target.parent}' does not exist; create it"
        )
        raise FileError(message)
    if target.exists() and not overwrite:
        raise FileError(_exists_already(path))


@contextlib.contextmanager
def _reported(path: str | os.PathLike[str]) -> Iterator[None]:
    """What the system refuses, as a `FileError`."""
    try:
        yield
    except FileExistsError as error:
        raise FileError(_exists_already(path)) from error
    except (OSError, ValueError) as error:
        message = f"'{path}' cannot be written: {_reason(error)}; choose another folder"
        raise FileError(message) from error


def _exists_already(path: str | os.PathLike[str]) -> str:
    """The message for a file that stands in the way."""
    return f"'{path}' exists already; add --force (overwrite=True) or choose another name"


def _reason(error: OSError | ValueError) -> str:
    """What the system says, without the name of the temporary file."""
    return str(getattr(error, "strerror", None) or error)
