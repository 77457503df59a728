"""Given folders: where the files that a robot's description names may lie.

Given are the description's own folder with all below it, its ROS package, and the folders that the user has named: by
an option, an argument or an environment variable. A name that leads out of them, by ``..``, as a whole path or over a
symbolic link, is not followed: a description from elsewhere cannot have any file of the computer read.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from calib.model.ros_packages import MANIFEST

__all__ = ["GivenFolders", "listed_folders", "own_folder"]

#: A description in a folder of such a name has its meshes beside that folder, also without a ``package.xml``.
_PARTS = (
    "urdf",
    "urdfs",
    "xacro",
    "robots",
    "robot",
    "description",
    "model",
    "models",
    "config",
    "sdf",
)


@dataclass(frozen=True, slots=True)
class GivenFolders:
    """Folders out of which files may be read.

    Attributes:
        own: Of the description: symbolic links in them must not lead out.
        named: By the user: links in them are the user's, as those of a ROS workspace.
    """

    own: tuple[Path, ...] = ()
    named: tuple[Path, ...] = ()

    def hold(self, path: Path) -> bool:
        """Whether a file lies in one of them, wherever ``..`` and links lead."""
        try:
            real = Path(os.path.realpath(path))
            plain = Path(os.path.abspath(path))  # noqa: PTH100  without following links
        except (OSError, ValueError):  # a name that the system cannot have
            return False
        if any(real.is_relative_to(os.path.realpath(one)) for one in (*self.own, *self.named)):
            return True
        # Links of a folder: /a/link/../b is not /a/b, so that no '..' is taken out before they are followed.
        return ".." not in path.parts and any(
            plain.is_relative_to(os.path.abspath(one))  # noqa: PTH100
            for one in self.named
        )

    def and_own(self, folders: Iterable[Path]) -> GivenFolders:
        """These and more that count as the description's own."""
        return GivenFolders((*self.own, *folders), self.named)


def own_folder(file: Path) -> Path:
    """The folder of a description: its package's, or else the one that it lies in.

    The parent of a folder that is called ``urdf`` or so counts as a package's.
    """
    folder = Path(os.path.realpath(file)).parent
    for above in (folder, *folder.parents):
        if (above / MANIFEST).is_file():
            return above
    parent = folder.parent
    return parent if folder.name.lower() in _PARTS and parent != parent.parent else folder


def listed_folders() -> tuple[Path, ...]:
    """The folders of ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH``."""
    found = [
        Path(entry)
        for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
        for entry in os.environ.get(variable, "").split(os.pathsep)
        if entry
    ]
    return tuple(dict.fromkeys(found))
