"""What a robot's links are made of, for collisions: coal geometries of their ``<collision>``, or else ``<visual>``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.errors import UrdfError
from calib.model.meshes import (
    LinkShape,
    find_mesh,
    link_shapes,
    load_mesh,
    mesh_folders,
)
from calib.model.urdf import Urdf

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """One shape of one link.

    Attributes:
        link: The link's name.
        T_link_shape: shape (4, 4), [m], pose of the shape in the link.
        geometry: The shape, of coal.
    """

    link: str
    T_link_shape: Array
    geometry: Any


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
    meshes: dict[tuple[str, tuple[float, ...]], Any] = {}
    solids, from_visuals, unchecked = [], [], []
    massive = _links_with_mass(urdf)
    for link in urdf.links:
        shapes = collision.get(link) or visual.get(link, [])
        found = [_solid(urdf, shape, folders, meshes) for shape in shapes]
        usable = [solid for solid in found if solid is not None]
        if usable and link not in collision:
            from_visuals.append(link)
        if len(usable) < len(found) or (not found and link in massive):
            unchecked.append(link)
        solids += usable
    if not solids:
        message = (
            f"{urdf.source}: no link has a <collision> or <visual> with a geometry that can be used: collisions "
            "cannot be checked. Take a URDF with geometry, or plan without collisions (--no-collisions)."
        )
        raise UrdfError(message)
    return Solids(tuple(solids), tuple(from_visuals), tuple(unchecked))


def _by_link(shapes: Iterable[LinkShape]) -> dict[str, list[LinkShape]]:
    """Shapes by their link."""
    result: dict[str, list[LinkShape]] = {}
    for shape in shapes:
        result.setdefault(shape.link, []).append(shape)
    return result


def _links_with_mass(urdf: Urdf) -> set[str]:
    """The links that are bodies, not mere frames: those with a mass."""
    # Pinocchio keeps the inertias of joints, not of links.
    return {
        link.get("name", "")
        for link in urdf.elements().findall("link")
        if any(_positive(mass.get("value", "")) for mass in link.findall("inertial/mass"))
    }


def _positive(text: str) -> bool:
    """Whether a text is a number above 0."""
    try:
        return float(text) > 0.0
    except ValueError:
        return False


def _solid(
    urdf: Urdf,
    shape: LinkShape,
    folders: tuple[Path, ...],
    meshes: dict[tuple[str, tuple[float, ...]], Any],
) -> Solid | None:
    """A shape as coal has it; None for a kind or a size that is none."""
    mesh = shape.mesh
    if mesh is None:
        geometry = _primitive(shape)
        return None if geometry is None else Solid(shape.link, shape.T_link_shape, geometry)
    if mesh not in meshes:
        meshes[mesh] = _mesh(urdf, shape.link, *mesh, folders)
    return Solid(shape.link, shape.T_link_shape, meshes[mesh])


def _primitive(shape: LinkShape) -> Any:  # noqa: ANN401  coal has no types
    """A box, cylinder, capsule or sphere; None if it is none of these or lacks a size."""
    kinds = {
        "box": hppfcl.Box,
        "cylinder": hppfcl.Cylinder,
        "capsule": hppfcl.Capsule,
        "sphere": hppfcl.Sphere,
    }
    sizes = shape.sizes
    return None if sizes is None else kinds[shape.geometry.tag](*sizes)


def _mesh(
    urdf: Urdf, link: str, name: str, scale: tuple[float, ...], folders: tuple[Path, ...]
) -> Any:  # noqa: ANN401  coal has no types
    """The mesh of a file, as a hierarchy of bounding volumes.

    Raises:
        UrdfError: It cannot be found or read.
    """
    path = find_mesh(name, folders)
    if path is None:
        listed = ", ".join(str(folder) for folder in folders[:4])
        more = f" and {len(folders) - 4} more folders" if len(folders) > 4 else ""
        message = (
            f"{urdf.source}: link '{link}': the mesh '{name}' was not found in {listed}{more}. Name the folder that "
            "holds it, for package://NAME/... the one that NAME stands in, by --package-dir, or plan without "
            "collisions (--no-collisions)."
        )
        raise UrdfError(message)
    mesh, problem = load_mesh(path, scale)
    if mesh is None:
        message = (
            f"{urdf.source}: link '{link}': the mesh file '{path}' {problem}. Replace it, or plan without collisions "
            "(--no-collisions)."
        )
        raise UrdfError(message)
    return mesh
