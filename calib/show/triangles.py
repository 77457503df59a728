"""Triangle meshes for a browser: welded, with creases, small."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Faces that meet at less than this angle look like one smooth surface [rad].
CREASE = np.deg2rad(35.0)

#: Corners of one vertex are compared with each other only up to this many faces, and so many pairs of corners in all.
_MOST_FACES, _MOST_PAIRS = 256, 3_000_000


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

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.vertices, self.normals, self.faces):
            array.setflags(write=False)


def shaded(vertices: Array, faces: NDArray[np.int64]) -> Triangles:
    """A mesh with normals that are smooth except across creases.

    The normal at a corner is the mean, weighted by the angle there, of the faces at its vertex that are
    turned by less than `CREASE` against its own face. A vertex on a crease is doubled.

    Args:
        vertices: shape (V, 3), [m]; equal ones are welded.
        faces: shape (F, 3); those without area are left out, so that none may be left.
    """
    vertices, faces = _welded(vertices, faces)
    sides = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
    across = np.cross(sides[:, 0], sides[:, 1])
    length = np.linalg.norm(across, axis=1)
    flat = length == 0
    faces, across, length = faces[~flat], across[~flat], length[~flat]
    if not len(faces):
        return Triangles(
            np.empty((0, 3), np.float32), np.empty((0, 3), np.int8), np.empty((0, 3), np.uint16)
        )
    normals = _corner_normals(faces, across / length[:, None], _angles(vertices[faces]))
    # Halves such as 127 cos(60 deg) go up whatever the rounding before, so that equal normals stay equal.
    packed = np.floor(127.0 * normals + 0.50001).astype(np.int8)

    # A vertex for each different normal at it: four bytes of position, three of normal in one key.
    key = (faces.ravel().astype(np.int64) << 24) | (
        packed.astype(np.int64).reshape(-1, 3) + 128
    ) @ np.array([1 << 16, 1 << 8, 1])
    _, first, corner = np.unique(key, return_index=True, return_inverse=True)
    small = len(first) <= 1 << 16
    return Triangles(
        vertices=vertices[faces.ravel()[first]].astype(np.float32),
        normals=packed.reshape(-1, 3)[first],
        faces=corner.reshape(-1, 3).astype(np.uint16 if small else np.uint32),
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
    if len(faces) <= most_faces:
        return vertices, faces, 0.0
    low = vertices.min(axis=0)
    diagonal = float(np.linalg.norm(vertices.max(axis=0) - low))
    cell = diagonal / 1000.0
    while True:
        # At most 1001 cells along an edge, so that three numbers fit into one: sorting those is ten times as fast.
        x, y, z = np.floor((vertices - low) / cell).astype(np.int64).T
        _, inverse = np.unique((x << 40) | (y << 20) | z, return_inverse=True)
        merged = _each_once(_without_slivers(inverse[faces]))
        if len(merged) <= most_faces or cell >= diagonal:
            break
        cell *= 1.4
    count = np.bincount(inverse)
    means = np.stack([np.bincount(inverse, vertices[:, k]) / count for k in range(3)], axis=1)
    return means, merged, cell


def _each_once(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The different faces, in order."""
    count = int(faces.max(initial=0)) + 1
    if count**3 > np.iinfo(np.int64).max:
        return np.unique(faces, axis=0)
    key = np.unique((faces[:, 0] * count + faces[:, 1]) * count + faces[:, 2])
    return np.stack([key // count**2, key // count % count, key % count], axis=1)


def _welded(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Vertices that are equal in single precision become one; faces that collapse are left out."""
    _, first, inverse = np.unique(
        vertices.astype(np.float32), axis=0, return_index=True, return_inverse=True
    )
    return vertices[first], _without_slivers(inverse.reshape(-1)[faces])


def _without_slivers(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The faces with three different vertices."""
    a, b, c = faces.T
    kept: NDArray[np.int64] = faces[(a != b) & (b != c) & (c != a)]
    return kept


def _corner_normals(faces: NDArray[np.int64], unit: Array, angles: Array) -> Array:
    """The normal at each corner, shape (F, 3, 3), unit vectors."""
    of_corner = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(faces.ravel(), kind="stable")
    face = of_corner[order]
    degree = np.bincount(faces.ravel())
    degree = degree[degree > 0]
    start = np.concatenate([[0], np.cumsum(degree)[:-1]]).astype(np.int64)
    # Every corner against every corner of the same vertex; those of a huge fan against the first few only.
    most = _MOST_FACES
    while most > 1 and (np.minimum(degree, most) * degree).sum() > _MOST_PAIRS:
        most //= 2
    partners = np.repeat(np.minimum(degree, most), degree)
    one = np.repeat(np.arange(len(face)), partners)
    offset = np.arange(len(one)) - np.repeat(np.cumsum(partners) - partners, partners)
    other = np.repeat(np.repeat(start, degree), partners) + offset
    alike = np.einsum("ij,ij->i", unit[face[one]], unit[face[other]]) > np.cos(CREASE)
    one, other = one[alike], other[alike]
    weighted = angles.ravel()[order][:, None] * unit[face]
    sums: Array = np.stack(
        [np.bincount(one, weighted[other, k], minlength=len(face)) for k in range(3)], axis=1
    )
    sums += (
        1e-9 * weighted[face]
    )  # a corner beyond the first few of a fan has its own face at least
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    normals = np.empty_like(sums)
    # A corner so sharp that it has no angle: the face's own.
    normals[order] = np.where(lengths > 0.0, sums, unit[face]) / np.where(
        lengths > 0.0, lengths, 1.0
    )
    result: Array = normals.reshape(-1, 3, 3)
    return result


def _angles(corners: Array) -> Array:
    """The angle at each corner of each triangle, shape (F, 3), [rad]; corners has the shape (F, 3, 3)."""
    forward = np.roll(corners, -1, axis=1) - corners
    forward /= np.linalg.norm(forward, axis=2, keepdims=True)
    backward = -np.roll(forward, 1, axis=1)
    cosine = np.einsum("fij,fij->fi", forward, backward)
    result: Array = np.arccos(np.clip(cosine, -1.0, 1.0))
    return result
