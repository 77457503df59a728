"""The shapes of a URDF's links: its ``<visual>`` and ``<collision>`` elements, and the files of their meshes."""

from __future__ import annotations

import importlib.metadata
import math
import os
import sys
import urllib.parse
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

from calib.model.given_folders import GivenFolders, own_folder
from calib.model.mesh_files import MeshFault, read_triangles
from calib.model.ros_packages import MANIFEST, is_near, packages_in
from calib.model.urdf import Urdf

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


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


class MeshFolders(tuple[Path, ...]):
    """The folders in which meshes are looked for, and those out of which they may be.

    Attributes:
        given: A mesh outside of these and of a package is not read.
        above: The folders above the URDF, the nearest first.
    """

    given: GivenFolders
    above: tuple[Path, ...] = ()


def mesh_folders(urdf: Urdf, package_dirs: Iterable[str | Path] = ()) -> MeshFolders:
    """The folders in which ``package://`` and relative mesh names are looked for, each once.

    Those that the user named, the URDF's own folder and those above it, ``ROS_PACKAGE_PATH``, ``AMENT_PREFIX_PATH``,
    the share folder of example-robot-data and the one of this Python.
    """
    named = [Path(folder) for folder in package_dirs]
    above: tuple[Path, ...] = ()
    own: tuple[Path, ...] = ()
    if urdf.path is not None:
        above = tuple(Path(os.path.realpath(urdf.path)).parents)
        own = (own_folder(urdf.path),)
    others = []
    for name, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        listed = os.environ.get(name, "").split(os.pathsep)
        others += [Path(folder) / below for folder in listed if folder]
    others += [*_robot_data_shares(), Path(sys.prefix) / "share"]
    folders = MeshFolders(dict.fromkeys([*named, *above, *others]))
    folders.given, folders.above = GivenFolders(own, (*named, *others)), above
    return folders


def find_mesh(name: str, folders: Sequence[Path]) -> Path | None:
    """The file that ``package://package/rest``, ``file:///path`` or a plain path means; None if there is none.

    A file outside of the given folders is none: a package is left neither by ``..`` nor over a symbolic link, and a
    plain path, whole or relative, leads into the URDF's own folder, see `own_folder`, or into one that the user named.

    Args:
        name: As the URDF has it.
        folders: See `mesh_folders`; of other folders all count as named by the user.
    """
    given = folders.given if isinstance(folders, MeshFolders) else GivenFolders((), tuple(folders))
    above = folders.above if isinstance(folders, MeshFolders) else ()
    found = (p for p, root in _candidates(name, folders) if _holds(given, above, p, root))
    return next(filter(_is_file, found), None)


def why_no_mesh(name: str, folders: Sequence[Path]) -> str:
    """What is wrong with a mesh that `find_mesh` does not find; goes on after its name."""
    if any(_is_file(path) for path, _ in _candidates(name, folders)):
        return "lies outside the URDF's own folder and its ROS packages, and is not read"
    return "was not found"


def _candidates(name: str, folders: Sequence[Path]) -> Iterator[tuple[Path, Path | None]]:
    """The files that a name may mean, the likeliest first, each with its package's folder if it has one."""
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    if scheme in ("package", "model"):
        rest = rest.lstrip("/")  # a package without a name: what follows lies in one of the folders
        package, _, inside = rest.partition("/")
        if package.strip(".") and (at := [f for f in folders if f.parent != f]):
            yield from ((folder / rest, folder / package) for folder in at)
            yield from ((folder / inside, folder) for folder in at if folder.name == package)
            # Of a folder with another name only its package.xml tells.
            for folder in at:
                yield from ((f / inside, f) for f in packages_in(folder, package))
        else:
            yield from ((folder / rest, None) for folder in folders)
    elif scheme in ("", "file"):
        plain = Path(urllib.parse.unquote(rest) if scheme else rest)
        yield from ((folder / plain, None) for folder in folders if rest)


def _holds(given: GivenFolders, above: Sequence[Path], path: Path, package: Path | None) -> bool:
    """Whether a file may be read: in a given folder, or in the package that its name begins with."""
    if given.hold(path):
        return True
    if package is None or not ((package / MANIFEST).is_file() or is_near(package, above)):
        return False
    return GivenFolders((package,)).hold(path)


def read_mesh(path: Path, scale: Sequence[float]) -> tuple[tuple[Array, Faces] | None, str]:
    """The triangles of a mesh file, and ``""``; or None and what is wrong with the file.

    Args:
        path: The file.
        scale: Factors along x, y, z.

    Returns:
        Vertices, shape (V, 3), [m], and faces, shape (F, 3), indices of vertices.
    """
    try:
        with np.errstate(all="ignore"):  # numbers without end are looked for below
            vertices, faces = read_triangles(path)
            vertices = vertices * np.asarray(scale, dtype=np.float64)
            spread = np.ptp(vertices, axis=0) if len(faces) else np.zeros(3)
    except MeshFault as error:
        return None, str(error)
    if not np.isfinite(spread).all() or not spread.any():
        return None, "is empty"
    return (vertices, faces), ""


def load_mesh(path: Path, scale: Sequence[float]) -> tuple[Any, str]:
    """A mesh file as a bounding volume hierarchy of coal, and ``""``; or None and what is wrong with the file.

    Args:
        path: The file.
        scale: Factors along x, y, z.
    """
    found, problem = read_mesh(path, scale)
    if found is None:
        return None, problem
    vertices, faces = found
    mesh = hppfcl.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(vertices)
    mesh.addTriangles(faces)
    mesh.endModel()
    return mesh, ""


def mesh_vertices(mesh: Any) -> Array:  # noqa: ANN401  coal has no types
    """The vertices of a mesh that `load_mesh` gave, shape (V, 3), [m]."""
    return np.array(mesh.vertices(), dtype=np.float64).reshape(-1, 3)


def mesh_faces(mesh: Any) -> Faces:  # noqa: ANN401  coal has no types
    """The faces of a mesh that `load_mesh` gave, shape (F, 3), indices of vertices."""
    corners = [mesh.tri_indices(i) for i in range(mesh.num_tris)]
    return np.array([(c[0], c[1], c[2]) for c in corners], dtype=np.int64).reshape(-1, 3)


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
