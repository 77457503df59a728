"""What the links of a URDF look like: its ``<visual>`` elements, with meshes found, read, shaded and kept small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from calib.model.meshes import LinkShape, find_mesh, link_shapes, mesh_folders, read_mesh
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

#: What reaches farther than this from its link is a mistake of the file: beside it the robot could not be seen [m].
_FARTHEST = 1e6

#: All the meshes of a robot together are drawn with about this many triangles at most.
MOST_TRIANGLES = 250_000

#: Faces that meet at less than this angle look like one smooth surface [rad].
CREASE = np.deg2rad(35.0)

#: A mesh in which so many pairs of corners share a vertex is drawn with flat faces: it has fans of thousands.
_MOST_PAIRS = 5_000_000


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


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """A triangle mesh as a graphics card takes it.

    Attributes:
        vertices: shape (V, 3), float32, [m].
        normals: shape (V, 3), int8, outward unit normals times 127.
        faces: shape (F, 3), uint16 or uint32, indices of vertices.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.int8]
    faces: NDArray[np.uint16] | NDArray[np.uint32]


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
    asked = {one.mesh: _read(*_file(one.mesh, folders)) for one in shapes if one.mesh}
    total = sum(len(mesh[1]) for mesh, _ in asked.values() if mesh is not None)
    most = MOST_TRIANGLES if total <= MOST_TRIANGLES else MOST_TRIANGLES // len(asked)
    visuals, warnings = [], []
    for one in shapes:
        shape, problem = _shape(one, folders, most)
        if shape is not None and np.max(np.abs(one.T_link_shape[:3, 3])) > _FARTHEST:
            shape, problem = None, f"a visual of link '{one.link}' is too far away and left out"
        warnings += [problem] * bool(problem)
        visuals.append(Visual(one.link, one.T_link_shape, shape))
    return tuple(visuals), tuple(dict.fromkeys(warnings))


def same_visuals(one: Urdf, other: Urdf) -> bool:
    """Whether two URDFs show the same links with the same shapes; their joints may differ."""

    def shown(urdf: Urdf) -> list[tuple[str, bytes, str, object]]:
        return [
            (s.link, s.T_link_shape.tobytes(), s.geometry.tag, tuple(s.geometry.attrib.items()))
            for s in link_shapes(urdf, "visual")
        ]

    return mesh_folders(one) == mesh_folders(other) and shown(one) == shown(other)


def shaded(vertices: Array, faces: NDArray[np.int64]) -> Triangles | None:
    """A mesh with normals that are smooth except across creases; None if no face has an area.

    The normal at a corner is the mean, weighted by the angle there, of the faces at its vertex that are
    turned by less than `CREASE` against its own face. A vertex on a crease is doubled.

    Args:
        vertices: shape (V, 3), [m]; equal ones are welded.
        faces: shape (F, 3).
    """
    mesh = trimesh.Trimesh(vertices.astype(np.float32), faces)
    mesh.update_faces(mesh.area_faces > 0.0)
    if not len(mesh.faces):
        return None
    at = mesh.faces.ravel()
    unit = np.repeat(mesh.face_normals, 3, axis=0)
    weighted = mesh.face_angles.reshape(-1, 1) * unit
    sums = weighted
    if np.sum(np.bincount(at) ** 2) <= _MOST_PAIRS:  # else the faces stay flat
        # Every corner against every corner of the same vertex.
        of_vertex = coo_matrix((np.ones(len(at)), (np.arange(len(at)), at))).tocsr()
        one, other = (of_vertex @ of_vertex.T).nonzero()
        alike = np.einsum("ij,ij->i", unit[one], unit[other]) > np.cos(CREASE)
        one, other = one[alike], other[alike]
        sums = np.stack([np.bincount(one, weighted[other, k]) for k in range(3)], axis=1)
    normals = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
    # Halves such as 127 cos(60 deg) go up whatever the rounding before, so that equal normals stay equal.
    packed = np.floor(127.0 * normals + 0.50001).astype(np.int8)
    _, first, corner = np.unique(
        np.column_stack([at, packed]), axis=0, return_index=True, return_inverse=True
    )
    return Triangles(
        vertices=mesh.vertices[at[first]].astype(np.float32),
        normals=packed[first],
        faces=corner.reshape(-1, 3).astype(np.uint16 if len(first) <= 1 << 16 else np.uint32),
    )


def clustered(
    vertices: Array, faces: NDArray[np.int64], most_faces: int
) -> tuple[Array, NDArray[np.int64], float]:
    """A mesh with at most so many faces: the vertices in each cell of a grid become their mean.

    Args:
        vertices: shape (V, 3), [m].
        faces: shape (F, 3).
        most_faces: The cell grows until no more faces are left than this.

    Returns:
        The vertices, the faces and the edge of a cell, [m]: no vertex moved farther than its diagonal; 0 if
        the mesh was small enough.
    """
    merged, means, cell = faces, vertices, 0.0
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    while len(merged) > most_faces and cell < diagonal:
        cell = 1.4 * cell or diagonal / 1000.0
        grid = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
        _, inverse = np.unique(grid @ [1 << 40, 1 << 20, 1], return_inverse=True)
        count = np.bincount(inverse)
        means = np.stack([np.bincount(inverse, vertices[:, k]) / count for k in range(3)], axis=1)
        a, b, c = inverse[faces].T
        merged = np.unique(inverse[faces][(a != b) & (b != c) & (c != a)], axis=0)
    return means, merged, cell


def _shape(visual: LinkShape, folders: Sequence[Path], most_faces: int) -> tuple[Shape | None, str]:
    """The shape of a visual, and what is wrong with it; a capsule is drawn as a cylinder."""
    if visual.mesh is None:
        sizes, tag = visual.sizes, visual.geometry.tag
        if sizes is None:
            return None, f"a visual of link '{visual.link}' has no geometry that can be drawn"
        if max(sizes) > _FARTHEST:
            return None, f"a visual of link '{visual.link}' is too large and left out"
        if tag == "box":
            return Box((sizes[0], sizes[1], sizes[2])), ""
        return Sphere(sizes[0]) if tag == "sphere" else Cylinder(sizes[0], sizes[1]), ""
    triangles, problem, cell = _drawn(*_file(visual.mesh, folders), most_faces)
    name, stands = visual.mesh[0], "a simple shape stands for it"
    if triangles is None:
        return None, f"link '{visual.link}': the mesh '{name}' {problem}; {stands}"
    return triangles, f"mesh '{name}' is drawn simplified to {1e3 * cell:.2g} mm" if cell else ""


def _file(
    mesh: tuple[str, tuple[float, float, float]], folders: Sequence[Path]
) -> tuple[Path | None, tuple[float, float, float], int]:
    """The file that a name means, its scale, and when it was changed: then it is read again."""
    path = find_mesh(mesh[0], folders)
    exists = path is not None and path.exists()
    return path, mesh[1], path.stat().st_mtime_ns if exists and path is not None else 0


@lru_cache(maxsize=64)
def _read(
    path: Path | None,
    scale: tuple[float, ...],
    modified: int,  # noqa: ARG001
) -> tuple[tuple[Array, NDArray[np.int64]] | None, str]:
    """A mesh's vertices and faces, or None and why it cannot be drawn."""
    if path is None:
        return None, "was not found"
    mesh, problem = read_mesh(path, scale)
    if mesh is not None and (reach := np.abs(mesh[0]).max()) > _FARTHEST:
        return None, f"reaches {reach:.0e} m far"
    return mesh, problem


@lru_cache(maxsize=64)
def _drawn(
    path: Path | None, scale: tuple[float, ...], modified: int, most_faces: int
) -> tuple[Triangles | None, str, float]:
    """A mesh as it is drawn, or what is wrong with it; and the cell that simplified it, or 0 [m]."""
    mesh, problem = _read(path, scale, modified)
    if mesh is None:
        return None, problem, 0.0
    vertices, faces, cell = clustered(*mesh, most_faces)
    triangles = shaded(vertices, faces)
    return triangles, "" if triangles else "is empty", cell
