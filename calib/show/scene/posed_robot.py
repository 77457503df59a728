"""The shapes of a robot, and their poses in the scene: values only.

A `PosedRobot` has movers: the links that have shapes or rods, and the frames of base, tip and target. Each shape is
fixed to a mover; a rod joins the origins of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, Integers, rigid_inverse
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, mesh_folders, read_mesh
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

#: Vertices, shape (V, 3), [m], and faces, shape (F, 3), indices of vertices.
Mesh = tuple[NDArray[np.floating], NDArray[np.int64]]

#: Faces that meet at less than this angle look like one smooth surface [rad].
_CREASE = np.deg2rad(35.0)

#: Radius of a stick figure's rods, as a fraction of the robot's size.
_ROD_RADIUS = 0.018

#: Largest number of poses at which the corners of a robot's shapes are computed: a page of 400 poses needs no more.
_MOST_OUTLINED = 60

#: Index of the base's frame among the movers.
BASE_MOVER = -3

#: The corners of a cube of edge 1 about the origin, shape (8, 3).
_CUBE = np.indices((2, 2, 2)).reshape(3, -1).T - 0.5


class Visual(NamedTuple):
    """One visual shape of a link."""

    #: The link's name
    link: str
    #: Shape (4, 4), the shape in the link's frame [m]
    T_link_shape: Array
    #: Its triangles; None if its mesh file cannot be found or read
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
        problem = ""
        if shape.mesh is None:
            mesh = _solid(shape)
            if mesh is None:
                problem = "a visual has no geometry that can be drawn"
        else:
            name, scale = shape.mesh
            path = find_mesh(name, folders)
            if path is None:
                mesh, problem = None, "was not found; a simple shape stands for it"
            else:
                mesh, problem = _mesh_file(path, scale)
            if problem:
                problem = f"the mesh '{name}' {problem}"
        visuals.append(Visual(shape.link, shape.T_link_shape, mesh))
        if problem:
            warnings[f"link '{shape.link}': {problem}"] = None
    return tuple(visuals), tuple(warnings)


@lru_cache(maxsize=64)
def _mesh_file(path: Path, scale: tuple[float, float, float]) -> tuple[Mesh | None, str]:
    """Return the triangles of a mesh file [m], scaled along x, y, z, and ``""``; or None and its fault."""
    mesh, problem = read_mesh(path, scale)
    if mesh is None:
        return None, f"{problem}; a simple shape stands for it"
    return creased(*mesh), ""


def _solid(shape: LinkShape) -> Mesh | None:
    """Return a box, sphere or cylinder (a capsule too) as triangles [m]; None for a shape without sizes."""
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
    """Duplicate the vertices on creases, one for each smooth side, because three.js smooths at each vertex.

    Args:
        vertices: shape (V, 3), [m].
        faces: shape (F, 3), indices of vertices.

    Returns:
        A mesh of the same surface with more vertices.
    """
    mesh = trimesh.Trimesh(vertices, faces)
    shaded = trimesh.graph.smooth_shade(mesh, _CREASE, facet_minarea=None)
    return np.asarray(shaded.vertices, dtype=np.float32), np.asarray(shaded.faces)


class PosedRobot(NamedTuple):
    """The shapes of one robot, and its N poses in the scene."""

    #: Links that move; the L movers are these, then the frames of base, tip and target
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
        chain: Integers | None = None,
        marks: Sequence[Visual] = (),
    ) -> PosedRobot:
        """Place a robot in the scene.

        Links whose mesh is missing, or all links of a robot without shapes, are rods from one to the next.

        Args:
            robot: The robot.
            q: shape (N, m), joint values [rad or m].
            visuals: Its shapes, see `read_visuals`.
            T_scene_base: shape (N, 4, 4), the base of each pose's chain in the scene [m].
            target: shape (N, 4, 4) or (4, 4), T_tip_target [m].
            chain: shape (N,), each pose's chain, by its index in `Robot.chains`; None: the first.
            marks: Shapes with triangles that are drawn besides those of the robot, at its links.
        """
        drawn = {visual.link for visual in visuals if visual.mesh is not None}
        sticks = set(robot.urdf.links)
        if drawn:
            sticks = {visual.link for visual in visuals if visual.mesh is None}
        joints = [joint for joint in robot.urdf.joints if joint.parent in sticks]
        needed = drawn | sticks | {joint.child for joint in joints}
        needed |= {mark.link for mark in marks}
        links = tuple(link for link in robot.urdf.links if link in needed)
        rods = [(links.index(joint.parent), links.index(joint.child)) for joint in joints]
        parts = [
            (links.index(visual.link), visual.mesh, visual.T_link_shape)
            for visual in (*visuals, *marks)
            if visual.mesh is not None
        ]

        T_root_link = root_poses(robot, q)
        first_origins = [T[0, :3, 3] for T in T_root_link.values()]
        radius = _ROD_RADIUS * float(np.linalg.norm(np.ptp(first_origins, axis=0)))

        T_root_base = T_root_link[robot.base]
        if chain is not None:
            bases = np.stack([T_root_link[one.base] for one in robot.chains])
            T_root_base = bases[chain, np.arange(len(q))]
        T_scene_root = T_scene_base @ rigid_inverse(T_root_base)
        moved = [T_scene_root @ T_root_link[link] for link in links]
        # The robot's own forward kinematics place tip and target: the tables are about those points.
        T_scene_tip = T_scene_base @ robot.poses(q, chain)
        T_scene_target = T_scene_tip @ target
        poses = np.stack([*moved, T_scene_base, T_scene_tip, T_scene_target], axis=1)
        return cls(links, parts, rods, radius, poses)

    def outline(self, poses: slice = slice(None)) -> Array:
        """Return points that enclose the robot at some poses: origins, and corners of the parts' bounding boxes.

        Args:
            poses: Indices of the poses in ``self.poses``. If there are many, corners are computed at an even choice.

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
    """Return the corners of the bounding box of vertices (V, 3) [m] as x, y, z, 1, shape (8, 4)."""
    low = vertices.min(axis=0)
    high = vertices.max(axis=0)
    corners: Array = 0.5 * (low + high) + _CUBE * (high - low)
    return np.hstack([corners, np.ones((8, 1))])


def stands(robot: Robot) -> bool:
    """Return whether all chains of a robot begin at one link, in which its poses are then drawn."""
    return len({chain.base for chain in robot.chains}) == 1


def chain_bases(robot: Robot, q: Array, chain: Integers | None) -> Array:
    """Return the base of each pose's chain in the scene: the one base of all chains, else the URDF's root.

    Args:
        robot: The robot.
        q: shape (N, m), joint readings [rad or m].
        chain: shape (N,), index of each pose's chain in `Robot.chains`; None: the first.

    Returns:
        T_scene_base, shape (N, 4, 4) [m]; identities for a robot whose chains begin at one link.
    """
    if stands(robot):
        return np.broadcast_to(np.eye(4), (len(q), 4, 4))
    T_root_link = root_poses(robot, q)
    bases = np.stack([T_root_link[one.base] for one in robot.chains])
    chosen = np.zeros(len(q), dtype=np.int_) if chain is None else chain
    return np.asarray(bases[chosen, np.arange(len(q))])


def root_poses(robot: Robot, q: Array) -> dict[str, Array]:
    """Compute the pose of every link of the URDF in the root link.

    Args:
        robot: The robot.
        q: shape (N, m), joint readings [rad or m], in the order of `Robot.joint_names`.

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
    """Return poses of shape (..., 4, 4), [m], as position and quaternion (x, y, z, w), shape (..., 7)."""
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
