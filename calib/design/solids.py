"""What is compared for collisions: shapes of links, of targets and their holders, of boxes, and the mounting plane.

A link has the coal geometries of its ``<collision>``, or else of its ``<visual>``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.errors import UrdfError
from calib.model.meshes import LinkShape, find_mesh, link_shapes, load_mesh, mesh_folders
from calib.model.urdf import Urdf

Array = NDArray[np.float64]

#: A mesh whose thickness is less than this part of its length is flat: it has no hull.
_FLAT = 1e-6


class Kind(Enum):
    """What a shape is part of; the convex hull of a link's mesh stands for it where a plane is concerned."""

    LINK = "link"
    HULL = "hull"
    TARGET = "target"
    BOX = "box"
    PLANE = "plane"


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """One shape.

    Attributes:
        owner: The name of its link, target or box.
        kind: What it is part of.
        link: The link that it is fixed to.
        T_link_shape: shape (4, 4), its pose there [m].
        geometry: The shape, of coal.
    """

    owner: str
    kind: Kind
    link: str
    T_link_shape: Array
    geometry: Any

    @property
    def corners(self) -> Array:
        """The corners of the box about it, homogeneous, in the shape's own frame, shape (4, 8), [m]."""
        self.geometry.computeLocalAABB()
        box = self.geometry.aabb_local
        ends = np.stack([np.ravel(box.min_), np.ravel(box.max_)])
        which = np.indices((2, 2, 2)).reshape(3, 8)
        return np.vstack([ends[which, np.arange(3)[:, None]], np.ones(8)])

    @property
    def is_mesh(self) -> bool:
        """Whether its surface is made of triangles."""
        return isinstance(self.geometry, hppfcl.BVHModelBase)

    def hull(self) -> Solid:
        """The convex hull of a mesh; of one that is flat the box about it."""
        points = self.geometry.vertices()
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        # Of a flat one coal makes no error but ends the program.
        if len(points) > 3 and spread[2] > _FLAT * spread[0]:
            self.geometry.buildConvexHull(True, "Qt")
            return replace(self, kind=Kind.HULL, geometry=self.geometry.convex)
        low, high = points.min(axis=0), points.max(axis=0)
        T = np.eye(4)
        T[:3, 3] = 0.5 * (low + high)
        box = hppfcl.Box(*np.maximum(high - low, 1e-6))
        return replace(self, kind=Kind.HULL, T_link_shape=self.T_link_shape @ T, geometry=box)


@dataclass(frozen=True, slots=True, eq=False)
class Solids:
    """The shapes of all links.

    Attributes:
        solids: In the URDF's order.
        from_visuals: Links without collision geometry, whose visual geometry stands for it.
        unchecked: Links that carry a mass but have no geometry that can be used, or not all of it.
    """

    solids: tuple[Solid, ...]
    from_visuals: tuple[str, ...]
    unchecked: tuple[str, ...]


def read_solids(urdf: Urdf, package_dirs: Iterable[str | Path] = ()) -> Solids:
    """The geometry of every link; each mesh file is read once.

    Args:
        urdf: The robot.
        package_dirs: Folders in which ``package://`` meshes are looked for before all others.

    Raises:
        UrdfError: A mesh cannot be found or read, or no link has geometry.
    """
    folders = mesh_folders(urdf, package_dirs)
    collision, visual = (_by_link(link_shapes(urdf, kind)) for kind in ("collision", "visual"))
    # Pinocchio keeps the inertias of joints, not of links.
    bodies = {
        link.get("name", "")
        for link in urdf.elements().findall("link")
        if any(mass.get("value", "0").strip("0. ") for mass in link.findall("inertial/mass"))
    }
    meshes: dict[tuple[str, tuple[float, ...]], Any] = {}
    solids, from_visuals, unchecked = [], [], []
    for link in urdf.links:
        own = collision.get(link) or visual.get(link, [])
        found = [_geometry(urdf, shape, folders, meshes) for shape in own]
        usable = [
            Solid(link, Kind.LINK, link, shape.T_link_shape, geometry)
            for shape, geometry in zip(own, found, strict=True)
            if geometry is not None
        ]
        if usable and link not in collision:
            from_visuals.append(link)
        if len(usable) < len(found) or (not found and link in bodies):
            unchecked.append(link)
        solids += usable
    if not solids:
        raise UrdfError(
            f"{urdf.source}: no link has a <collision> or <visual> with a geometry that can be used: collisions "
            "cannot be checked. Take a URDF with geometry, or plan without collisions (--no-collisions)."
        )
    return Solids(tuple(solids), tuple(from_visuals), tuple(unchecked))


def _by_link(shapes: Iterable[LinkShape]) -> dict[str, list[LinkShape]]:
    """Shapes by their link."""
    result: dict[str, list[LinkShape]] = {}
    for shape in shapes:
        result.setdefault(shape.link, []).append(shape)
    return result


def rods(start: Array, end: Array) -> tuple[Array, Array]:
    """Poses whose z axis runs from one end of each rod to the other, centred between them, and the half lengths.

    Args:
        start: shape (N, 3), [m].
        end: shape (N, 3), [m].

    Returns:
        Shapes (N, 4, 4) and (N,), [m]; a rod without length points along z.
    """
    along = end - start
    length = np.linalg.norm(along, axis=1)
    z = np.where(
        length[:, None] > 0.0, along / np.maximum(length, 1e-300)[:, None], [0.0, 0.0, 1.0]
    )
    # Any direction across will do: the coordinate axis that is least along the rod, made orthogonal.
    x = np.eye(3)[np.argmin(np.abs(z), axis=1)]
    x = x - np.einsum("ni,ni->n", x, z)[:, None] * z
    x /= np.linalg.norm(x, axis=1)[:, None]
    T = np.tile(np.eye(4), (len(z), 1, 1))
    T[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=2)
    T[:, :3, 3] = 0.5 * (start + end)
    return T, 0.5 * length


def _geometry(
    urdf: Urdf, shape: LinkShape, folders: tuple[Path, ...], meshes: dict[Any, Any]
) -> Any:  # noqa: ANN401  coal has no types
    """A shape as coal has it; None for a kind or a size that is none.

    Raises:
        UrdfError: A mesh cannot be found or read.
    """
    if shape.mesh is None:
        kinds = {
            "box": hppfcl.Box,
            "cylinder": hppfcl.Cylinder,
            "capsule": hppfcl.Capsule,
            "sphere": hppfcl.Sphere,
        }
        return None if shape.sizes is None else kinds[shape.geometry.tag](*shape.sizes)
    if shape.mesh not in meshes:
        name, scale = shape.mesh
        path = find_mesh(name, folders)
        if path is None:
            listed = ", ".join(str(folder) for folder in folders[:4])
            more = f" and {len(folders) - 4} more folders" if len(folders) > 4 else ""
            raise UrdfError(
                f"{urdf.source}: link '{shape.link}': the mesh '{name}' was not found in {listed}{more}. Name the "
                "folder that holds it, for package://NAME/... the one that NAME stands in, by --package-dir, or plan "
                "without collisions (--no-collisions)."
            )
        mesh, problem = load_mesh(path, scale)
        if mesh is None:
            raise UrdfError(
                f"{urdf.source}: link '{shape.link}': the mesh file '{path}' {problem}. Replace it, or plan without "
                "collisions (--no-collisions)."
            )
        meshes[shape.mesh] = mesh
    return meshes[shape.mesh]
