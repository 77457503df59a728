"""What a robot looks like: the ``<visual>`` elements of its links as triangles, and where they are at each pose."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from calib.robot.chain import full_configurations, full_model, link_frame
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, mesh_folders, read_mesh
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import Urdf

Array = NDArray[np.float64]

#: Vertices, shape (V, 3), [m], and faces, shape (F, 3), indices of vertices.
Mesh = tuple[NDArray[np.floating], NDArray[np.int64]]

#: A mesh is drawn with so many triangles at most.
MOST_TRIANGLES = 40_000

#: Faces that meet at less than this angle look like one smooth surface [rad].
CREASE = np.deg2rad(35.0)

#: Radius of a stick figure's rods, as a part of the robot's size.
STICK = 0.018

#: The movers behind the links are the frames of base, tip and target.
FRAMES = ("base", "tip", "target")

#: The corners of a cube about the origin.
_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))

#: At most so many poses are looked at for what the shapes reach.
_REACHED = 60


@dataclass(frozen=True, slots=True, eq=False)
class Visual:
    """One shape of one link, at T_link_shape of shape (4, 4), [m]; None where its mesh cannot be found or read."""

    link: str
    T_link_shape: Array
    mesh: Mesh | None


def read_visuals(urdf: Urdf) -> tuple[tuple[Visual, ...], tuple[str, ...]]:
    """Every visual of every link, in the file's order, and a sentence for each that is not drawn as the URDF says."""
    folders = mesh_folders(urdf)
    visuals: list[Visual] = []
    warnings: dict[str, None] = {}
    for one in link_shapes(urdf, "visual"):
        mesh, text = _solid(one), f"a visual of link '{one.link}' has no geometry that can be drawn"
        if one.mesh is not None:
            name, scale = one.mesh
            path = find_mesh(name, folders)
            mesh, problem = None, "was not found; a simple shape stands for it"
            if path is not None:
                mesh, problem = _mesh_file(path, scale, path.stat().st_mtime_ns)
            text = f"link '{one.link}': the mesh '{name}' {problem}" * bool(problem)
        elif mesh is not None:
            text = ""
        visuals.append(Visual(one.link, one.T_link_shape, mesh))
        warnings |= {text: None} if text else {}
    return tuple(visuals), tuple(warnings)


@lru_cache(maxsize=64)
def _mesh_file(
    path: Path,
    scale: tuple[float, float, float],
    _modified: int,
) -> tuple[Mesh | None, str]:
    """The triangles of a file that was last changed then, and what is wrong with them."""
    mesh, problem = read_mesh(path, scale)
    if mesh is None:
        return None, f"{problem}; a simple shape stands for it"
    fewer = simplified(*mesh, MOST_TRIANGLES)
    problem = "is drawn simplified" if len(fewer[1]) < len(mesh[1]) else ""
    return creased(*fewer), problem


def _solid(shape: LinkShape) -> Mesh | None:
    """A box, a sphere or a cylinder as triangles; a capsule is drawn as a cylinder."""
    sizes, make = shape.sizes, trimesh.creation
    if sizes is None:
        return None
    if shape.geometry.tag == "box":
        solid = make.box(sizes)
    elif shape.geometry.tag == "sphere":
        solid = make.icosphere(3, sizes[0])
    else:
        solid = make.cylinder(sizes[0], sizes[1])
    return creased(solid.vertices, solid.faces)


def creased(vertices: NDArray[np.floating], faces: NDArray[np.int64]) -> Mesh:
    """A mesh whose vertices on a crease are doubled, one for each smooth side: three.js smooths at each vertex."""
    mesh = trimesh.Trimesh(vertices.astype(np.float32), faces)
    mesh.update_faces(mesh.area_faces > 0.0)
    one, other = mesh.face_adjacency[mesh.face_adjacency_angles < CREASE].T
    pairs = coo_matrix((np.ones(len(one)), (one, other)), shape=(len(mesh.faces),) * 2)
    _, side = connected_components(pairs, directed=False)
    corners = np.column_stack([mesh.faces.ravel(), np.repeat(side, 3)])
    used, numbers = np.unique(corners, axis=0, return_inverse=True)
    return np.asarray(mesh.vertices[used[:, 0]], dtype=np.float32), numbers.reshape(-1, 3)


def simplified(vertices: NDArray[np.floating], faces: NDArray[np.int64], most: int) -> Mesh:
    """A mesh with at most so many faces: the vertices in each cell of a grid become their mean."""
    merged, means, cell = faces, vertices, 0.0
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    while len(merged) > most and cell < diagonal:
        cell = 1.4 * cell or diagonal / 1000.0
        grid = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
        _, inverse = np.unique(grid @ [1 << 40, 1 << 20, 1], return_inverse=True)
        count = np.bincount(inverse)
        means = np.stack([np.bincount(inverse, vertices[:, k]) / count for k in range(3)], axis=1)
        a, b, c = inverse[faces].T
        merged = np.unique(inverse[faces][(a != b) & (b != c) & (c != a)], axis=0)
    return means, merged


@dataclass(frozen=True, slots=True, eq=False)
class Puppet:
    """What of one robot is drawn, and where it is.

    Attributes:
        links: The links that move; the movers are these and behind them `FRAMES`.
        parts: A mover's number, a mesh, and T_mover_shape of shape (4, 4), [m].
        rods: Pairs of movers with a rod from the origin of one to that of the other.
        radius: Of the rods [m].
        poses: shape (N, L, 4, 4), each mover on the stage at each pose [m].
        origins: shape (N, K, 3), all links of the URDF [m].
    """

    links: tuple[str, ...]
    parts: tuple[tuple[int, Mesh, Array], ...]
    rods: tuple[tuple[int, int], ...]
    radius: float
    poses: Array
    origins: Array

    @classmethod
    def of(
        cls,
        robot: Robot,
        q: Array,
        visuals: Sequence[Visual],
        T_stage_base: Array,
        T_tip_target: Array,
    ) -> Puppet:
        """A robot at poses q of shape (N, m), standing at T_stage_base of shape (N, 4, 4), [m].

        Links whose mesh is missing, or all links of a robot without shapes, are balls with rods between them.
        """
        in_root = root_poses(robot, q)
        T_stage_root = T_stage_base @ rigid_inverse(in_root[robot.base])
        shown = {v.link for v in visuals if v.mesh is not None} & set(in_root)
        sticks = {v.link for v in visuals if v.mesh is None} if shown else set(robot.urdf.links)
        joints = [joint for joint in robot.urdf.joints if joint.parent in sticks]
        needed = shown | sticks | {joint.child for joint in joints}
        links = tuple(link for link in robot.urdf.links if link in needed)
        # The robot's own forward kinematics put tip and target: those are the points that the tables speak of.
        T_tip = T_stage_base @ robot.poses(q)
        moved = [T_stage_root @ in_root[link] for link in links]
        poses = np.stack([*moved, T_stage_base, T_tip, T_tip @ T_tip_target], axis=1)
        origins = np.stack([(T_stage_root @ T)[:, :3, 3] for T in in_root.values()], axis=1)
        radius = STICK * float(np.linalg.norm(np.ptp(origins[0], axis=0)))
        sphere = trimesh.creation.icosphere(3, 1.6 * radius)
        ball = np.asarray(sphere.vertices, dtype=np.float32), sphere.faces
        balls = [Visual(link, np.eye(4), ball) for link in links if link in sticks]
        parts = tuple(
            (links.index(v.link), v.mesh, v.T_link_shape)
            for v in (*visuals, *balls)
            if v.mesh is not None and v.link in links
        )
        rods = tuple((links.index(joint.parent), links.index(joint.child)) for joint in joints)
        return cls(links, parts, rods, radius, read_only(poses), read_only(origins))

    def outline(self, poses: slice = slice(None)) -> Array:
        """Points that hold the robot at some poses: origins, and the corners of boxes about parts, (K, 3), [m]."""
        at = self.poses[poses]
        at = at[np.linspace(0, len(at) - 1, min(len(at), _REACHED)).round().astype(int)]
        points = [self.origins[poses].reshape(-1, 3), self.poses[poses][:, :, :3, 3].reshape(-1, 3)]
        for mover, (vertices, _), T in self.parts:
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            box = 0.5 * (low + high) + _CORNERS * (high - low)
            at_box = at[:, mover] @ T
            points.append(box @ at_box[:, :3, :3].swapaxes(1, 2) + at_box[:, None, :3, 3])
        return np.concatenate([one.reshape(-1, 3) for one in points])


def root_poses(robot: Robot, q: Array) -> dict[str, Array]:
    """T_root_link of every link of the URDF at poses of shape (N, m), by link, shape (N, 4, 4), [m]."""
    model = full_model(robot.urdf)
    data = model.createData()
    frames = [link_frame(model, link) for link in robot.urdf.links]
    poses = np.empty((len(q), len(frames), 4, 4))
    for n, configuration in enumerate(full_configurations(model, robot.urdf_values(q))):
        pin.framesForwardKinematics(model, data, configuration)
        for k, frame in enumerate(frames):
            poses[n, k] = data.oMf[frame].homogeneous
    return {link: poses[:, k] for k, link in enumerate(robot.urdf.links)}


def stage_poses(robot: Robot, q: Array) -> Array:
    """Where the base stands on the stage at each pose, shape (N, 4, 4), [m].

    The stage is the robot's base; where joints move the base itself, as they do a camera's, it is the root of the URDF.
    """
    if not robot.base_moves:
        return np.broadcast_to(np.eye(4), (len(q), 4, 4))
    return root_poses(robot, q)[robot.base]


def packed(poses: Array) -> NDArray[np.float32]:
    """Poses of shape (..., 4, 4), [m], as position and quaternion (x, y, z, w), shape (..., 7)."""
    flat = poses.reshape(-1, 4, 4)
    # A copy: SciPy before 1.14 takes no matrix that is read-only.
    turned = Rotation.from_matrix(flat[:, :3, :3].copy()).as_quat()
    both = np.concatenate([flat[:, :3, 3], turned], axis=1).astype(np.float32)
    return both.reshape(*poses.shape[:-2], 7)


def rod_between(start: Array, end: Array) -> tuple[Array, float]:
    """The pose of a rod between two points, z along it, and its length [m]."""
    length = float(np.linalg.norm(end - start))
    T = np.eye(4)
    T[:3, 3] = 0.5 * (start + end)
    if length > 0:
        turn, _ = Rotation.align_vectors([(end - start) / length], [[0.0, 0.0, 1.0]])
        T[:3, :3] = turn.as_matrix()
    return T, length
