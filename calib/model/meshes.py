"""The shapes of a URDF's links: its ``<visual>`` and ``<collision>`` elements, and the files of their meshes."""

from __future__ import annotations

import importlib.metadata
import itertools
import math
import os
import re
import sys
import urllib.parse
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.model.ros_packages import packages_in
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

#: Largest mesh file that is read [bytes].
LIMIT_BYTES = 200_000_000

#: The unit of a COLLADA file, which stands at its beginning.
_UNIT = re.compile(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']\s*([0-9.eE+-]+)\s*[\"']")
_HEAD_BYTES = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """One ``<visual>`` or ``<collision>`` of one link, as the URDF states it.

    Attributes:
        link: The link's name.
        T_link_shape: shape (4, 4), [m], pose of the shape in the link.
        geometry: The element inside ``<geometry>``.
    """

    link: str
    T_link_shape: Array
    geometry: Element

    @property
    def mesh(self) -> tuple[str, tuple[float, float, float]] | None:
        """A mesh's file name and scale; None for another geometry."""
        if self.geometry.tag != "mesh":
            return None
        scale = numbers(self.geometry.get("scale"), (1.0, 1.0, 1.0))
        return self.geometry.get("filename", ""), scale

    @property
    def sizes(self) -> tuple[float, ...] | None:
        """Edges of a box, radius and length of a cylinder or capsule, radius of a sphere [m]; None for all else.

        None too where a size is missing or not positive.
        """
        found: tuple[float, ...] = ()
        if self.geometry.tag == "box":
            found = numbers(self.geometry.get("size"), (0.0, 0.0, 0.0))
        elif self.geometry.tag in ("cylinder", "capsule"):
            found = (self._length("radius"), self._length("length"))
        elif self.geometry.tag == "sphere":
            found = (self._length("radius"),)
        return found if found and all(0.0 < size < math.inf for size in found) else None

    def _length(self, name: str) -> float:
        """A number of the geometry, NaN where it is none."""
        try:
            return float(self.geometry.get(name, ""))
        except ValueError:
            return math.nan


def link_shapes(urdf: Urdf, kind: Literal["visual", "collision"]) -> Iterator[LinkShape]:
    """Every shape of that kind of every link, in the file's order."""
    for link in urdf.elements().findall("link"):
        for element in link.findall(kind):
            for geometry in element.findall("geometry/*")[:1]:
                yield LinkShape(link.get("name", ""), _origin(element), geometry)


def mesh_folders(urdf: Urdf, package_dirs: Iterable[str | Path] = ()) -> tuple[Path, ...]:
    """The folders in which ``package://`` and relative mesh names are looked for, each once.

    Those that the user named, the URDF's own folder and those above it, ``ROS_PACKAGE_PATH``, ``AMENT_PREFIX_PATH``,
    the share folder of example-robot-data and the one of this Python.
    """
    folders = [Path(folder) for folder in package_dirs]
    if urdf.path is not None:
        folders += Path(os.path.realpath(urdf.path)).parents
    for name, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        listed = os.environ.get(name, "").split(os.pathsep)
        folders += [Path(folder) / below for folder in listed if folder]
    folders += _robot_data_shares()
    folders.append(Path(sys.prefix) / "share")
    return tuple(dict.fromkeys(folders))


def find_mesh(name: str, folders: Sequence[Path]) -> Path | None:
    """The file that ``package://package/rest``, ``file:///path`` or a plain path means; None if there is none."""
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    candidates: list[Path] = []
    named: Iterable[Path] = ()
    if scheme in ("package", "model"):
        rest = rest.lstrip("/")  # a package without a name: what follows lies in one of the folders
        inside = rest.partition("/")[2]
        candidates = [folder / rest for folder in folders]
        candidates += [folder / inside for folder in folders if folder.name == rest.split("/")[0]]
        package = rest.partition("/")[
            0
        ]  # of a folder with another name: only its package.xml tells
        named = (found / inside for folder in folders for found in packages_in(folder, package))
    elif scheme in ("", "file"):
        plain = Path(urllib.parse.unquote(rest) if scheme else rest)
        candidates = [folder / plain for folder in folders] if rest else []
    return next(filter(_is_file, itertools.chain(candidates, named)), None)


def load_mesh(path: Path, scale: Sequence[float]) -> tuple[Any, str]:
    """A mesh file as a bounding volume hierarchy of coal, and ``""``; or None and what is wrong with the file.

    Args:
        path: The file.
        scale: Factors along x, y, z.
    """
    try:
        if path.stat().st_size > LIMIT_BYTES:
            return None, f"is larger than {LIMIT_BYTES:,} bytes"
        factors = np.asarray(scale, dtype=np.float64) * _unit(path)
        mesh = hppfcl.MeshLoader().load(str(path), factors)
        vertices = mesh_vertices(mesh)
        triangles = mesh.num_tris
    except (ValueError, RuntimeError, OSError, AttributeError):
        return None, "cannot be read"
    if not triangles or not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).any():
        return None, "is empty"
    if path.suffix.lower() != ".stl" and len(np.unique(mesh_faces(mesh))) < len(vertices):
        mesh = _whole(path, vertices, factors)
        return mesh, "" if mesh is not None else "has several parts that cannot be read"
    return mesh, ""


def mesh_vertices(mesh: Any) -> Array:  # noqa: ANN401  coal has no types
    """The vertices of a mesh that `load_mesh` gave, shape (V, 3), [m]."""
    return np.array(mesh.vertices(), dtype=np.float64).reshape(-1, 3)


def mesh_faces(mesh: Any) -> NDArray[np.int64]:  # noqa: ANN401  coal has no types
    """The faces of a mesh that `load_mesh` gave, shape (F, 3), indices of vertices."""
    corners = [mesh.tri_indices(i) for i in range(mesh.num_tris)]
    return np.array([(c[0], c[1], c[2]) for c in corners], dtype=np.int64).reshape(-1, 3)


def _unit(path: Path) -> float:
    """What a COLLADA file calls 1, [m]; coal takes it as 1 m, ROS and its simulators take the file at its word."""
    if path.suffix.lower() != ".dae":
        return 1.0
    with path.open("rb") as file:
        found = _UNIT.search(file.read(_HEAD_BYTES))
    value = float(found[1]) if found else 1.0  # ValueError for what is no number
    return value if 0.0 < value < math.inf else 1.0


def _whole(path: Path, vertices: Array, scale: Array) -> Any | None:  # noqa: ANN401  coal has no types
    """A mesh of several parts, with the faces of each; None if it cannot be read.

    coal counts the vertices of a node's second part, such as one of another material, from its first vertex again: the
    faces then join vertices of another part. Its vertices are right, and those of trimesh must lie in the same box.
    """
    import trimesh  # takes half a second, and few meshes need it

    try:
        with warnings.catch_warnings():
            # What a reader uses of NumPy that will be gone one day is not ours to mend.
            warnings.simplefilter("ignore", DeprecationWarning)
            read: Any = trimesh.load(str(path), force="mesh", process=False, skip_materials=True)
        own = np.asarray(read.vertices, dtype=np.float64) * scale
        faces = np.asarray(read.faces, dtype=np.int64).reshape(-1, 3)
        box = np.array([own.min(axis=0), own.max(axis=0)])
    except Exception:  # noqa: BLE001  what the readers of many formats raise is not known
        return None
    box_of_coal = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    if not np.allclose(box, box_of_coal, rtol=0.0, atol=1e-3 * np.ptp(vertices, axis=0).max()):
        return None
    mesh = hppfcl.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(own))
    mesh.addVertices(own)
    mesh.addTriangles(faces)
    mesh.endModel()
    return mesh


def numbers(text: str | None, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Three finite numbers, or the default."""
    try:
        x, y, z = (float(word) for word in (text or "").split())
    except ValueError:
        return default
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else default


@lru_cache(maxsize=1)
def _robot_data_shares() -> tuple[Path, ...]:
    """The ``share`` folder of the installed example-robot-data, from its list of files, which is long; or none."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return ()
    for file in files:
        for i, pair in enumerate(zip(file.parts, file.parts[1:], strict=False)):
            if pair == ("share", "example-robot-data"):
                return (Path(str(file.locate())).parents[len(file.parts) - i - 2],)
    return ()


def _origin(element: Element) -> Array:
    """The pose in ``<origin>``; what is not three numbers counts as absent."""
    T = np.eye(4)
    for origin in element.findall("origin"):
        T[:3, 3] = numbers(origin.get("xyz"), (0.0, 0.0, 0.0))
        rpy = numbers(origin.get("rpy"), (0.0, 0.0, 0.0))
        T[:3, :3] = pin.rpy.rpyToMatrix(*rpy)
    return T


def _is_file(path: Path) -> bool:
    """Whether there is such a file; no for a name that the system cannot have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
