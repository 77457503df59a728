"""The XML files of a MuJoCo model (MJCF): the main one and those that it includes, as one tree of elements.

An ``<include file="...">`` stands for the children of the other file's outermost element. MuJoCo looks for the file
first in the folder of the main file, then in that of the including one, and takes each file once.

Each element knows its file and its place there, so that a number can be changed where it stands.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from calib.basics.files import read_bytes
from calib.errors import FileError, UrdfError
from calib.robot.urdf_xml import Document, Element

#: The outermost element of an MJCF.
ROOT = "mujoco"

_WHAT = "MuJoCo model (MJCF)"


@dataclass(frozen=True, slots=True, eq=False)
class MjcfFile:
    """One XML file of a model."""

    #: Where it is, or will be if it is not written yet.
    path: Path
    #: Its name as the ``<include>`` states it; of the main file its own.
    name: str
    #: Its bytes and elements, at all levels.
    document: Document


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """An element of the whole model."""

    #: The file in which it stands.
    file: MjcfFile
    #: The element; its own children may hold an ``<include>``.
    element: Element
    #: Its children, with those of included files in the place of each ``<include>``.
    children: tuple[Node, ...] = field(repr=False)

    @property
    def tag(self) -> str:
        """Name of the element."""
        return self.element.tag

    @property
    def attributes(self) -> Mapping[str, str]:
        """Attributes as they are written, without those of defaults."""
        return self.element.attributes

    def all(self, *tags: str) -> list[Node]:
        """Return the children of these names, in order."""
        return [child for child in self.children if child.tag in tags]

    def walk(self) -> Iterator[Node]:
        """Yield the element and all below it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()

    def at(self, text: str) -> UrdfError:
        """Return an error that says where: file, line, element, then a text."""
        name = self.attributes.get("name", "")
        called = f" '{name}'" if name else ""
        return self.file.document.at(self.element, f"<{self.tag}>{called}: {text}")


@dataclass(frozen=True, slots=True, eq=False)
class MjcfFiles:
    """The files of a model."""

    #: The outermost element of the main file, with the content of included files.
    root: Node
    #: The main file first, then those that are included, in the order of their use.
    files: tuple[MjcfFile, ...]
    #: For each included file the file and the element that includes it, by the path of the included one.
    includes: Mapping[Path, tuple[MjcfFile, Element]]


def is_mjcf(data: bytes) -> bool:
    """Return True if the bytes of a file are XML whose outermost element is that of an MJCF."""
    try:
        return Document.from_bytes(data, "", depth=1).root.tag == ROOT
    except UrdfError:
        return False


def read_files(path: Path, changed: Mapping[Path, bytes] | None = None) -> MjcfFiles:
    """Read an MJCF with the files that it includes.

    Args:
        path: The main file.
        changed: Bytes of files that are not written yet, by the path that they will have; None for none.

    Raises:
        FileError: A file cannot be read.
        UrdfError: A file is not XML, or an ``<include>`` has a fault; the text says where.
    """
    reader = _Reader(path.parent, changed or {})
    main = reader.open(path, path.name)
    if main.document.root.tag != ROOT:
        raise main.document.at(
            main.document.root,
            f"the outermost element is <{main.document.root.tag}>; an MJCF has <{ROOT}>",
        )
    return MjcfFiles(
        reader.node(main, main.document.root), tuple(reader.files.values()), reader.includes
    )


class _Reader:
    """Reading of a model: the files and elements so far."""

    def __init__(self, folder: Path, changed: Mapping[Path, bytes]) -> None:
        self.folder = folder
        self.changed = changed
        self.files: dict[Path, MjcfFile] = {}
        self.includes: dict[Path, tuple[MjcfFile, Element]] = {}

    def open(self, path: Path, name: str) -> MjcfFile:
        """Return a file that was not read before."""
        data = self.changed.get(path)
        if data is None:
            data = read_bytes(path, _WHAT)
        file = MjcfFile(path, name, Document.from_bytes(data, name, _WHAT, sys.maxsize))
        self.files[path] = file
        return file

    def node(self, file: MjcfFile, element: Element) -> Node:
        """Return an element with its children."""
        children: list[Node] = []
        for child in element.children:
            if child.tag == "include":
                children += self.included(file, child)
            else:
                children.append(self.node(file, child))
        return Node(file, element, tuple(children))

    def included(self, file: MjcfFile, element: Element) -> tuple[Node, ...]:
        """Return what stands for an ``<include>``; UrdfError if it names no file, or one a second time."""
        name = element.attributes.get("file", "")
        if not name:
            raise file.document.at(element, '<include> names no file; give it file="..."')
        candidates = [self.folder / name, file.path.parent / name]
        there = [path for path in candidates if path in self.changed or path.is_file()]
        path = (there or candidates)[0]
        if path in self.files:
            raise file.document.at(
                element,
                f"<include>: '{name}' is included a second time, which MuJoCo refuses; copy the file for that",
            )
        self.includes[path] = (file, element)
        try:
            opened = self.open(path, name)
        except FileError as error:
            raise FileError(
                f"{file.document.source}, line {element.line}: <include>: {error}"
            ) from error
        return self.node(opened, opened.document.root).children
