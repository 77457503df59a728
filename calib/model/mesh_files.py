"""Mesh files as triangles: STL and Wavefront OBJ here, COLLADA in `mesh_dae`, others by trimesh.

Readers of our own, because those of libraries written in C end the whole program at some broken files, and follow the
names of other files. Nothing but the file itself is read; whatever is wrong with it is a `MeshFault`, and time and
memory are in proportion to its size.
"""

from __future__ import annotations

import io
import os
import re
import stat
import warnings
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.model.mesh_dae import Array, Faces, MeshFault, dae_triangles

__all__ = ["KINDS", "MeshFault", "read_triangles"]

#: Largest mesh file that is read [bytes]; most triangles; longest text of one.
LIMIT_BYTES, MOST_TRIANGLES, LIMIT_TEXT = 200_000_000, 1_500_000, 100_000_000

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD = 84
_VERTEX = re.compile(rb"\bvertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)")
_CONTINUED = re.compile(rb"\\[ \t]*\r?\n")


def read_triangles(path: Path) -> tuple[Array, Faces]:
    """The triangles of a mesh file.

    Args:
        path: The file; its ending says of which kind it is.

    Returns:
        Vertices, shape (V, 3), in the file's unit, or in metres of a COLLADA file; faces, shape (F, 3).

    Raises:
        MeshFault: The file cannot be read; the text goes on after its name.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        message = f"is of a kind that is not read; save it as one of {', '.join(KINDS)}"
        raise MeshFault(message)
    data = _content(path)
    try:
        vertices, faces = KINDS[kind](data)
    except (ValueError, OverflowError, IndexError, KeyError, TypeError, RecursionError) as error:
        message = "cannot be read"
        raise MeshFault(message) from error
    if len(faces) > MOST_TRIANGLES:
        message = f"has {len(faces):,} triangles, more than {MOST_TRIANGLES:,}"
        raise MeshFault(message)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        message = "has faces of vertices that it does not have"
        raise MeshFault(message)
    used, corners = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    return vertices, corners.reshape(-1, 3).astype(np.int64)


def _content(path: Path) -> bytes:
    """The bytes of a file that is one, and no device."""
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode) or not os.access(path, os.R_OK):
            message = "cannot be read"
            raise MeshFault(message)
        if found.st_size > LIMIT_BYTES:
            message = f"is larger than {LIMIT_BYTES:,} bytes"
            raise MeshFault(message)
        with path.open("rb") as file:
            return file.read(LIMIT_BYTES)
    except (OSError, ValueError) as error:
        message = "cannot be read"
        raise MeshFault(message) from error


def _stl(data: bytes) -> tuple[Array, Faces]:
    """STL, binary or text; a binary one may begin with the word of a text."""
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    size = _HEAD + count * _STL.itemsize
    text = data[:512].lstrip().startswith(b"solid") and b"facet" in data[:2000]
    if len(data) < _HEAD or (len(data) != size and (text or len(data) < size)):
        corners = _stl_text(data)
    else:
        corners = np.frombuffer(data, _STL, count, _HEAD)["corners"].reshape(-1, 3)
    vertices = corners.astype(np.float64)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _stl_text(data: bytes) -> Array:
    """The corners of a text."""
    if b"facet" not in data or len(data) > LIMIT_TEXT:
        message = "cannot be read"
        raise MeshFault(message)
    numbers = (float(word) for found in _VERTEX.finditer(data) for word in found.groups())
    return np.fromiter(numbers, np.float64).reshape(-1, 3)


def _obj(data: bytes) -> tuple[Array, Faces]:
    """Wavefront OBJ: vertices and polygons; materials, and the files that they are in, are left alone."""
    if len(data) > LIMIT_TEXT:
        message = "cannot be read"
        raise MeshFault(message)
    vertices: list[tuple[float, float, float]] = []
    faces: list[tuple[int, int, int]] = []
    for line in _CONTINUED.sub(b" ", data).splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            x, y, z = map(float, words[1:4])
            vertices.append((x, y, z))
        elif words[0] == b"f":
            corners = [int(word.partition(b"/")[0]) for word in words[1:]]
            # From 1 on; a negative number counts back from the last vertex so far.
            indices = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            faces += [(indices[0], b, c) for b, c in pairwise(indices[1:])]
    triangles = np.array(faces, dtype=np.int64).reshape(-1, 3)
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), triangles


def _by_trimesh(kind: str) -> Callable[[bytes], tuple[Array, Faces]]:
    """A kind that trimesh reads, out of memory, so that no file beside it is found."""

    def read(data: bytes) -> tuple[Array, Faces]:
        import trimesh  # takes half a second, and few meshes need it

        if len(data) > LIMIT_TEXT:
            message = "cannot be read"
            raise MeshFault(message)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found: Any = trimesh.load(
                    io.BytesIO(data), file_type=kind, force="mesh", process=False
                )
            vertices: Array = np.asarray(found.vertices, dtype=np.float64).reshape(-1, 3)
            faces: NDArray[np.int64] = np.asarray(found.faces, dtype=np.int64).reshape(-1, 3)
        except Exception as error:
            # What the readers of many formats raise is not known.
            message = "cannot be read"
            raise MeshFault(message) from error
        return vertices, faces

    return read


KINDS: Mapping[str, Callable[[bytes], tuple[Array, Faces]]] = {
    ".stl": _stl,
    ".obj": _obj,
    ".dae": dae_triangles,
    **{f".{kind}": _by_trimesh(kind) for kind in ("ply", "off", "glb")},
}
"""What is read, by the ending of the file's name."""
