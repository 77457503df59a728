"""ROS packages: the folder that ``$(find package)`` and ``package://package`` mean, with ROS or without it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

MANIFEST = "package.xml"
_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)

#: How many folders down a package may lie: below ROS_PACKAGE_PATH, in a workspace's `src`, anywhere else.
_DEEP, _WORKSPACE, _BESIDE = 5, 2, 1


def package_folder(name: str, file: Path) -> Path:
    """The folder of a ROS package.

    Looked for in this order: the ament index (``AMENT_PREFIX_PATH``), as ROS 2 does; ``ROS_PACKAGE_PATH``, as ROS 1
    does; the folders above ``file`` and those beside them, whose ``package.xml`` has the name, so that a description
    that was only downloaded is found; last a folder of that name without a ``package.xml``.

    Args:
        name: Name of the package.
        file: The file that names it.

    Raises:
        LookupError: It is not found.
    """
    found = next(_candidates(name, file.resolve()), None) if name.strip(".") else None
    if found is None:
        paths = [
            f"{key} ({os.environ.get(key) or 'not set'})"
            for key in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH")
        ]
        raise LookupError(
            f"there is no ROS package '{name}' in {paths[0]}, {paths[1]}, or the folders above and beside '{file}'. "
            "Source the ROS workspace that has it, or name the folder above its package.xml: export "
            "ROS_PACKAGE_PATH=FOLDER"
        )
    return found


def listed_folders(variable: str) -> list[Path]:
    """The folders of an environment variable such as ``ROS_PACKAGE_PATH``."""
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def packages_in(folder: Path, name: str, depth: int = _BESIDE) -> Iterator[Path]:
    """The packages of that name in a folder, the folder itself first, no deeper than ``depth``."""
    if (folder / MANIFEST).is_file():  # packages do not lie in one another
        found = _NAME.search(_COMMENT.sub(b"", (folder / MANIFEST).read_bytes()))
        if found is not None and found[1] == name.encode():
            yield folder
    elif depth and os.access(folder, os.R_OK) and folder.is_dir():
        for below in sorted(folder.iterdir()):
            if below.is_dir() and not below.name.startswith("."):
                yield from packages_in(below, name, depth - 1)


def _candidates(name: str, file: Path) -> Iterator[Path]:
    """The folders that the name may mean, the likeliest first."""
    for prefix in listed_folders("AMENT_PREFIX_PATH"):
        index = prefix / "share" / "ament_index" / "resource_index" / "packages" / name
        if index.is_file():
            yield prefix / "share" / name
    for folder in listed_folders("ROS_PACKAGE_PATH"):
        yield from packages_in(folder, name, _DEEP)
    for folder in file.parents:
        yield from packages_in(folder, name, _WORKSPACE if folder.name == "src" else _BESIDE)
    for folder in file.parents:
        if (folder / name).is_dir() and not (folder / name / MANIFEST).exists():
            yield folder / name
