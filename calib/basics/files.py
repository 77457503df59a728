"""Files in and out: read with a message that says what is wrong, written whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import secrets
import stat
import sys
import time
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from calib.errors import FileError

#: Bytes read from pipes, by device and inode: a pipe can be read only once, and a command reads a table repeatedly.
_PIPED: dict[tuple[int, int], bytes] = {}

#: No process writes a file for so long [s]: a day.
_OLD = 86_400.0


def _check_path(path: object) -> None:
    """Refuse an argument ``path`` that is not the path of a file, by an ArgumentError."""
    if not isinstance(path, (str, os.PathLike)):
        # Imported late because it imports NumPy, which files alone do not need.
        from calib.basics.arguments import wrong_type

        raise wrong_type("path", path, "the path of a file")


def read_bytes(path: str | os.PathLike[str], what: str) -> bytes:
    """Read a whole file, or a pipe to its end: standard input as ``-``, a shell's ``<(zcat table.csv.gz)``.

    Args:
        path: The file.
        what: The kind of file that is expected, such as ``"URDF"``, with which the message of an error begins.

    Raises:
        FileError: It does not exist, is a folder, or cannot be read.
    """
    _check_path(path)
    name = "/dev/stdin" if os.fspath(path) == "-" else path
    try:
        status = os.stat(name)  # noqa: PTH116  a name as it is
        if not stat.S_ISFIFO(status.st_mode):
            return Path(name).read_bytes()
        pipe = (status.st_dev, status.st_ino)
        if pipe not in _PIPED:
            _PIPED[pipe] = Path(name).read_bytes()
        return _PIPED[pipe]
    except FileNotFoundError as error:
        message = f"{what} '{path}' does not exist; check the name and the folder."
        if ":=" in str(path):
            message += " Arguments of a xacro follow its name, in the same pair of quotes."
        raise FileError(message) from error
    except IsADirectoryError as error:
        raise FileError(f"{what} '{path}' is a folder; name the file inside it.") from error
    except (OSError, ValueError) as error:
        raise FileError(f"{what} '{path}' cannot be read: {_reason(error)}.") from error


def write_atomically(path: str | os.PathLike[str], data: bytes, *, overwrite: bool) -> Path:
    """Write a file so that it holds all of ``data`` or stays as it was.

    The bytes go into a file beside it, which then takes its name. A symbolic link is followed and stays one. A file
    that is overwritten keeps its permissions. Files that killed processes left beside it in this way are removed.

    Args:
        path: The file.
        data: Its whole contents.
        overwrite: False to refuse a file that exists.

    Returns:
        The path.

    Raises:
        FileError: It exists and must not be overwritten, or cannot be written.
    """
    check_writable(path, overwrite=overwrite)
    target = Path(path).resolve()
    _remove_leftovers(target.parent)
    temporary = target.with_name(f".calib-{secrets.token_hex(8)}.tmp")
    try:
        with contextlib.ExitStack() as stack:
            temporary.touch()
            # A file system may have no locks: there no leftover is removed.
            with contextlib.suppress(OSError):
                stack.enter_context(_held(temporary, wait=True))
            temporary.write_bytes(data)
            if target.exists():
                temporary.chmod(stat.S_IMODE(target.stat().st_mode))
            temporary.replace(target)
    except OSError as error:
        raise FileError(
            f"'{path}' cannot be written: {_reason(error)}; choose another folder."
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
    return Path(path)


@cache
def _remove_leftovers(folder: Path) -> None:
    """Remove what processes left in a folder that were killed while they wrote; once in a process for each folder."""
    for path in folder.glob(".calib-*.tmp"):
        with contextlib.suppress(OSError), _held(path, wait=False):
            path.unlink()


@contextlib.contextmanager
def _held(path: Path, *, wait: bool) -> Iterator[None]:
    """Hold a temporary as this process's own, by a lock that ends with the process, however that ends.

    OSError if another process holds it, unless this one is to ``wait``. Windows has no such locks: there a file that is
    not old counts as held.
    """
    if sys.platform == "win32":
        if not wait and time.time() - path.stat().st_mtime < _OLD:
            raise PermissionError(f"{path} may be another process's")
        yield
        return
    import fcntl

    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


def csv_bytes(rows: Iterable[Iterable[object]]) -> bytes:
    """Return a CSV table in UTF-8, its header first; floats are written as their repr."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def check_writable(path: str | os.PathLike[str], *, overwrite: bool = True) -> None:
    """Refuse, before any work is done, a place where `write_atomically` cannot write.

    Args:
        path: The file that is to be written.
        overwrite: False to refuse a file that exists.

    Raises:
        FileError: As `write_atomically` would raise.
    """
    _check_path(path)
    try:
        target = Path(path).resolve()
        exists = target.exists()
        is_file = target.is_file()
    except (OSError, ValueError, RuntimeError) as error:  # too long, no name, links in a circle
        message = f"'{path}' cannot be written: {_reason(error)}; choose another name."
        raise FileError(message) from error
    folder = target.parent
    if exists and not is_file:
        kind = "folder; name a file inside it" if target.is_dir() else "device"
        fault = f"is a {kind}"
    elif exists and not overwrite:
        fault = "exists already; overwrite it (--force, in Python overwrite=True) or choose another name"
    elif not folder.is_dir():
        fault = f"cannot be written: the folder '{folder}' does not exist; create it"
    elif not os.access(folder, os.W_OK):
        fault = "cannot be written: the folder takes no files; choose another folder"
    else:
        return
    raise FileError(f"'{path}' {fault}.")


def check_no_xacro(path: str | os.PathLike[str]) -> None:
    """Refuse, by a FileError, the name of a xacro for a file to be written as a URDF, whose macros are expanded."""
    _check_path(path)
    if Path(path).name.lower().endswith(".xacro"):
        raise FileError(
            f"'{path}' is the name of a xacro, and what is written is a URDF; name it .urdf. A xacro stays one if it "
            "takes the origins of its joints from a file (calib convert --to origins), or if they are numbers in it "
            "(calib convert --to xacro)."
        )


def check_urdf_name(path: str | os.PathLike[str]) -> None:
    """Refuse, by a FileError, the name of a xacro or of an MJCF for a file to be written as a URDF."""
    check_no_xacro(path)
    if Path(path).suffix.lower() in (".xml", ".mjcf", ".sdf"):
        raise FileError(
            f"'{path}' is not the name of a URDF, which is what is written; name it .urdf. A result becomes an MJCF by "
            "calib convert result.json --to mjcf --robot scene.xml."
        )


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder and those above it, if it does not exist; FileError if it cannot be made."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise FileError(
            f"{path}: this folder cannot be made: {_reason(error)}. Choose another name."
        ) from error
    return Path(path)


def remove(path: str | os.PathLike[str]) -> None:
    """Remove a file, if it exists; FileError if it cannot be removed."""
    try:
        Path(path).unlink(missing_ok=True)
    except OSError as error:
        raise FileError(f"'{path}' cannot be removed: {_reason(error)}; remove it.") from error


def _reason(error: Exception) -> str:
    """Return the system's message, without the name of the temporary file."""
    return str(getattr(error, "strerror", None) or error)
