"""Files in and out: read within a limit, write whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import select
import stat
from pathlib import Path
from typing import BinaryIO

from calib.errors import FileError

with contextlib.suppress(ImportError):  # Windows has none, and no files without names either
    import fcntl

#: How long to wait for somebody to write into a named pipe [s].
PATIENCE = 10.0

_STANDARD_INPUT = "/dev/stdin"

# What pipes without a name gave, by device and inode: the second who asks finds them empty.
_PIPED: dict[tuple[int, int], bytes] = {}


class _NoFileError(Exception):
    """What is to be read is no file; the text says what it is."""


def read_bytes(path: str | os.PathLike[str], what: str, limit_bytes: int) -> bytes:
    """Read a whole file of at most ``limit_bytes``.

    A pipe is read to its end: standard input as ``-``, a shell's ``<(zcat table.csv.gz)``, a named pipe. What such a
    pipe without a name gave is kept, for it cannot be read twice. A named one into which nobody begins to write within
    `PATIENCE` seconds is refused.

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

    The bytes go to a temporary file in the same folder, then to the disk, then under the name. A
    symbolic link is followed. A file that is overwritten keeps its permissions; a new one gets what
    the umask allows.

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
    try:
        target = Path(os.path.realpath(path))
        _check_target(path, target, overwrite=overwrite)
        _write(target, data, overwrite=overwrite)
    except FileExistsError as error:
        raise FileError(_exists_already(path)) from error
    except (OSError, ValueError) as error:
        message = f"'{path}' cannot be written: {_reason(error)}; choose another folder"
        raise FileError(message) from error
    return Path(path)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse, before the work is done, a place where `write_atomically` cannot write; a file that exists may stay.

    Raises:
        FileError: It is a folder or a device, its name is too long, or its folder is missing or takes no files.
    """
    try:
        target = Path(os.path.realpath(path))
        _check_target(path, target, overwrite=True)
        with contextlib.suppress(FileNotFoundError):
            target.lstat()  # its name is too long for the disk
        temporary = target.parent / f".calib-{secrets.token_hex(8)}.tmp"
        if not _takes_nameless(target.parent):
            try:
                _write_to_disk(temporary, b"")
            finally:
                with contextlib.suppress(OSError):
                    temporary.unlink()
    except (OSError, ValueError) as error:
        message = f"'{path}' cannot be written: {_reason(error)}; choose another folder"
        raise FileError(message) from error


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
    if key in _PIPED:
        return _PIPED[key]
    parts: list[bytes] = []
    size = 0
    pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # without, opening waits for a writer
    try:
        poll = select.poll()
        poll.register(pipe, select.POLLIN)
        while size < most:
            silent = not poll.poll(PATIENCE * 1e3)
            try:
                part = os.read(pipe, min(most - size, 1 << 20))
            except BlockingIOError:  # somebody has it open, and takes time
                continue
            if not part and silent:
                message = f"a pipe into which nothing was written for {PATIENCE:g} s"
                raise _NoFileError(message)
            if not part:
                break
            parts.append(part)
            size += len(part)
    finally:
        os.close(pipe)
    data = b"".join(parts)
    if not Path(os.path.realpath(path)).exists():  # it has no name, and so no second life
        _PIPED[key] = data
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


def _exists_already(path: str | os.PathLike[str]) -> str:
    """The message for a file that stands in the way."""
    return f"'{path}' exists already; add --force (overwrite=True) or choose another name"


def _reason(error: OSError | ValueError) -> str:
    """What the system says, without the name of the temporary file."""
    return str(getattr(error, "strerror", None) or error)


def _write(target: Path, data: bytes, *, overwrite: bool) -> None:
    """Write the bytes under no name, or under another, and give them the name of ``target``."""
    if _write_nameless(target, data, overwrite=overwrite):
        return
    temporary = target.parent / f".calib-{secrets.token_hex(8)}.tmp"
    try:
        _write_to_disk(temporary, data)
        if overwrite:
            with contextlib.suppress(FileNotFoundError):
                temporary.chmod(_permissions(target))
            temporary.replace(target)
        else:
            _move_to_new(temporary, target)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _write_nameless(target: Path, data: bytes, *, overwrite: bool) -> bool:
    """Write the bytes into a file without a name, of which nothing is left if the process is killed.

    Returns:
        Whether it could be done: only Linux has such files, and not in every kind of folder.
    """
    if not hasattr(os, "O_TMPFILE"):
        return False
    with contextlib.ExitStack() as stack:
        try:
            nameless = os.open(target.parent, os.O_TMPFILE | os.O_WRONLY, 0o666)
        except OSError:
            return False
        file = stack.enter_context(open(nameless, "wb"))  # noqa: PTH123  a number, no name
        _to_disk(file, data)
        folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
        stack.callback(os.close, folder)
        if not overwrite:
            return _link(nameless, target, folder)
        with contextlib.suppress(FileNotFoundError):
            os.fchmod(nameless, _permissions(target))
        temporary = _link_beside(nameless, target, folder)
        if temporary is None:
            return False
        try:
            temporary.replace(target)
        except OSError:
            temporary.unlink()
            raise
    return True


def _link(nameless: int, name: Path, folder: int) -> bool:
    """Give a file without a name one; False if this system cannot.

    Raises:
        FileExistsError: Something has that name.
    """
    try:  # with a folder given, the name that /proc has for the file is followed to it
        os.link(f"/proc/self/fd/{nameless}", name, src_dir_fd=folder, follow_symlinks=True)
    except FileExistsError:
        raise
    except OSError:  # no /proc
        return False
    return True


def _link_beside(nameless: int, target: Path, folder: int) -> Path | None:
    """Give a file without a name the one from which it takes the place of ``target``; None if this system cannot.

    The name is always the same for a target. A process that is killed between this name and the last leaves a file,
    which is known by that nobody holds its lock; the next who writes the target takes it away.
    """
    digest = hashlib.sha256(os.fsencode(target.name)).hexdigest()
    usual = target.parent / f".calib-{digest[:16]}.tmp"
    with contextlib.suppress(OSError):
        fcntl.flock(nameless, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _remove_dead(usual)
        with contextlib.suppress(FileExistsError):  # somebody else is just writing the target
            return usual if _link(nameless, usual, folder) else None
    other = target.parent / f".calib-{secrets.token_hex(8)}.tmp"
    return other if _link(nameless, other, folder) else None


def _remove_dead(path: Path) -> None:
    """Remove a temporary file if the process that made it is gone."""
    with contextlib.suppress(FileNotFoundError, BlockingIOError), path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Whoever holds the lock of a file may remove it, as long as the name is still the file's.
        if os.path.samestat(os.fstat(file.fileno()), path.lstat()):
            path.unlink()


def _permissions(path: Path) -> int:
    """The permissions of a file."""
    return stat.S_IMODE(path.stat().st_mode)


def _takes_nameless(folder: Path) -> bool:
    """Whether a file without a name can be made in a folder."""
    try:
        os.close(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666))
    except (AttributeError, OSError):
        return False
    return True


def _write_to_disk(path: Path, data: bytes) -> None:
    """Create ``path`` and wait until its bytes are on the disk."""
    with path.open("xb") as file:
        _to_disk(file, data)


def _to_disk(file: BinaryIO, data: bytes) -> None:
    """Write the bytes and wait until they are on the disk."""
    file.write(data)
    file.flush()
    os.fsync(file.fileno())


def _move_to_new(temporary: Path, target: Path) -> None:
    """Give the temporary file its name; FileExistsError if someone was faster."""
    try:
        target.hardlink_to(temporary)
    except FileExistsError:
        raise
    except OSError:  # FAT and some network drives have no hard links: claim the name, then replace
        with target.open("xb"):
            pass
        try:
            temporary.replace(target)
        except OSError:
            target.unlink()
            raise
