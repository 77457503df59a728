"""What the links of a URDF look like: its ``<visual>`` elements, with meshes found and read."""

from __future__ import annotations

import importlib.metadata
import math
import os
import sys
import urllib.parse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.model.urdf import Urdf
from calib.show.triangles import Triangles, clustered, shaded

Array = NDArray[np.float64]

#: All the meshes of a robot together are drawn with about this many triangles at most.
MOST_TRIANGLES = 250_000

#: Largest mesh file that is read [bytes].
LIMIT_BYTES = 200_000_000


@dataclass(frozen=True, slots=True)
class Box:
    """A box about the origin; edges along x, y, z [m]."""

    size: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder about the z axis, centred at the origin [m]."""

    radius: float
    length: float


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere about the origin [m]."""

    radius: float


Shape = Box | Cylinder | Sphere | Triangles


@dataclass(frozen=True, slots=True, eq=False)
class Visual:
    """One shape of one link.

    Attributes:
        link: The link's name.
        T_link_shape: shape (4, 4), [m], pose of the shape in the link.
        shape: None where it is missing: its mesh cannot be found or read.
    """

    link: str
    T_link_shape: Array
    shape: Shape | None


def read_visuals(urdf: Urdf) -> tuple[tuple[Visual, ...], tuple[str, ...]]:
    """Every visual of every link, and what could not be drawn as the URDF says.

    Returns:
        The visuals, in the file's order, and one sentence for each mesh that is missing, unreadable or was
        simplified. Each file is read once.
    """
    meshes: dict[tuple[str, tuple[float, ...]], Triangles | None] = {}
    warnings: list[str] = []
    elements = list(_visual_elements(urdf))
    folders = mesh_folders(urdf)
    raw: dict[tuple[str, tuple[float, ...]], tuple[Array, NDArray[np.int64]] | None] = {}
    for link, _, geometry in elements:
        mesh = _mesh(geometry)
        if mesh is not None and mesh not in raw:
            raw[mesh], problem = _read_mesh(*mesh, folders, link)
            warnings += [problem] if problem else []
    total = sum(len(mesh[1]) for mesh in raw.values() if mesh is not None)
    for key, mesh_read in raw.items():
        if mesh_read is None:
            meshes[key] = None
            continue
        vertices, faces = mesh_read
        share = max(200, MOST_TRIANGLES * len(faces) // max(total, 1))
        vertices, faces, cell = clustered(vertices, faces, share)
        if cell:
            warnings.append(f"mesh '{key[0]}' is drawn simplified to {1e3 * cell:.2g} mm")
        meshes[key] = shaded(vertices, faces)
    visuals = []
    for link, T_link_shape, geometry in elements:
        mesh = _mesh(geometry)
        shape = meshes[mesh] if mesh is not None else _primitive(geometry)
        if shape is None and mesh is None:
            warnings.append(f"a visual of link '{link}' has no geometry that can be drawn")
        visuals.append(Visual(link, T_link_shape, shape))
    return tuple(visuals), tuple(warnings)


def same_visuals(one: Urdf, other: Urdf) -> bool:
    """Whether two URDFs show the same links with the same shapes; their joints may differ."""

    def listed(urdf: Urdf) -> list[tuple[str, list[float], str, list[tuple[str, str]]]]:
        return [
            (link, T.ravel().tolist(), shape.tag, sorted(shape.items()))
            for link, T, shape in _visual_elements(urdf)
        ]

    return mesh_folders(one) == mesh_folders(other) and listed(one) == listed(other)


def mesh_folders(urdf: Urdf) -> tuple[Path, ...]:
    """The folders in which ``package://`` and relative mesh names are looked for, each once.

    The URDF's own folder and those above it, ``ROS_PACKAGE_PATH``, ``AMENT_PREFIX_PATH``, the share folder of
    example-robot-data and the one of this Python.
    """
    folders: list[Path] = []
    if urdf.path is not None:
        folders += Path(os.path.realpath(urdf.path)).parents
    for name, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        listed = os.environ.get(name, "").split(os.pathsep)
        folders += [Path(folder) / below for folder in listed if folder]
    folders += _robot_data_shares()
    folders.append(Path(sys.prefix) / "share")
    return tuple(dict.fromkeys(folders))


def _robot_data_shares() -> Iterator[Path]:
    """The ``share`` folder of the installed example-robot-data, from its list of files."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return
    for file in files:
        for i, pair in enumerate(zip(file.parts, file.parts[1:], strict=False)):
            if pair == ("share", "example-robot-data"):
                yield Path(str(file.locate())).parents[len(file.parts) - i - 2]
                return


def _visual_elements(urdf: Urdf) -> Iterator[tuple[str, Array, Element]]:
    """For each visual its link, its pose there and the element inside ``<geometry>``."""
    # Urdf has refused document types already, so that there are no entities to expand.
    for link in ElementTree.fromstring(urdf.data).findall("link"):
        for visual in link.findall("visual"):
            for shape in visual.findall("geometry/*")[:1]:
                yield link.get("name", ""), _origin(visual), shape


def _origin(visual: Element) -> Array:
    """The pose in ``<origin>``; what is not three numbers counts as absent."""
    T = np.eye(4)
    for origin in visual.findall("origin"):
        T[:3, 3] = _numbers(origin.get("xyz"), (0.0, 0.0, 0.0))
        rpy = _numbers(origin.get("rpy"), (0.0, 0.0, 0.0))
        T[:3, :3] = pin.rpy.rpyToMatrix(*rpy)
    return T


def _numbers(text: str | None, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Three finite numbers, or the default."""
    try:
        x, y, z = (float(word) for word in (text or "").split())
    except ValueError:
        return default
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else default


def _mesh(geometry: Element) -> tuple[str, tuple[float, ...]] | None:
    """A mesh's file name and scale; None for another geometry."""
    if geometry.tag != "mesh":
        return None
    scale = _numbers(geometry.get("scale"), (1.0, 1.0, 1.0))
    return geometry.get("filename", ""), scale


def _primitive(geometry: Element) -> Shape | None:
    """A box, cylinder (a capsule is drawn as one) or sphere; None if it is none or has no size."""

    def length(name: str) -> float:
        try:
            return float(geometry.get(name, ""))
        except ValueError:
            return math.nan

    shape: Shape | None = None
    sizes: Iterable[float] = ()
    if geometry.tag == "box":
        sizes = size = _numbers(geometry.get("size"), (0.0, 0.0, 0.0))
        shape = Box(size)
    elif geometry.tag in ("cylinder", "capsule"):
        sizes = (length("radius"), length("length"))
        shape = Cylinder(*sizes)
    elif geometry.tag == "sphere":
        sizes = (length("radius"),)
        shape = Sphere(*sizes)
    return shape if all(0.0 < size < math.inf for size in sizes) else None


def _read_mesh(
    name: str, scale: tuple[float, ...], folders: tuple[Path, ...], link: str
) -> tuple[tuple[Array, NDArray[np.int64]] | None, str]:
    """A mesh's vertices and faces, or None and why it cannot be drawn."""
    path = _find_mesh(name, folders)
    if path is None:
        return None, f"link '{link}': the mesh '{name}' was not found; a simple shape stands for it"
    try:
        if path.stat().st_size > LIMIT_BYTES:
            return None, f"link '{link}': the mesh '{name}' is larger than {LIMIT_BYTES:,} bytes"
        mesh = hppfcl.MeshLoader().load(str(path), np.asarray(scale, dtype=np.float64))
        vertices = np.asarray(mesh.vertices(), dtype=np.float64).reshape(-1, 3)
        corners = [mesh.tri_indices(i) for i in range(mesh.num_tris)]
    except (ValueError, RuntimeError, OSError, AttributeError):
        return (
            None,
            f"link '{link}': the mesh '{name}' cannot be read; a simple shape stands for it",
        )
    faces = np.array([(c[0], c[1], c[2]) for c in corners], dtype=np.int64).reshape(-1, 3)
    if not len(faces) or not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).any():
        return None, f"link '{link}': the mesh '{name}' is empty; a simple shape stands for it"
    return (vertices, faces), ""


def _find_mesh(name: str, folders: tuple[Path, ...]) -> Path | None:
    """The file that ``package://package/rest``, ``file:///path`` or a plain path means."""
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    candidates: list[Path] = []
    if scheme in ("package", "model"):
        inside = rest.partition("/")[2]
        candidates = [folder / rest for folder in folders]
        candidates += [folder / inside for folder in folders if folder.name == rest.split("/")[0]]
    elif scheme in ("", "file"):
        plain = Path(urllib.parse.unquote(rest) if scheme else rest)
        candidates = [folder / plain for folder in folders] if rest else []
    return next(filter(_is_file, candidates), None)


def _is_file(path: Path) -> bool:
    """Whether there is such a file; no for a name that the system cannot have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
