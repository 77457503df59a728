"""ROS packages: the folder that ``$(find package)`` and ``package://package`` mean, with ROS or without it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

__all__ = ["MANIFEST", "find_package", "is_near", "named_so", "packages_in", "where_packages_are"]

MANIFEST = "package.xml"
_MANIFEST_BYTES = 1_000_000
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")

#: How many folders down a package may lie: below ROS_PACKAGE_PATH, in a workspace's `src`, anywhere else.
_DEEP, _WORKSPACE, _BESIDE = 5, 2, 1

#: How many folders above a file may have a package without a ``package.xml`` in them.
_NEAR = 4


def find_package(name: str, file: Path) -> Path | None:
    """The folder of a ROS package; None if it is not found.

    Looked for in this order: the ament index (``AMENT_PREFIX_PATH``), as ROS 2 does; ``ROS_PACKAGE_PATH``, as ROS 1
    does; the folders above ``file`` and those beside them, whose ``package.xml`` has the name, so that a description
    that was only downloaded is found; last a folder of that name without a ``package.xml``.

    Args:
        name: Name of the package.
        file: The file that names it.
    """
    if not re.fullmatch(r"[\w.-]+", name) or name.startswith("."):
        return None
    above = Path(os.path.realpath(file)).parents
    return next(_candidates(name, above), None)


def where_packages_are(file: Path) -> str:
    """Where `find_package` looked, for a message."""
    said = [
        f"{variable} ({os.environ.get(variable) or 'not set'})"
        for variable in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH")
    ]
    return f"{said[0]}, {said[1]}, and the folders above and beside '{file}'"


def named_so(folder: Path, name: str) -> bool:
    """Whether the folder's ``package.xml`` has that name."""
    try:
        with (folder / MANIFEST).open("rb") as manifest:
            found = _NAME.search(_COMMENT.sub(b"", manifest.read(_MANIFEST_BYTES)))
    except OSError:
        return False
    return found is not None and found[1] == name.encode()


def packages_in(folder: Path, name: str, depth: int = _BESIDE) -> Iterator[Path]:
    """The packages of that name in a folder, the folder itself first, no deeper than ``depth``."""
    if (folder / MANIFEST).is_file():  # packages do not lie in one another
        if named_so(folder, name):
            yield folder
    elif depth:
        for below in _folders(folder):
            yield from packages_in(below, name, depth - 1)


def is_near(package: Path, above: Sequence[Path]) -> bool:
    """Whether a folder without a ``package.xml`` may be meant: one above the file, or beside those next above it.

    Farther up every folder of the disk would be a package, and its files those of the description.

    Args:
        package: The folder.
        above: Those above the file, the nearest first.
    """
    beside = [folder for folder in above[:_NEAR] if folder.parent != folder]
    return package in above or package.parent in beside


def _candidates(name: str, above: Sequence[Path]) -> Iterator[Path]:
    """The folders that the name may mean, the likeliest first."""
    for prefix in _listed("AMENT_PREFIX_PATH"):
        index = prefix / "share" / "ament_index" / "resource_index" / "packages" / name
        if index.is_file() and (prefix / "share" / name).is_dir():
            yield prefix / "share" / name
    for folder in _listed("ROS_PACKAGE_PATH"):
        yield from packages_in(folder, name, _DEEP)
    for folder in above:
        yield from packages_in(folder, name, _WORKSPACE if folder.name == "src" else _BESIDE)
    for folder in above:
        plain = folder / name
        if plain.is_dir() and not (plain / MANIFEST).exists() and is_near(plain, above):
            yield plain


def _listed(variable: str) -> list[Path]:
    """The folders of an environment variable."""
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _folders(folder: Path) -> list[Path]:
    """The folders in a folder in the order of their names, hidden ones left out; none if it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            names = [e.name for e in entries if not e.name.startswith(".") and e.is_dir()]
    except OSError:
        return []
    return [folder / name for name in sorted(names)]
