"""Files under a temporary name, or under none, until they are whole."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

with contextlib.suppress(ImportError):  # Windows has none, and no files without names either
    import fcntl


@contextlib.contextmanager
def staged(target: Path, data: bytes, *, overwrite: bool) -> Iterator[Callable[[], None]]:
    """Bring the bytes to the disk of ``target``, and give the function that then puts them in its place.

    Where the system has files without names (Linux, in most folders) nothing is left if the process is killed.
    Elsewhere a file ``.calib-*.tmp`` is; it may be deleted.

    Args:
        target: The file, links followed.
        data: Its whole content.
        overwrite: Whether a file that exists is replaced; it keeps its permissions.

    Raises:
        OSError: The bytes cannot be written; by the function: the file exists (FileExistsError), or has no place.
    """
    nameless = _open_nameless(target.parent)
    if nameless is None:
        with _named(target, data) as temporary:
            yield lambda: _place(temporary, target, overwrite=overwrite)
        return
    with open(nameless, "wb") as file:  # noqa: PTH123  a number, no name
        _to_disk(file, data)
        yield lambda: _place_nameless(nameless, target, data, overwrite=overwrite)


def takes_files(folder: Path) -> None:
    """Try to make a file in a folder; nothing is left of it.

    Raises:
        OSError: It cannot be made.
    """
    nameless = _open_nameless(folder)
    if nameless is not None:
        os.close(nameless)
        return
    with _named(folder / "file", b""):
        pass


def _open_nameless(folder: Path) -> int | None:
    """A file without a name, open; None where there are none."""
    try:
        return os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666)
    except (AttributeError, OSError):
        return None


@contextlib.contextmanager
def _named(target: Path, data: bytes) -> Iterator[Path]:
    """A file beside ``target`` with these bytes, which is gone at the end."""
    temporary = target.parent / f".calib-{secrets.token_hex(8)}.tmp"
    try:
        with temporary.open("xb") as file:
            _to_disk(file, data)
        yield temporary
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _to_disk(file: BinaryIO, data: bytes) -> None:
    """Write the bytes and wait until they are on the disk."""
    file.write(data)
    file.flush()
    os.fsync(file.fileno())


def _place(temporary: Path, target: Path, *, overwrite: bool) -> None:
    """Give a file the name of ``target``."""
    if not overwrite:
        _move_to_new(temporary, target)
        return
    with contextlib.suppress(FileNotFoundError):
        temporary.chmod(_permissions(target))
    temporary.replace(target)


def _place_nameless(nameless: int, target: Path, data: bytes, *, overwrite: bool) -> None:
    """Give a file without a name that of ``target``."""
    folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if not overwrite and _link(nameless, target, folder):
            return
        with contextlib.suppress(FileNotFoundError):
            os.fchmod(nameless, _permissions(target))
        temporary = _link_beside(nameless, target, folder) if overwrite else None
    finally:
        os.close(folder)
    if temporary is None:  # this system gives them none
        with _named(target, data) as temporary:
            _place(temporary, target, overwrite=overwrite)
        return
    try:
        temporary.replace(target)
    except OSError:
        temporary.unlink()
        raise


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
