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

from calib.robot.urdf import Urdf, robot_data_urdfs
from calib.robot.xacro_file import listed_folders, packages_in
from calib.units import Array

Faces = NDArray[np.int64]

KINDS = (".stl", ".obj", ".dae", ".ply", ".off", ".glb")
"""The mesh files that are read, by the ending of the name."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """One ``<visual>`` or ``<collision>`` of one link, as the URDF states it."""

    link: str  #: The link's name.
    T_link_shape: Array  #: shape (4, 4), [m], pose of the shape in the link.
    geometry: Element  #: The element inside ``<geometry>``.

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
        radius = ("radius", "length")
        keys = {"box": ("size",), "cylinder": radius, "capsule": radius, "sphere": radius[:1]}
        words = [self.geometry.get(key, "nan") for key in keys.get(self.geometry.tag, ())]
        try:
            found = tuple(float(word) for word in " ".join(words).split())
        except ValueError:
            return None
        wanted = 3 if self.geometry.tag == "box" else len(words)
        valid = len(found) == wanted and all(0.0 < size < math.inf for size in found)
        return found if found and valid else None


def link_shapes(urdf: Urdf, kind: Literal["visual", "collision"]) -> Iterator[LinkShape]:
    """Every shape of that kind of every link, in the file's order; an origin that is not three numbers is absent."""
    for link in urdf.elements().findall("link"):
        for element in link.findall(kind):
            T, zeros = np.eye(4), (0.0, 0.0, 0.0)
            for origin in element.findall("origin"):
                T[:3, 3] = numbers(origin.get("xyz"), zeros)
                T[:3, :3] = pin.rpy.rpyToMatrix(*numbers(origin.get("rpy"), zeros))
            for geometry in element.findall("geometry/*")[:1]:
                yield LinkShape(link.get("name", ""), T, geometry)


def mesh_folders(urdf: Urdf, package_dirs: Iterable[str | Path] = ()) -> tuple[Path, ...]:
    """The folders in which ``package://`` and relative mesh names are looked for, each once.

    Those that the user named, the URDF's own folder and those above it, ``ROS_PACKAGE_PATH``, ``AMENT_PREFIX_PATH``,
    the share folder of example-robot-data and the one of this Python.
    """
    folders = [Path(folder) for folder in package_dirs]
    if urdf.path is not None:
        folders += urdf.path.resolve().parents
    folders += listed_folders("ROS_PACKAGE_PATH")
    folders += [prefix / "share" for prefix in listed_folders("AMENT_PREFIX_PATH")]
    shares = (folder for path in robot_data_urdfs().values() for folder in path.parents)
    folders += [folder for folder in shares if folder.name == "share"][:1]
    folders.append(Path(sys.prefix) / "share")
    return tuple(dict.fromkeys(folders))


def find_mesh(name: str, folders: Sequence[Path]) -> Path | None:
    """The file that ``package://package/rest``, ``file:///path`` or a plain path means in `mesh_folders`, or None."""
    # os.path: a name that the system cannot have is that of no file.
    return next((path for path in _candidates(name, folders) if os.path.isfile(path)), None)  # noqa: PTH113


def _candidates(name: str, folders: Sequence[Path]) -> Iterator[Path]:
    """The files that a name may mean, the likeliest first."""
    scheme, separator, rest = name.partition("://")
    if not separator or scheme == "file":
        plain = urllib.parse.unquote(rest) if separator else name
        yield from (folder / plain for folder in folders)
    elif scheme in ("package", "model"):
        package, _, inside = rest.lstrip("/").partition("/")
        yield from (folder / package / inside for folder in folders)
        yield from (folder / inside for folder in folders if folder.name == package)
        for folder in folders:  # of a folder with another name its package.xml tells
            yield from (found / inside for found in packages_in(folder, package))


def read_mesh(path: Path, scale: Sequence[float]) -> tuple[tuple[Array, Faces] | None, str]:
    """Vertices, shape (V, 3), [m], and faces, shape (F, 3), of a mesh file, and ``""``; or None and what is wrong.

    The file's ending says of which kind it is; ``scale`` are factors along x, y, z. A COLLADA file is as large as its
    ``<unit>`` says and stands as it is written: ``<up_axis>`` is not heeded, as ROS and its simulators do not.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        return None, f"is of a kind that is not read; save it as one of {', '.join(KINDS)}"
    import trimesh  # takes half a second

    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene: Any = trimesh.load_scene(file, file_type=kind[1:], process=False)
            mesh = scene.to_mesh()
            unit = trimesh.units.unit_conversion(scene.units, "meters") if kind == ".dae" else 1.0
            used, faces = np.unique(mesh.faces, return_inverse=True)
            vertices: Array = mesh.vertices[used] * (unit * np.asarray(scale, dtype=np.float64))
    except Exception:  # noqa: BLE001  what the readers of many formats raise is not known
        return None, "cannot be read"
    if not len(vertices) or not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).any():
        return None, "is empty"
    return (vertices, faces.reshape(-1, 3).astype(np.int64)), ""


def load_mesh(path: Path, scale: Sequence[float]) -> tuple[Any, str]:
    """A mesh file as a bounding volume hierarchy of coal, and ``""``; or None and what is wrong, see `read_mesh`."""
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


def numbers(text: str | None, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Three finite numbers, or the default."""
    try:
        x, y, z = (float(word) for word in (text or "").split())
    except ValueError:
        return default
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else default
