"""What the links of a URDF look like: its ``<visual>`` elements, with meshes found and read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.model.meshes import (
    LinkShape,
    find_mesh,
    link_shapes,
    mesh_folders,
    read_mesh,
)
from calib.model.urdf import Urdf
from calib.show.triangles import Triangles, clustered, shaded

Array = NDArray[np.float64]

#: What reaches farther than this from its link is a mistake of the file: beside it the robot could not be seen [m].
_FARTHEST = 1e6

#: All the meshes of a robot together are drawn with about this many triangles at most.
MOST_TRIANGLES = 250_000


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
        simplified. Each file is read once, also for the robots after this one, as long as it stays as it is.
    """
    shapes = list(link_shapes(urdf, "visual"))
    folders = mesh_folders(urdf)
    asked: dict[tuple[str, tuple[float, ...]], str] = {}
    for one in shapes:
        if one.mesh is not None:
            asked.setdefault(one.mesh, one.link)
    files = tuple(_MeshFile.of(name, folders, scale) for name, scale in asked)
    drawn = dict(zip(asked, _drawn(files), strict=True))
    warnings = [
        f"link '{link}': the mesh '{mesh[0]}' {drawn[mesh].problem}; a simple shape stands for it"
        for mesh, link in asked.items()
        if drawn[mesh].problem
    ]
    warnings += [
        f"mesh '{name}' is drawn simplified to {1e3 * mesh.cell:.2g} mm"
        for (name, _), mesh in drawn.items()
        if mesh.cell
    ]
    visuals = []
    for one in shapes:
        mesh = one.mesh
        shape = drawn[mesh].triangles if mesh is not None else _primitive(one)
        if shape is None and mesh is None:
            warnings.append(f"a visual of link '{one.link}' has no geometry that can be drawn")
        elif shape is not None and (reach := _reach(one.T_link_shape, shape)) > _FARTHEST:
            shape = None
            warnings.append(
                f"a visual of link '{one.link}' that reaches {reach:.0e} m far is left out"
            )
        visuals.append(Visual(one.link, one.T_link_shape, shape))
    return tuple(visuals), tuple(warnings)


def same_visuals(one: Urdf, other: Urdf) -> bool:
    """Whether two URDFs show the same links with the same shapes; their joints may differ."""

    def listed(urdf: Urdf) -> list[tuple[str, list[float], str, list[tuple[str, str]]]]:
        return [
            (v.link, v.T_link_shape.ravel().tolist(), v.geometry.tag, sorted(v.geometry.items()))
            for v in link_shapes(urdf, "visual")
        ]

    return mesh_folders(one) == mesh_folders(other) and listed(one) == listed(other)


def _primitive(visual: LinkShape) -> Shape | None:
    """A box, cylinder (a capsule is drawn as one) or sphere; None if it is none or has no size."""
    sizes = visual.sizes
    if sizes is None:
        return None
    if visual.geometry.tag == "box":
        return Box((sizes[0], sizes[1], sizes[2]))
    return Sphere(sizes[0]) if visual.geometry.tag == "sphere" else Cylinder(sizes[0], sizes[1])


def _reach(T_link_shape: Array, shape: Shape) -> float:
    """How far from the link's origin a shape goes, at most; that of a mesh is known already [m]."""
    away = float(np.max(np.abs(T_link_shape[:3, 3])))
    if isinstance(shape, Triangles):
        return away
    if isinstance(shape, Box):
        return away + max(shape.size)
    return away + shape.radius + (shape.length if isinstance(shape, Cylinder) else 0.0)


@dataclass(frozen=True, slots=True)
class _MeshFile:
    """A file as it was found, and the factors along x, y, z; equal ones have the same triangles."""

    path: Path | None
    scale: tuple[float, ...]
    size: int
    modified: int
    missing: str = ""

    @classmethod
    def of(cls, name: str, folders: Sequence[Path], scale: tuple[float, ...]) -> _MeshFile:
        """The file that a name means; its path is None if there is none, and ``missing`` says why."""
        path = find_mesh(name, folders)
        if path is None:
            return cls(None, scale, 0, 0, "was not found")
        try:
            found = path.stat()
        except OSError:  # gone since it was found: `read_mesh` says so
            return cls(path, scale, 0, 0)
        return cls(path, scale, found.st_size, found.st_mtime_ns)


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """A mesh as it is drawn: its triangles, or what is wrong with it; the cell that simplified it, or 0 [m]."""

    triangles: Triangles | None
    problem: str = ""
    cell: float = 0.0


@lru_cache(maxsize=8)
def _drawn(files: tuple[_MeshFile, ...]) -> tuple[_Drawn, ...]:
    """The meshes of one robot, which share `MOST_TRIANGLES`.

    The last robots' are kept, a few megabytes each: reading them takes most of the time of making a view.
    """
    raw = [_read_mesh(file) for file in files]
    total = sum(len(mesh[1]) for mesh, _ in raw if mesh is not None)
    result = []
    for mesh, problem in raw:
        if mesh is None:
            result.append(_Drawn(None, problem))
            continue
        vertices, faces = mesh
        share = max(200, MOST_TRIANGLES * len(faces) // max(total, 1))
        vertices, faces, cell = clustered(vertices, faces, share)
        triangles = shaded(vertices, faces)
        drawn = _Drawn(triangles, cell=cell) if len(triangles.faces) else _Drawn(None, "is empty")
        result.append(drawn)
    return tuple(result)


def _read_mesh(file: _MeshFile) -> tuple[tuple[Array, NDArray[np.int64]] | None, str]:
    """A mesh's vertices and faces, or None and why it cannot be drawn."""
    if file.path is None:
        return None, file.missing
    mesh, problem = read_mesh(file.path, file.scale)
    if mesh is not None and (reach := np.abs(mesh[0]).max()) > _FARTHEST:
        return None, f"reaches {reach:.0e} m far"
    return mesh, problem
