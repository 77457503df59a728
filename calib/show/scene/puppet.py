"""The shapes of a robot, and their poses in the scene: values only.

A `Puppet` has movers: links with shapes or rods, and the frames of base, tip and target. Its shapes are fixed to
movers; a rod joins the origins of two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, rigid_inverse
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, mesh_folders, read_mesh
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

#: Vertices, shape (V, 3), [m], and faces, shape (F, 3), indices of vertices.
Mesh = tuple[NDArray[np.floating], NDArray[np.int64]]

#: Faces that meet at less than this angle look like one smooth surface [rad].
_CREASE = np.deg2rad(35.0)

#: Radius of a stick figure's rods, as a part of the robot's size.
_ROD_RADIUS = 0.018

#: Poses, at most, at which the corners of a robot's shapes are computed: a page of 400 poses needs no more.
_MOST_OUTLINED = 60

#: Index of the base's frame among the movers.
BASE_MOVER = -3

#: The corners of a cube of edge 1 about the origin, shape (8, 3).
CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T - 0.5


class Visual(NamedTuple):
    """One visual shape of a link."""

    #: The link's name
    link: str
    #: Shape (4, 4), the shape in the link's frame [m]
    T_link_shape: Array
    #: Its triangles; None where a mesh file cannot be found or read
    mesh: Mesh | None


def read_visuals(urdf: Urdf) -> tuple[tuple[Visual, ...], tuple[str, ...]]:
    """Read every visual of every link, in the file's order.

    Args:
        urdf: The URDF; meshes are searched for near its file.

    Returns:
        The visuals, and a sentence for each that is not drawn as the URDF says.
    """
    folders = mesh_folders(urdf)
    visuals: list[Visual] = []
    warnings: dict[str, None] = {}  # in order, each once
    for shape in link_shapes(urdf, "visual"):
        mesh, problem = _triangles(shape, folders)
        visuals.append(Visual(shape.link, shape.T_link_shape, mesh))
        if problem:
            warnings[f"link '{shape.link}': {problem}"] = None
    return tuple(visuals), tuple(warnings)


def _triangles(shape: LinkShape, folders: Sequence[Path]) -> tuple[Mesh | None, str]:
    """Return the triangles of a shape, and what is wrong with them.

    Args:
        shape: A shape of a link: a mesh file, or a box, sphere or cylinder.
        folders: Where a mesh file is searched for.

    Returns:
        The triangles, None if there are none to draw; and the end of a sentence on what is wrong, empty if nothing is.
    """
    if shape.mesh is None:
        solid = _solid(shape)
        if solid is None:
            return None, "a visual has no geometry that can be drawn"
        return solid, ""
    name, scale = shape.mesh
    path = find_mesh(name, folders)
    if path is None:
        return None, f"the mesh '{name}' was not found; a simple shape stands for it"
    mesh, problem = _mesh_file(path, scale)
    if problem:
        problem = f"the mesh '{name}' {problem}"
    return mesh, problem


@lru_cache(maxsize=64)
def _mesh_file(path: Path, scale: tuple[float, float, float]) -> tuple[Mesh | None, str]:
    """Return the triangles of a file, scaled along x, y, z, and what is wrong with them."""
    mesh, problem = read_mesh(path, scale)
    if mesh is None:
        return None, f"{problem}; a simple shape stands for it"
    return creased(*mesh), ""


def _solid(shape: LinkShape) -> Mesh | None:
    """Return a box, a sphere or a cylinder as triangles; a capsule is drawn as a cylinder."""
    if shape.sizes is None:
        return None
    if shape.geometry.tag == "box":
        solid = trimesh.creation.box(shape.sizes)
    elif shape.geometry.tag == "sphere":
        solid = trimesh.creation.icosphere(3, shape.sizes[0])
    else:
        radius, length = shape.sizes[0], shape.sizes[1]
        solid = trimesh.creation.cylinder(radius, length)
    return creased(solid.vertices, solid.faces)


def creased(vertices: NDArray[np.floating], faces: NDArray[np.int64]) -> Mesh:
    """Double the vertices on creases, one for each smooth side: three.js smooths at each vertex.

    Args:
        vertices: shape (V, 3), [m].
        faces: shape (F, 3), indices of vertices.

    Returns:
        The mesh with more vertices; it has the same surface.
    """
    mesh = trimesh.Trimesh(vertices, faces)
    shaded = trimesh.graph.smooth_shade(mesh, _CREASE, facet_minarea=None)
    return np.asarray(shaded.vertices, dtype=np.float32), np.asarray(shaded.faces)


class Puppet(NamedTuple):
    """The shapes of one robot, and its poses in the scene."""

    #: Links that move; the movers are these, then the frames of base, tip and target
    links: tuple[str, ...]
    #: A mover's index, a mesh, and T_mover_shape, (4, 4), [m]
    parts: list[tuple[int, Mesh, Array]]
    #: Indices of two movers whose origins a rod joins
    rods: list[tuple[int, int]]
    #: Radius of the rods [m]
    radius: float
    #: Shape (N, L, 4, 4), T_scene_mover at each pose [m]
    poses: Array

    @classmethod
    def of(
        cls,
        robot: Robot,
        q: Array,
        visuals: Sequence[Visual],
        T_scene_base: Array,
        target: Array,
    ) -> Puppet:
        """Place a robot in the scene.

        Links whose mesh is missing, or all links of a robot without shapes, are rods from one to the next.

        Args:
            robot: The robot.
            q: shape (N, m), joint values [rad or m].
            visuals: Its shapes, see `read_visuals`.
            T_scene_base: shape (N, 4, 4), its base in the scene [m].
            target: shape (N, 4, 4) or (4, 4), T_tip_target [m].
        """
        links, rods = _movers(robot, visuals)
        T_root_link = root_poses(robot, q)
        T_scene_root = T_scene_base @ rigid_inverse(T_root_link[robot.base])
        moved = [T_scene_root @ T_root_link[link] for link in links]
        # The robot's own forward kinematics place tip and target: the tables are about those points.
        T_scene_tip = T_scene_base @ robot.poses(q)
        T_scene_target = T_scene_tip @ target
        poses = np.stack([*moved, T_scene_base, T_scene_tip, T_scene_target], axis=1)
        return cls(links, _parts(links, visuals), rods, _rod_radius(T_root_link), poses)

    def outline(self, poses: slice = slice(None)) -> Array:
        """Return points that enclose the robot at some poses: origins, and corners of the parts' bounding boxes.

        Args:
            poses: Indices of the poses in ``self.poses``; of more than 60 an even choice has its corners taken.

        Returns:
            shape (K, 3), in the scene [m].
        """
        T_scene_movers = self.poses[poses]
        origins = T_scene_movers[:, :, :3, 3]
        count = len(T_scene_movers)
        evenly = np.linspace(0, count - 1, min(count, _MOST_OUTLINED))
        T_scene_movers = T_scene_movers[evenly.round().astype(int)]
        points = [origins.reshape(-1, 3)]
        for mover, (vertices, _), T_mover_shape in self.parts:
            corners = _box_corners(vertices)
            placed = T_scene_movers[:, mover] @ T_mover_shape @ corners.T
            points.append(placed[:, :3].swapaxes(1, 2).reshape(-1, 3))
        return np.concatenate(points)


def _box_corners(vertices: NDArray[np.floating]) -> Array:
    """Return the corners of the box that bounds vertices (V, 3) [m], shape (8, 4): x, y, z, and 1 behind them."""
    low = vertices.min(axis=0)
    high = vertices.max(axis=0)
    corners: Array = 0.5 * (low + high) + CORNERS * (high - low)
    return np.hstack([corners, np.ones((8, 1))])


def _movers(
    robot: Robot, visuals: Sequence[Visual]
) -> tuple[tuple[str, ...], list[tuple[int, int]]]:
    """Choose the links that are drawn.

    Args:
        robot: The robot.
        visuals: Its shapes; without any, all links are rods.

    Returns:
        The links in the URDF's order, and the pairs of their indices that a rod joins.
    """
    drawn = {visual.link for visual in visuals if visual.mesh is not None}
    sticks = set(robot.urdf.links)
    if drawn:
        sticks = {visual.link for visual in visuals if visual.mesh is None}
    joints = [joint for joint in robot.urdf.joints if joint.parent in sticks]
    needed = drawn | sticks | {joint.child for joint in joints}
    links = tuple(link for link in robot.urdf.links if link in needed)
    rods = [(links.index(joint.parent), links.index(joint.child)) for joint in joints]
    return links, rods


def _parts(links: Sequence[str], visuals: Sequence[Visual]) -> list[tuple[int, Mesh, Array]]:
    """Return the index of the link, the mesh and T_link_shape, (4, 4), [m], of each visual that has a mesh."""
    parts: list[tuple[int, Mesh, Array]] = []
    for visual in visuals:
        if visual.mesh is not None:
            index = links.index(visual.link)
            parts.append((index, visual.mesh, visual.T_link_shape))
    return parts


def _rod_radius(T_root_link: Mapping[str, Array]) -> float:
    """Return the radius of rods [m] by the size of the robot at its first pose; poses (N, 4, 4) by link."""
    origins = [T[0, :3, 3] for T in T_root_link.values()]
    extent = np.ptp(origins, axis=0)
    return _ROD_RADIUS * float(np.linalg.norm(extent))


def root_poses(robot: Robot, q: Array) -> dict[str, Array]:
    """Compute the pose of every link of the URDF in the root link.

    Args:
        robot: The robot.
        q: shape (N, m), joint values [rad or m].

    Returns:
        T_root_link by the link's name, shape (N, 4, 4), [m].
    """
    model = full_model(robot.urdf)
    data = model.createData()
    frames = [link_frame(model, link) for link in robot.urdf.links]
    poses = np.empty((len(q), len(frames), 4, 4))
    configurations = full_configurations(model, robot.urdf_values(q))
    for n, configuration in enumerate(configurations):
        pin.framesForwardKinematics(model, data, configuration)
        poses[n] = [data.oMf[frame].homogeneous for frame in frames]
    return {link: poses[:, k] for k, link in enumerate(robot.urdf.links)}


def packed(poses: Array) -> NDArray[np.float32]:
    """Write poses of shape (..., 4, 4), [m], as position and quaternion (x, y, z, w), shape (..., 7)."""
    flat = poses.reshape(-1, 4, 4)
    # A copy: SciPy before 1.14 takes no matrix that is read-only.
    quaternions = Rotation.from_matrix(flat[:, :3, :3].copy()).as_quat()
    both = np.concatenate([flat[:, :3, 3], quaternions], axis=1).astype(np.float32)
    return both.reshape(*poses.shape[:-2], 7)


def translation(offset: ArrayLike) -> Array:
    """Return the pose (4, 4) without rotation at ``offset``, shape (3,), [m]."""
    T = np.eye(4)
    T[:3, 3] = offset
    return T
