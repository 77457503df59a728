"""The shapes of a URDF's links: its ``<visual>`` and ``<collision>`` elements, and the files of their meshes."""

from __future__ import annotations

import math
import os
import sys
import urllib.parse
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.basics.arrays import Array
from calib.robot.urdf import Urdf, robot_data_urdfs
from calib.robot.xacro_file import listed_folders, packages_in

#: Indices of the three vertices of each triangle, shape (F, 3), from 0.
Faces = NDArray[np.int64]

KINDS = (".stl", ".obj", ".dae", ".ply", ".off", ".glb")
"""The mesh files that are read, by the ending of the name."""


#: The attributes of a geometry that state its sizes [m], by its tag.
_SIZE_KEYS = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
}


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """One ``<visual>`` or ``<collision>`` of one link, as the URDF states it."""

    #: The link's name.
    link: str
    #: Shape (4, 4), [m], pose of the shape in the link.
    T_link_shape: Array
    #: The element inside ``<geometry>``.
    geometry: Element

    @property
    def mesh(self) -> tuple[str, tuple[float, float, float]] | None:
        """The file name of a mesh and its scale along x, y, z, 1 if missing or unreadable; None if it is no mesh."""
        if self.geometry.tag != "mesh":
            return None
        scale = parse_vector(self.geometry.get("scale"), (1.0, 1.0, 1.0))
        return self.geometry.get("filename", ""), scale

    @property
    def sizes(self) -> tuple[float, ...] | None:
        """Edges of a box, radius and length of a cylinder or capsule, radius of a sphere [m].

        None for any other geometry, or if a size is missing or not positive.
        """
        keys = _SIZE_KEYS.get(self.geometry.tag, ())
        words = [self.geometry.get(key, "nan") for key in keys]
        try:
            sizes = tuple(float(word) for word in " ".join(words).split())
        except ValueError:
            return None
        count = 3 if self.geometry.tag == "box" else len(words)
        if not sizes or len(sizes) != count:
            return None
        if not all(0.0 < size < math.inf for size in sizes):
            return None
        return sizes


def link_shapes(urdf: Urdf, kind: Literal["visual", "collision"]) -> Iterator[LinkShape]:
    """Yield every shape of a kind of every link, in the file's order.

    Args:
        urdf: The robot.
        kind: ``"visual"`` or ``"collision"``.
    """
    zeros = (0.0, 0.0, 0.0)
    for link in urdf.elements().findall("link"):
        for element in link.findall(kind):
            T = np.eye(4)
            for origin in element.findall("origin"):
                T[:3, 3] = parse_vector(origin.get("xyz"), zeros)
                T[:3, :3] = pin.rpy.rpyToMatrix(*parse_vector(origin.get("rpy"), zeros))
            for geometry in element.findall("geometry/*")[:1]:
                yield LinkShape(link.get("name", ""), T, geometry)


def mesh_folders(urdf: Urdf, package_dirs: Iterable[str | Path] = ()) -> tuple[Path, ...]:
    """Return the folders in which ``package://`` and relative mesh names are looked up, each once.

    They are those that the user gives, the URDF's own folder and those above it, ``ROS_PACKAGE_PATH``,
    ``AMENT_PREFIX_PATH``, the share folder of example-robot-data and that of this Python.

    Args:
        urdf: The robot.
        package_dirs: Folders that the user gives; they come first.
    """
    folders = [Path(folder) for folder in package_dirs]
    if urdf.path is not None:
        folders += urdf.path.resolve().parents
    folders += listed_folders("ROS_PACKAGE_PATH")
    folders += [prefix / "share" for prefix in listed_folders("AMENT_PREFIX_PATH")]
    above_robots = (folder for path in robot_data_urdfs().values() for folder in path.parents)
    folders += [folder for folder in above_robots if folder.name == "share"][:1]
    folders.append(Path(sys.prefix) / "share")
    return tuple(dict.fromkeys(folders))


def find_mesh(name: str, folders: Sequence[Path]) -> Path | None:
    """Return the file of a mesh; None if there is none.

    Args:
        name: ``package://package/path``, ``file:///path`` or a plain path.
        folders: The folders to look in, see `mesh_folders`.
    """
    for path in _candidates(name, folders):
        # os.path returns False for a name that the system cannot have.
        if os.path.isfile(path):  # noqa: PTH113
            return path
    return None


def _candidates(name: str, folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the paths that the name of a mesh may stand for, the likeliest first; they need not exist."""
    scheme, separator, path = name.partition("://")
    if not separator or scheme == "file":
        plain = urllib.parse.unquote(path) if separator else name
        yield from (folder / plain for folder in folders)
    elif scheme in ("package", "model"):
        package, _, inside = path.lstrip("/").partition("/")
        yield from (folder / package / inside for folder in folders)
        yield from (folder / inside for folder in folders if folder.name == package)
        # The name of a package's folder may differ from that in its package.xml.
        for folder in folders:
            yield from (package_folder / inside for package_folder in packages_in(folder, package))


def read_mesh(path: Path, scale: Sequence[float]) -> tuple[tuple[Array, Faces] | None, str]:
    """Read the triangles of a mesh file.

    A COLLADA file has the unit of its ``<unit>``; its ``<up_axis>`` is ignored, as ROS and its simulators ignore it.

    Args:
        path: The file, whose ending says which of `KINDS` it is.
        scale: Factors along x, y, z.

    Returns:
        Vertices, shape (V, 3), [m], and faces, shape (F, 3); and ``""``. Or None, and the fault as text for a message
        after the file's name.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        return None, f"is of a kind that is not read; save it as one of {', '.join(KINDS)}"
    try:
        vertices, faces = _binary_stl(path) or _by_trimesh(path)
    except Exception:  # noqa: BLE001  the readers of many formats may raise anything
        return None, "cannot be read"
    if not len(vertices) or not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).any():
        return None, "is empty"
    return (vertices * np.asarray(scale, dtype=np.float64), faces), ""


def _binary_stl(path: Path) -> tuple[Array, Faces] | None:
    """Return vertices (3 F, 3) and faces (F, 3) of a binary STL file; None for another file.

    After 80 bytes of any text and the number of triangles, each has its normal, its three corners and 2 more bytes.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if path.suffix.lower() != ".stl" or len(data) != 84 + 50 * count:
        return None
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("other", "<u2")])
    corners = np.frombuffer(data, triangle, offset=84)["corners"]
    return corners.reshape(-1, 3).astype(np.float64), np.arange(3 * count).reshape(-1, 3)


def _by_trimesh(path: Path) -> tuple[Array, Faces]:
    """Return vertices (V, 3) [m] and faces (F, 3) of a mesh file, or raise anything."""
    import trimesh  # takes longer than all meshes of an arm in binary STL

    kind = path.suffix.lower()
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene: Any = trimesh.load_scene(file, file_type=kind[1:], process=False)
        mesh = scene.to_mesh()
        unit = 1.0
        if kind == ".dae":
            unit = trimesh.units.unit_conversion(scene.units, "meters")
        used, faces = np.unique(mesh.faces, return_inverse=True)
    return unit * mesh.vertices[used], faces.reshape(-1, 3).astype(np.int64)


def load_mesh(path: Path, scale: Sequence[float]) -> tuple[Any, str]:
    """Read a mesh file as a bounding volume hierarchy of coal.

    Args:
        path: The file.
        scale: Factors along x, y, z.

    Returns:
        The hierarchy, and ``""``; or None and the fault, see `read_mesh`.
    """
    triangles, fault = read_mesh(path, scale)
    if triangles is None:
        return None, fault
    vertices, faces = triangles
    mesh = hppfcl.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(vertices)
    mesh.addTriangles(faces)
    mesh.endModel()
    return mesh, ""


def parse_vector(
    text: str | None, default: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the three finite numbers in the value of an attribute such as ``xyz``.

    Args:
        text: The value of an attribute; None if it is missing.
        default: The result if the text is anything but three finite numbers.
    """
    try:
        x, y, z = (float(word) for word in (text or "").split())
    except ValueError:
        return default
    if not all(math.isfinite(number) for number in (x, y, z)):
        return default
    return x, y, z
