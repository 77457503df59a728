"""What the links of a URDF look like: its ``<visual>`` elements, with meshes found, read, shaded and kept small."""

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
from scipy.spatial.transform import Rotation

from calib.robot.chain import full_configurations, full_model, link_frame
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, mesh_folders, read_mesh
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.robot.urdf import Urdf

Array = NDArray[np.float64]

#: All the meshes of a robot together are drawn with about this many triangles at most.
MOST_TRIANGLES = 250_000

#: Faces that meet at less than this angle look like one smooth surface [rad].
CREASE = np.deg2rad(35.0)

#: A mesh in which so many pairs of corners share a vertex is drawn with flat faces: it has fans of thousands.
_MOST_PAIRS = 5_000_000

#: Radius of a stick figure's rods, as a part of the robot's size.
STICK = 0.018

#: The movers beside the links, in this order, last.
FRAMES = ("base", "tip", "target")

#: At most so many poses are looked at for what the shapes reach; the origins of links are at all of them.
_REACHED = 60

#: The 26 directions to a cube's corners, edges and faces.
_DIRECTIONS = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])

#: The corners of a cube about the origin.
_CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))


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
    """A triangle mesh as a graphics card takes it: vertices [m], outward normals times 127, faces as indices."""

    vertices: NDArray[np.float32]
    normals: NDArray[np.int8]
    faces: NDArray[np.uint16] | NDArray[np.uint32]


Shape = Box | Cylinder | Sphere | Triangles


@dataclass(frozen=True, slots=True, eq=False)
class Visual:
    """One shape of one link, at T_link_shape of shape (4, 4), [m]; None where its mesh cannot be found or read."""

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

    The normal at a corner is the mean, weighted by the angle there, of the faces at its vertex that are turned by
    less than `CREASE` against its own face. Equal vertices of shape (V, 3) are welded; one on a crease is doubled.
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

    Returns:
        The vertices, the faces and the edge of a cell [m]: no vertex moved farther than its diagonal; 0 if the mesh was
        small enough.
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
    return read_mesh(path, scale)


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


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A shape that is fixed to the mover of a number, at T_mover_shape of shape (4, 4), [m]."""

    mover: int
    shape: Shape
    T_mover_shape: Array

    def corners(self) -> Array:
        """Points in the mover that hold the shape: its outermost, or the corners of its box, shape (K, 3), [m]."""
        shape, T = self.shape, self.T_mover_shape
        if isinstance(shape, Triangles):
            vertices = shape.vertices.astype(np.float64)
            points = vertices[np.argmax(vertices @ (_DIRECTIONS @ T[:3, :3]).T, axis=0)]
        elif isinstance(shape, Sphere):
            points = 2.0 * shape.radius * _CORNERS
        elif isinstance(shape, Cylinder):
            points = _CORNERS * [2.0 * shape.radius, 2.0 * shape.radius, shape.length]
        else:
            points = _CORNERS * shape.size
        return np.asarray(points @ T[:3, :3].T + T[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class Puppet:
    """What of one robot is drawn, and where it is.

    Movers are the ``links``, and behind them the frames of `FRAMES`; ``poses`` of shape (N, L, 4, 4) has where each
    of them is on the stage at each pose, ``origins`` of shape (N, K, 3) where all links of the URDF are [m]. ``rods``
    are pairs of movers with a rod of a ``radius`` from the origin of one to that of the other.
    """

    links: tuple[str, ...]
    parts: tuple[Part, ...]
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
        """A robot at poses q of shape (N, m), standing at T_stage_base of shape (N, 4, 4) [m].

        Raises:
            UrdfError: Pinocchio cannot build a model of the URDF.
        """
        in_root = root_poses(robot, q)
        T_stage_root = T_stage_base @ rigid_inverse(in_root[robot.base])
        shown = {v.link for v in visuals if v.shape is not None} & set(in_root)
        missing = {v.link for v in visuals if v.shape is None}
        sticks = missing if shown else set(robot.urdf.links)
        joints = [joint for joint in robot.urdf.joints if joint.parent in sticks]
        needed = shown | sticks | {joint.child for joint in joints}
        links = tuple(link for link in robot.urdf.links if link in needed)
        number = {link: k for k, link in enumerate(links)}
        # The robot's own forward kinematics put tip and target: those are the points that the tables speak of.
        T_tip = T_stage_base @ robot.poses(q)
        moved = [T_stage_root @ in_root[link] for link in links]
        poses = np.stack([*moved, T_stage_base, T_tip, T_tip @ T_tip_target], axis=1)
        origins = np.stack([(T_stage_root @ T)[:, :3, 3] for T in in_root.values()], axis=1)
        radius = STICK * span(origins[0])
        balls = [Visual(link, np.eye(4), Sphere(1.6 * radius)) for link in links if link in sticks]
        parts = [
            Part(number[v.link], v.shape, v.T_link_shape)
            for v in (*visuals, *balls)
            if v.shape is not None and v.link in number
        ]
        rods = tuple((number[joint.parent], number[joint.child]) for joint in joints)
        return cls(links, tuple(parts), rods, radius, read_only(poses), read_only(origins))

    @property
    def targets(self) -> Array:
        """Where the target is, shape (N, 3), [m]."""
        return np.asarray(self.poses[:, -1, :3, 3])

    def outline(self, n: int) -> Array:
        """Points that hold the robot at a pose, shape (K, 3), [m]."""
        at = self.poses[n]
        corners = [p.corners() @ at[p.mover, :3, :3].T + at[p.mover, :3, 3] for p in self.parts]
        return np.concatenate([self.origins[n], *corners])

    def reach(self) -> Array:
        """Points that hold the robot at all its poses, shape (K, 3), [m]: movers' origins, boxes about parts."""
        count = min(len(self.poses), _REACHED)
        some = self.poses[np.linspace(0, len(self.poses) - 1, count).round().astype(int)]
        points = [self.poses[:, :, :3, 3].reshape(-1, 3)]
        for mover in {part.mover for part in self.parts}:
            held = np.concatenate([part.corners() for part in self.parts if part.mover == mover])
            low, high = held.min(axis=0), held.max(axis=0)
            box = 0.5 * (low + high) + _CORNERS * (high - low)
            at = some[:, mover]
            points.append((box @ at[:, :3, :3].swapaxes(1, 2) + at[:, None, :3, 3]).reshape(-1, 3))
        return np.concatenate(points)


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
    """Poses as position and quaternion (x, y, z, w), shape (..., 7), of poses of shape (..., 4, 4), [m]."""
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


def span(points: Array) -> float:
    """The diagonal of the points' bounding box; 1 mm at least [m]."""
    return max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-3)
