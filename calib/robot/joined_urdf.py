"""One URDF of several robots: the first one as it is, the others beside it, with their names before their links' names.

Each further robot stands on a fixed joint, its *mount*, whose <origin> is the pose of its root link in the root link of
the first. So bases of robots are placements like any other, and a chain may lead from one robot's hand to another's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.errors import UrdfError, choices
from calib.robot.urdf import Urdf

#: Between the name of a further robot and the name that a link or joint has in its own URDF.
SEPARATOR = "/"

#: Elements of a URDF that have a name of their own, or name a link, joint or material, by the attribute.
_NAMES = {
    "link": "name",
    "joint": "name",
    "material": "name",
    "parent": "link",
    "child": "link",
    "mimic": "joint",
}

#: Elements directly below <robot> that are taken over: others are about simulators and drives.
_TAKEN = ("link", "joint", "material")


@dataclass(frozen=True, slots=True)
class Part(Value):
    """A robot of a joined URDF."""

    #: Its name, which begins the names of its links and joints in the joined URDF; empty: the first one, which stands
    #: in the root.
    name: str
    #: Its own URDF.
    urdf: Urdf
    #: True if its place, the <origin> of ``mount``, is estimated.
    estimated: bool = True

    @property
    def mount(self) -> str:
        """The fixed joint of the joined URDF that it stands on."""
        return f"{self.name}{SEPARATOR}mount"

    def with_origins_of(self, origins: Mapping[str, Array]) -> Urdf:
        """Return the robot's own URDF with joint origins of the joined one, those of other robots left out.

        Args:
            origins: Poses of joints in their parent links, (4, 4) [m], by their names in the joined URDF.
        """
        prefix = f"{self.name}{SEPARATOR}" if self.name else ""
        own_origins = {
            joint.name: origins[prefix + joint.name]
            for joint in self.urdf.joints
            if prefix + joint.name in origins
        }
        return self.urdf.with_origins(own_origins)


def joined_urdf(first: Urdf, parts: tuple[Part, ...], mounts: Mapping[str, Array]) -> Urdf:
    """Return one URDF of several robots.

    Args:
        first: The first robot, whose names stay.
        parts: The others.
        mounts: Pose of each one's root link in the root link of the first, (4, 4) [m], by its name.

    Raises:
        UrdfError: A name is empty or given twice, or the first robot has a link or joint of a further one's name.
    """
    names = [part.name for part in parts]
    if not all(names) or len(set(names)) < len(names):
        raise UrdfError(f"Further robots are named {choices(names)}; each needs a name of its own.")
    taken = {*first.links, *(joint.name for joint in first.joints)}
    joined = first
    for part in parts:
        prefix = part.name + SEPARATOR
        clash = [name for name in taken if name.startswith(prefix)]
        if clash:
            raise UrdfError(
                f"{first.source} has '{clash[0]}', which looks like a link or joint of the robot '{part.name}'. Give "
                "that robot another name."
            )
        elements = [child for child in part.urdf.elements() if _tag(child) in _TAKEN]
        for element in elements:
            for child in element.iter():
                attribute = _NAMES.get(_tag(child), "")
                if attribute in child.attrib:
                    child.attrib[attribute] = prefix + child.attrib[attribute]
        text = "".join(tostring(element, encoding="unicode") for element in elements)
        root = prefix + part.urdf.root
        joined = joined.joined_with(text, part.mount, first.root, root, mounts[part.name])
    return joined


def _tag(element: Element) -> str:
    """Return the tag of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def path_of_robot(path: str | Path, name: str) -> Path:
    """Return the path of the URDF of one robot of a cell: ``cell_right.urdf`` of ``right`` beside ``cell.urdf``.

    Args:
        path: That of the cell's URDF.
        name: The robot's name; empty for the first, ``cell_first.urdf``.
    """
    of_cell = Path(path)
    return of_cell.with_name(f"{of_cell.stem}_{name or 'first'}{of_cell.suffix}")
