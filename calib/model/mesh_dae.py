"""COLLADA files as triangles: the geometries of the scene, each where its nodes put it, in metres.

``<up_axis>`` is not heeded, as ROS and its simulators do not: a mesh stands in its link as it is written.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

#: Text [bytes], elements, depth, nodes of a scene and triangles: no mesh of a robot has more.
_LIMIT_TEXT, _MOST_ELEMENTS, _DEEPEST, _MOST_NODES, _MOST = (
    100_000_000,
    500_000,
    100,
    20_000,
    3_000_000,
)

#: Characters that become numbers at a time.
_PIECE = 1_000_000

_POLYGONS = ("triangles", "polylist", "polygons", "tristrips", "trifans")


class MeshFault(Exception):
    """A mesh file cannot be read; the text goes on after the file's name."""


def dae_triangles(data: bytes) -> tuple[Array, Faces]:
    """The triangles of a COLLADA file.

    Args:
        data: The file.

    Returns:
        Vertices, shape (V, 3), [m]; faces, shape (F, 3), indices of vertices.

    Raises:
        MeshFault: It cannot be read.
        ValueError: So it is, too.
    """
    scene = _Scene.of(_parsed(data))
    vertices: list[Array] = []
    faces: list[Faces] = []
    count, total = 0, 0
    for name, T in scene.placed():
        points, corners = scene.geometry(name)
        total += len(corners) + len(points)
        if total > _MOST:
            message = f"has more than {_MOST:,} triangles"
            raise MeshFault(message)
        vertices.append(points @ T[:3, :3].T + T[:3, 3])
        faces.append(corners + count)
        count += len(points)
    if not faces:
        message = "is empty"
        raise MeshFault(message)
    return scene.unit * np.concatenate(vertices), np.concatenate(faces)


def _parsed(data: bytes) -> Element:
    """The elements, their names without namespaces.

    Raises:
        MeshFault: No XML, a document type, or more elements than a mesh has.
    """
    count, depth = 0, 0
    builder = TreeBuilder()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count, depth
        count, depth = count + 1, depth + 1
        if count > _MOST_ELEMENTS or depth > _DEEPEST:
            message = (
                f"has more than {_MOST_ELEMENTS:,} elements, or more than {_DEEPEST} in one another"
            )
            raise MeshFault(message)
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    def doctype(*_: object) -> None:
        message = "has a <!DOCTYPE>, which is not read; delete it"
        raise MeshFault(message)

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    if len(data) > _LIMIT_TEXT:
        message = f"is larger than {_LIMIT_TEXT:,} bytes"
        raise MeshFault(message)
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError) as error:
        message = "cannot be read"
        raise MeshFault(message) from error
    return builder.close()


@dataclass(frozen=True, slots=True)
class _Scene:
    """A file.

    Attributes:
        root: Its outermost element.
        by_id: Elements that have an id.
        unit: What the file calls 1 [m].
        known: Geometries that have been read, by id.
    """

    root: Element
    by_id: Mapping[str, Element]
    unit: float
    known: dict[str, tuple[Array, Faces]]

    @classmethod
    def of(cls, root: Element) -> _Scene:
        """The scene of a document."""
        by_id = {e.get("id", ""): e for e in root.iter() if e.get("id")}
        unit = root.find("asset/unit")
        meter = 1.0 if unit is None else float(unit.get("meter", "1"))
        return cls(root, by_id, meter if 0.0 < meter < math.inf else 1.0, {})

    def placed(self) -> Iterator[tuple[str, Array]]:
        """The id of each geometry of the scene, and its pose, (4, 4), in the file's unit."""
        instance = self.root.find("scene/instance_visual_scene")
        scene = None if instance is None else self.linked(instance, "url", "visual_scene")
        if scene is None:
            scene = self.root.find("library_visual_scenes/visual_scene")
        if scene is None:  # a file of geometries alone
            yield from ((g.get("id", ""), np.eye(4)) for g in self.root.iter("geometry"))
            return
        waiting = [(node, np.eye(4), 0) for node in reversed(scene.findall("node"))]
        count = 0
        while waiting:
            node, T_above, depth = waiting.pop()
            count += 1
            if count > _MOST_NODES or depth > _DEEPEST:
                message = "has nodes that hold one another, or too many of them"
                raise MeshFault(message)
            T = T_above @ _transform(node)
            yield from ((name, T @ S) for name, S in self._geometries(node))
            below = [*node.findall("node")]
            below += [self.linked(one, "url", "node") for one in node.findall("instance_node")]
            waiting += [(one, T, depth + 1) for one in reversed(below)]

    def _geometries(self, node: Element) -> Iterator[tuple[str, Array]]:
        """The geometries that hang on a node itself."""
        for one in node.findall("instance_geometry"):
            yield one.get("url", "").removeprefix("#"), np.eye(4)
        for one in node.findall("instance_controller"):
            skin = self.linked(one, "url", "controller").find("skin")
            if skin is not None:
                bound = skin.find("bind_shape_matrix")
                S = np.eye(4) if bound is None else _floats(bound.text).reshape(4, 4)
                yield skin.get("source", "").removeprefix("#"), S

    def linked(self, element: Element, key: str, tag: str) -> Element:
        """The element that a name of this file means."""
        found = self.by_id.get(element.get(key, "").removeprefix("#"))
        if found is None or found.tag != tag:
            message = f"has no <{tag}> '{element.get(key, '')[:60]}' in it"
            raise MeshFault(message)
        return found

    def geometry(self, name: str) -> tuple[Array, Faces]:
        """The vertices and triangles of a geometry."""
        if name not in self.known:
            found = self.by_id.get(name)
            if found is None or found.tag != "geometry":
                message = f"has no <geometry> '{name[:60]}' in it"
                raise MeshFault(message)
            self.known[name] = self._triangles(found)
        return self.known[name]

    def _triangles(self, geometry: Element) -> tuple[Array, Faces]:
        """What a geometry has; lines and curves are left out."""
        vertices: list[Array] = [np.empty((0, 3))]
        faces: list[Faces] = [np.empty((0, 3), dtype=np.int64)]
        sources: dict[str, int] = {}
        count = 0
        for primitive in [e for e in geometry.findall("mesh/*") if e.tag in _POLYGONS]:
            inputs = primitive.findall("input")
            stride = 1 + max((int(one.get("offset", "0")) for one in inputs), default=0)
            at = [one for one in inputs if one.get("semantic") == "VERTEX"]
            if not at:
                continue
            source = self.linked(at[0], "source", "vertices")
            name = source.get("id", "")
            if name not in sources:
                points = self._positions(source)
                sources[name], count = count, count + len(points)
                vertices.append(points)
            corners = list(_polygons(primitive, stride, int(at[0].get("offset", "0"))))
            faces += [c + sources[name] for c in corners]
        return np.concatenate(vertices), np.concatenate(faces)

    def _positions(self, vertices: Element) -> Array:
        """The positions of a <vertices>, shape (V, 3)."""
        wanted = [e for e in vertices.findall("input") if e.get("semantic") == "POSITION"]
        source = self.linked(wanted[0], "source", "source")
        array = source.find("float_array")
        values = _floats(None if array is None else array.text)
        accessor = source.find("technique_common/accessor")
        stride = 3 if accessor is None else int(accessor.get("stride", "3"))
        offset = 0 if accessor is None else int(accessor.get("offset", "0"))
        if not 3 <= stride <= 100 or offset < 0:
            message = "has vertices without three coordinates"
            raise MeshFault(message)
        whole = values[offset : offset + (len(values) - offset) // stride * stride]
        return whole.reshape(-1, stride)[:, :3]


def _polygons(primitive: Element, stride: int, offset: int) -> Iterator[Faces]:
    """The triangles of a primitive, shape (F, 3) each."""
    if not 0 <= offset < stride <= 100:
        message = "has polygons that cannot be read"
        raise MeshFault(message)
    indices = [_integers(p.text).reshape(-1, stride)[:, offset] for p in primitive.iter("p")]
    if primitive.tag == "triangles":
        yield from (one[: len(one) // 3 * 3].reshape(-1, 3) for one in indices)
    elif primitive.tag == "polylist":
        sizes = primitive.find("vcount")
        counts = _integers(None if sizes is None else sizes.text)
        for one in indices[:1]:
            if (counts < 0).any() or counts.sum() > len(one):
                message = "has polygons that cannot be read"
                raise MeshFault(message)
            yield _fans(one, counts)
    else:
        for one in indices:
            if primitive.tag == "tristrips":
                strip = np.stack([one[:-2], one[1:-1], one[2:]], axis=1)
                strip[1::2] = strip[1::2, [1, 0, 2]]
                yield strip
            else:
                yield _fans(one, np.array([len(one)]))


def _fans(corners: Faces, counts: Faces) -> Faces:
    """Polygons, one after the other, as triangles about the first corner of each."""
    start = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    each = np.maximum(counts - 2, 0)
    first = np.repeat(start, each)
    within = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    triangles: Faces = corners[np.stack([first, first + within + 1, first + within + 2], axis=1)]
    return triangles


def _transform(node: Element) -> Array:
    """The pose of a node in the one above it: its transformations in the file's order."""
    T = np.eye(4)
    for one in node:
        if one.tag == "matrix":
            T = T @ _floats(one.text).reshape(4, 4)
        elif one.tag in ("translate", "scale"):
            x, y, z = _floats(one.text)
            step = np.diag([x, y, z, 1.0]) if one.tag == "scale" else np.eye(4)
            if one.tag == "translate":
                step[:3, 3] = x, y, z
            T = T @ step
        elif one.tag == "rotate":
            *axis, degrees = _floats(one.text)
            T = T @ _turn(np.array(axis), math.radians(degrees))
    return T


def _turn(axis: Array, angle: float) -> Array:
    """A rotation about an axis, shape (4, 4), by Rodrigues' formula."""
    x, y, z = axis / (np.linalg.norm(axis) or 1.0)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    T = np.eye(4)
    T[:3, :3] += math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K
    return T


def _floats(text: str | None) -> Array:
    """The numbers of a text."""
    found = [np.array(words, dtype=np.float64) for words in _words(text)]
    return np.concatenate([np.empty(0), *found])


def _integers(text: str | None) -> Faces:
    """The whole numbers of a text."""
    found = [np.array(words, dtype=np.int64) for words in _words(text)]
    return np.concatenate([np.empty(0, dtype=np.int64), *found])


def _words(text: str | None) -> Iterator[list[str]]:
    """The words of a text, some thousands at a time, so that not all are in memory as text."""
    text, start = text or "", 0
    while start < len(text):
        end = start + _PIECE
        while end < len(text) and not text[end].isspace():
            end += 1
        yield text[start:end].split()
        start = end
