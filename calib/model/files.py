"""Files in and out: read within a limit, write whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from pathlib import Path

from calib.errors import FileError


def read_bytes(path: str | os.PathLike[str], what: str, limit_bytes: int) -> bytes:
    """Read a whole file of at most ``limit_bytes``.

    Args:
        path: File to read.
        what: What the file should be, for the message: ``"URDF"``.
        limit_bytes: Largest size accepted [bytes].

    Returns:
        The bytes of the file.

    Raises:
        FileError: There is no such file, it is a folder, it cannot be read, or it is too large.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(limit_bytes + 1)
    except FileNotFoundError as error:
        message = f"{what} '{path}' does not exist; check the name and the folder"
        if ":=" in str(path):
            message += ". Arguments of a xacro stand behind its name, with it in one pair of quotes"
        raise FileError(message) from error
    except IsADirectoryError as error:
        message = f"{what} '{path}' is a folder; name the file inside it"
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
        temporary = target.parent / f".calib-{secrets.token_hex(8)}.tmp"
        try:
            _write_to_disk(temporary, data)
            if overwrite:
                _replace(temporary, target)
            else:
                _move_to_new(temporary, target)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink()
    except FileExistsError as error:
        raise FileError(_exists_already(path)) from error
    except (OSError, ValueError) as error:
        message = f"'{path}' cannot be written: {_reason(error)}; choose another folder"
        raise FileError(message) from error
    return Path(path)


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


def _write_to_disk(path: Path, data: bytes) -> None:
    """Create ``path`` and wait until its bytes are on the disk."""
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _replace(temporary: Path, target: Path) -> None:
    """Put the temporary file in the place of ``target``, with the permissions of the old file."""
    with contextlib.suppress(FileNotFoundError):
        temporary.chmod(stat.S_IMODE(target.stat().st_mode))
    temporary.replace(target)


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
