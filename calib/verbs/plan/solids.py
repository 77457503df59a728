"""Solids: the shapes of a robot and its surroundings, as coal compares them.

A link has the shapes of its ``<collision>`` elements, or else those of its ``<visual>`` elements; a capsule from the
tip to the target stands for the target and what holds it; boxes are those of the cell. A large box stands for
everything below the mounting plane.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pinocchio import hppfcl

from calib.basics.arrays import Array
from calib.data.cell import Box
from calib.data.columns import DEFAULT_TARGET
from calib.errors import UrdfError
from calib.robot.full_model import full_model, link_frame
from calib.robot.kernel import turns_to
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, load_mesh, mesh_folders
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.robot.urdf_tree import UrdfJoint

#: Thickness of the box that stands for everything below the mounting plane, and half its width [m].
_GROUND = 20.0

#: Simple shapes of URDFs that coal has under the same names.
_SIMPLE = ("Box", "Cylinder", "Capsule", "Sphere")


class Solid(NamedTuple):
    """One shape of coal."""

    #: Name of the link, target, box or plane that it belongs to.
    owner: str
    #: Kind of the owner.
    kind: Literal["link", "target", "box", "plane"]
    #: Name of the link to which it is fixed.
    link: str
    #: Shape (4, 4), pose of the shape in that link [m].
    T_link_shape: Array
    #: The shape of coal, which has no types.
    geometry: Any


def read_solids(
    urdf: Urdf, package_dirs: Iterable[str | Path] = ()
) -> tuple[list[Solid], list[str]]:
    """Read the shapes of all links of a robot, to check them for collisions; each mesh file is read once.

    Args:
        urdf: The URDF of the whole robot.
        package_dirs: Folders in which ``package://`` meshes are looked for before all others.

    Returns:
        The solids, in the order of the URDF's links; and the names of the links whose shapes cannot all be used, or
        that have a mass and no shape.

    Raises:
        UrdfError: A mesh is missing or cannot be read, or no link has a shape.
    """
    folders = mesh_folders(urdf, package_dirs)
    collision = list(link_shapes(urdf, "collision"))
    visual = list(link_shapes(urdf, "visual"))
    # Read from the text of the URDF, because Pinocchio keeps the inertias of joints, not of links.
    bodies = set()
    for element in urdf.elements().findall("link"):
        masses = [mass.get("value", "0") for mass in element.findall("inertial/mass")]
        if any(mass.strip("0. ") for mass in masses):
            bodies.add(element.get("name", ""))
    meshes: dict[tuple[str, tuple[float, ...]], Any] = {}
    solids, unchecked = [], []
    for link in urdf.links:
        proper = [shape for shape in collision if shape.link == link]
        shapes = proper or [shape for shape in visual if shape.link == link]
        usable = []
        for shape in shapes:
            geometry = _geometry(urdf, shape, folders, meshes)
            if geometry is not None:
                usable.append(Solid(link, "link", link, shape.T_link_shape, geometry))
        if len(usable) < len(shapes) or (not shapes and link in bodies):
            unchecked.append(link)
        solids += usable
    if not solids:
        raise UrdfError(
            f"{urdf.source}: no link has a <collision> or <visual> with a geometry that can be "
            "used. Take a URDF with geometry, or plan without collisions (--no-collisions)."
        )
    return solids, unchecked


def target_solids(
    robot: Robot, targets: Mapping[str, ArrayLike], holder_radius: float
) -> list[Solid]:
    """Return a capsule from the origin of the tip to each target, which stands for the target and what holds it.

    Args:
        robot: The robot, to whose tip the capsules are fixed.
        targets: Positions of the targets in the tip by name, shape (3,), [m].
        holder_radius: Radius of the capsules [m]; their round ends extend as far beyond tip and target.
    """
    solids = []
    for name, place in targets.items():
        end = np.array([place], dtype=np.float64)
        T_tip_rod, half_length = rods(np.zeros((1, 3)), end)
        capsule = hppfcl.Capsule(holder_radius, 2.0 * float(half_length[0]))
        who = "the target" if name == DEFAULT_TARGET else f"the target '{name}'"
        owner = f"{who} with its holder"
        solids.append(Solid(owner, "target", robot.tip, T_tip_rod[0], capsule))
    return solids


def box_solids(robot: Robot, boxes: Iterable[Box]) -> list[Solid]:
    """Return the boxes of a cell as solids that are fixed to the robot's base."""
    solids = []
    for box in boxes:
        geometry = hppfcl.Box(*box.size)
        solids.append(Solid(box.name, "box", robot.base, box.T_base_box, geometry))
    return solids


def rods(starts: Array, ends: Array) -> tuple[Array, Array]:
    """Place straight rods between pairs of points.

    Args:
        starts: First end of each rod, shape (n, 3), [m], all in one frame.
        ends: Second end of each in the same frame, shape (n, 3), [m]; if both are the same point, the rod has no length
            and points along z.

    Returns:
        Pose of the middle of each rod in that frame, z from its first end to its second, shape (n, 4, 4), [m]; the
        rotation about z is arbitrary. And half the distance between its ends, shape (n,), [m].
    """
    along = ends - starts
    lengths = np.linalg.norm(along, axis=1)
    along[lengths == 0.0] = 0.0, 0.0, 1.0
    directions = along / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    T = np.tile(np.eye(4), (len(along), 1, 1))
    T[:, :3, :3] = turns_to(directions)
    T[:, :3, 3] = 0.5 * (starts + ends)
    return T, 0.5 * lengths


def _geometry(
    urdf: Urdf,
    shape: LinkShape,
    folders: tuple[Path, ...],
    meshes: dict[Any, Any],
) -> Any:  # noqa: ANN401  coal has no types
    """Return a link's shape as coal has it; None for a kind that coal does not have, or sizes that are not positive.

    Meshes that are read are added to ``meshes``, by file name and scale, and are taken from there. One that is in no
    folder, or cannot be read, raises `UrdfError`.
    """
    if shape.mesh is None:
        tag = shape.geometry.tag.capitalize()
        if shape.sizes is None or tag not in _SIMPLE:
            return None
        return getattr(hppfcl, tag)(*shape.sizes)
    if shape.mesh not in meshes:
        name, scale = shape.mesh
        path = find_mesh(name, folders)
        problem = "was not found; name its folder by --package-dir"
        if path is not None:
            meshes[shape.mesh], problem = load_mesh(path, scale)
        if problem:
            raise UrdfError(
                f"{urdf.source}: link '{shape.link}': the mesh '{path or name}' {problem}; or plan "
                "without collisions (--no-collisions)."
            )
    return meshes[shape.mesh]


def clusters(urdf: Urdf, joints: Iterable[UrdfJoint]) -> dict[str, str]:
    """Group the links that some joints hold together.

    Args:
        urdf: The URDF of the whole robot.
        joints: Joints that do not move, such as the fixed ones.

    Returns:
        From the name of each link to the name of the topmost link of its group, the one nearest to the URDF's root.
    """
    parents = {joint.child: joint.parent for joint in joints}

    def top(link: str) -> str:
        """Return the topmost link of a link's group: up through the joints that hold it, so seldom the URDF's root."""
        topmost = link
        while topmost in parents:
            topmost = parents[topmost]
        return topmost

    return {link: top(link) for link in urdf.links}


def mounting_plane(
    robot: Robot,
    links: Sequence[Solid],
    rigid: Mapping[str, str],
    configuration: Array,
) -> Solid:
    """Return a large box that stands for everything below the mounting plane, and is named after its height.

    The plane is z = 0 of the base, or touches the lowest link that is fixed to the base if that is lower.

    Args:
        robot: The robot; if its base link moves, the URDF's root link stands for the base.
        links: The solids of the robot's links.
        rigid: From the name of each link to the topmost link of those that never move against it, see `clusters`.
        configuration: Pinocchio's configuration of the whole robot, shape (nq,), [rad] or [m]; only the values of held
            joints matter.
    """
    base = robot.urdf.root if robot.base_moves else robot.base
    model = full_model(robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration)
    T_base_root = data.oMf[link_frame(model, base)].inverse()
    height = 0.0
    for solid in links:
        if rigid[solid.link] == rigid[base]:
            T_root_link = data.oMf[link_frame(model, solid.link)]
            T_base_shape = T_base_root * T_root_link * pin.SE3(solid.T_link_shape)
            height = min(height, _lowest(solid.geometry, T_base_shape))
    T_base_ground = np.eye(4)
    T_base_ground[2, 3] = height - 0.5 * _GROUND
    # Rounded: a product of poses leaves 1e-11 mm, and never -0.
    name = f"the mounting plane (z = {round(1e3 * height, 3) + 0.0:.4g} mm of '{base}')"
    box = hppfcl.Box(2.0 * _GROUND, 2.0 * _GROUND, _GROUND)
    return Solid(name, "plane", base, T_base_ground, box)


def _lowest(geometry: Any, T_base_shape: pin.SE3) -> float:  # noqa: ANN401  coal has no types
    """Return the least z [m], in the base, of a shape of coal with a pose in the base."""
    rotation, translation = T_base_shape.rotation, T_base_shape.translation
    if isinstance(geometry, hppfcl.BVHModelBase):
        return float(np.min(geometry.vertices() @ rotation[2] + translation[2]))
    ground = hppfcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    placement = hppfcl.Transform3s(rotation, translation)
    request, result = hppfcl.DistanceRequest(), hppfcl.DistanceResult()
    unmoved = hppfcl.Transform3s()
    return float(hppfcl.distance(geometry, placement, ground, unmoved, request, result))
