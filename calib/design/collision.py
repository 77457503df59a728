"""Collisions of a robot and what it holds, with itself and with what stands around: Pinocchio places, coal compares.

The whole robot is checked, not the chain alone. A link has the shapes of its ``<collision>``, or else of its
``<visual>``; a target and what holds it are a capsule from the tip to the target. Below the mounting plane nothing may
come, and boxes are not touched. What cannot tell poses apart is left out: links that a joint joins, links that never
move against each other, and what touches wherever the joints stand. Of meshes the surfaces are compared: one that lies
wholly inside another mesh is not found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pinocchio import hppfcl

from calib.data.cell import Box
from calib.design.candidates import Code, Note
from calib.errors import UrdfError
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.kernel import turns_to
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, load_mesh, mesh_folders
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, UrdfJoint
from calib.units import Array, Mask

Names = tuple[tuple[str, str], ...]

#: Largest step of a joint along a path, of one that turns [rad] and one that slides [m].
TURN_STEP, SLIDE_STEP = math.radians(2.0), 5e-3

#: Thickness of a tracker's beam, and how far in front of the target it ends: the reflector's nest does not count [m].
BEAM, NEST = 0.010, 0.030

#: Poses over the joints' ranges at which it is found which pairs always touch, and the share of them that is always.
SAMPLES, ALWAYS = 256, 0.95

#: What stands for all below the mounting plane is a box so thick and twice as wide [m].
_GROUND = 20.0


@dataclass(frozen=True, slots=True)
class CollisionCheck:
    """What is checked for collisions, and how."""

    clearance: float = 0.0  #: Least distance of all that is checked [m].
    #: Whether nothing may come below the mounting plane: z = 0 of the base, or the lowest link that stands with the
    #: base where that is lower.
    floor: bool = True
    #: A target and what holds it are a rod of this radius from the tip to the target [m].
    holder_radius: float = 0.020  # a 1.5 inch reflector has 19 mm
    #: Folders in which ``package://`` meshes are looked for before all others.
    package_dirs: tuple[str | Path, ...] = ()


class Solid(NamedTuple):
    """One shape of coal: whose it is, what that is, and where it is fixed, T_link_shape of shape (4, 4) [m]."""

    owner: str
    kind: Literal["link", "target", "box", "plane"]
    link: str
    T_link_shape: Array
    geometry: Any


class _Scene(NamedTuple):
    """Pairs of shapes to compare, as Pinocchio has them, and the least distance of each [m]."""

    model: pin.Model
    shapes: pin.GeometryModel
    margins: Sequence[float] = ()

    def comparing(self, pairs: Iterable[tuple[int, int]], margins: Sequence[float]) -> _Scene:
        """The scene with these pairs of shapes, in this order."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        return _Scene(self.model, shapes, margins)

    def room(self) -> tuple[pin.Data, pin.GeometryData]:
        """Room for the results of one caller."""
        found = self.shapes.createData()
        for request, margin in zip(found.collisionRequests, self.margins, strict=True):
            request.security_margin = margin
            # Without it coal 3.0 misses some simple shapes that are deep in each other, such as a capsule in a box.
            request.enable_contact = True
            # How far bounding volumes are followed beyond the margin: 1 mm by default, a third of the time.
            request.break_distance = 1e-6
        return self.model.createData(), found

    def touches(self, configurations: Array) -> Iterator[bool]:
        """Whether any pair is closer than its margin, at one configuration of the model after the other, (N, nq)."""
        data, found = self.room()
        for one in configurations:
            yield bool(pin.computeCollisions(self.model, data, self.shapes, found, one, True))

    def touched(self, configurations: Array) -> Mask:
        """Which pairs are closer than their margins, shape (N, pairs)."""
        data, found = self.room()
        result = []
        for one in configurations:
            pin.computeCollisions(self.model, data, self.shapes, found, one, False)
            result.append([answer.isCollision() for answer in found.collisionResults])
        return np.array(result, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CollisionModel:
    """A robot and boxes around it, ready to be asked at which joint values they touch."""

    robot: Robot  #: The robot.
    #: The names of what is checked (links, targets, boxes, the plane), those that touch most often first.
    pairs: Names
    notes: tuple[Note, ...]  #: What was checked, and what was not as a person might expect.
    _scene: _Scene
    _beams: _Scene  # the last shape, a beam, with links and boxes

    @classmethod
    def of(
        cls,
        robot: Robot,
        boxes: Iterable[Box] = (),
        targets: Mapping[str, ArrayLike] | None = None,
        check: CollisionCheck | None = None,
    ) -> CollisionModel:
        """Read the geometry of a robot and find out which pairs have to be checked.

        Boxes are in the robot's base; targets are places in the tip by name, shape (3,), [m].
        """
        urdf, boxes, check = robot.urdf, tuple(boxes), check or CollisionCheck()
        parts, unchecked = read_solids(urdf, check.package_dirs)
        links = list(parts)
        for name, place in (targets or {}).items():
            T, half = _rods(np.zeros((1, 3)), np.array([place], dtype=np.float64))
            holder = hppfcl.Capsule(check.holder_radius, 2.0 * float(half[0]))
            owner = f"{name} and its holder"
            parts.append(Solid(owner, "target", robot.tip, T[0], holder))
        for box in boxes:
            parts.append(Solid(box.name, "box", robot.base, box.T_base_box, hppfcl.Box(*box.size)))
        values = robot.urdf_values(spread_poses(robot, SAMPLES))
        configurations = full_configurations(full_model(urdf), values)
        moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
        rigid = _clusters(urdf, (j for j in urdf.joints if j.name not in moving))
        if check.floor:
            parts.append(_mounting_plane(robot, links, rigid, configurations[0]))
        beam = Solid("the beam", "box", robot.base, np.eye(4), hppfcl.Capsule(0.5 * BEAM, 1.0))
        model, shapes = full_model(urdf), pin.GeometryModel()
        for k, part in enumerate((*parts, beam)):
            frame = link_frame(model, part.link)
            parent = model.frames[frame]
            placed = parent.placement * pin.SE3(part.T_link_shape)
            shape = pin.GeometryObject(str(k), parent.parentJoint, frame, placed, part.geometry)
            shapes.addGeometryObject(shape)
        scene = _Scene(model, shapes)
        hit = [k for k, part in enumerate(parts) if part.kind in ("link", "box")]
        beams = scene.comparing([(k, len(parts)) for k in hit], [0.0] * len(hit))
        chosen = _chosen_pairs(urdf, scene, parts, rigid, configurations, check.clearance)
        scene, pairs, always = chosen
        around = [part.owner for part in parts if part.kind in ("box", "plane")]
        notes = [Note("collisions_checked", (check.holder_radius, *around))]
        listed: dict[Code, list[str]] = {"no_geometry": unchecked, **always}
        notes += [Note(code, tuple(names)) for code, names in listed.items() if names]
        return cls(robot, pairs, tuple(notes), scene, beams)

    def free(self, q: ArrayLike) -> Mask:
        """Where the robot keeps clear, shape (N,), of q of shape (N, m) or (m,), [rad] or [m]."""
        return ~np.fromiter(self._scene.touches(self._configurations(q)), dtype=np.bool_)

    def path_free(self, q_from: ArrayLike, q_to: ArrayLike) -> bool:
        """Whether the straight way in joint space between two poses of shape (m,) is free, both ends among it.

        It is checked at equal steps of at most `TURN_STEP` and `SLIDE_STEP`; the middle first, then the quarters.
        """
        ends = np.array([q_from, q_to], dtype=np.float64)
        sliding = {joint.name for joint in self.robot.urdf.joints if joint.type == "prismatic"}
        steps = (
            abs(float(value[1] - value[0])) / (SLIDE_STEP if name in sliding else TURN_STEP)
            for name, value in self.robot.urdf_values(ends).items()
        )
        count = max(math.ceil(max(steps)), 1)
        # The lowest bit of an index says how coarse a division it belongs to; index 0 is in the coarsest.
        order = sorted(range(count + 1), key=lambda i: -(i & -i or count + 1))
        share = np.array(order)[:, None] / count
        way = self._configurations((1.0 - share) * ends[0] + share * ends[1])
        return not any(self._scene.touches(way))

    def beam_free(self, T_tip_target: Array, tracker: Array, q: Array) -> Mask:
        """Whether no link and no box is in the beam from a tracker to the target at poses q of shape (N, m), (N,).

        The beam is a rod of thickness `BEAM` that ends `NEST` in front of the target. Targets and the mounting plane,
        which are assumed and not known, do not count. ``T_tip_target`` is of shape (4, 4); the tracker, shape (3,), is
        in the robot's base [m].
        """
        scene, frees = self._beams, np.ones(len(q), dtype=np.bool_)
        points = (self.robot.poses(q) @ T_tip_target)[:, :3, 3]
        distance = np.linalg.norm(tracker - points, axis=1)
        # The rod's round ends lie between the same two planes as the beam's flat ones.
        away = (tracker - points) / np.maximum(distance, BEAM)[:, None]
        T_base_beam, half = _rods(tracker - 0.5 * BEAM * away, points + (NEST + 0.5 * BEAM) * away)
        data, found = scene.room()
        base = scene.model.frames[link_frame(scene.model, self.robot.base)]
        last = scene.shapes.ngeoms - 1
        beam = scene.shapes.geometryObjects[last].geometry
        configurations = self._configurations(q)
        for i in np.flatnonzero(distance > NEST + BEAM).tolist():
            beam.halfLength = half[i]
            pin.updateGeometryPlacements(scene.model, data, scene.shapes, found, configurations[i])
            T_root_base = data.oMi[base.parentJoint] * base.placement
            found.oMg[last] = T_root_base * pin.SE3(T_base_beam[i])
            frees[i] = not pin.computeCollisions(scene.shapes, found, True)
        return frees

    def _configurations(self, q: ArrayLike) -> Array:
        """Pinocchio's configurations of the whole robot, shape (N, nq)."""
        return full_configurations(self._scene.model, self.robot.urdf_values(q))


def read_solids(
    urdf: Urdf, package_dirs: Iterable[str | Path] = ()
) -> tuple[list[Solid], list[str]]:
    """The shapes of all links, and the links of which not all can be used, or that carry a mass and have none.

    Each mesh file is read once; ``package_dirs`` are where ``package://`` meshes are looked for before all others.
    """
    folders = mesh_folders(urdf, package_dirs)
    shapes = {tag: list(link_shapes(urdf, tag)) for tag in ("collision", "visual")}
    # Pinocchio keeps the inertias of joints, not of links.
    bodies = {
        link.get("name", "")
        for link in urdf.elements().findall("link")
        if any(mass.get("value", "0").strip("0. ") for mass in link.findall("inertial/mass"))
    }
    meshes: dict[tuple[str, tuple[float, ...]], Any] = {}
    solids, unchecked = [], []
    for link in urdf.links:
        proper, visual = ([one for one in shapes[tag] if one.link == link] for tag in shapes)
        found = [(one, _geometry(urdf, one, folders, meshes)) for one in proper or visual]
        usable = [
            Solid(link, "link", link, one.T_link_shape, g) for one, g in found if g is not None
        ]
        if len(usable) < len(found) or (not found and link in bodies):
            unchecked.append(link)
        solids += usable
    if not solids:
        raise UrdfError(
            f"{urdf.source}: no link has a <collision> or <visual> with a geometry that can be used. Take a URDF with "
            "geometry, or plan without collisions (--no-collisions)."
        )
    return solids, unchecked


def _rods(starts: Array, ends: Array) -> tuple[Array, Array]:
    """Rods between pairs of points (n, 3) [m]: poses (n, 4, 4), z along them, from their middles; half their lengths.

    A rod of no length stands upright.
    """
    along = ends - starts
    lengths = np.linalg.norm(along, axis=1)
    along[lengths == 0.0] = 0.0, 0.0, 1.0
    T = np.tile(np.eye(4), (len(along), 1, 1))
    T[:, :3, :3] = turns_to(along / np.where(lengths > 0.0, lengths, 1.0)[:, None])
    T[:, :3, 3] = 0.5 * (starts + ends)
    return T, 0.5 * lengths


def _geometry(
    urdf: Urdf, shape: LinkShape, folders: tuple[Path, ...], meshes: dict[Any, Any]
) -> Any:  # noqa: ANN401  coal has no types
    """A shape as coal has it; None for a kind or a size that is none."""
    if shape.mesh is None:
        tag = shape.geometry.tag.capitalize()
        known = shape.sizes is not None and tag in ("Box", "Cylinder", "Capsule", "Sphere")
        return getattr(hppfcl, tag)(*(shape.sizes or ())) if known else None
    if shape.mesh not in meshes:
        name, scale = shape.mesh
        path = find_mesh(name, folders)
        problem = "was not found; name its folder by --package-dir"
        if path is not None:
            meshes[shape.mesh], problem = load_mesh(path, scale)
        if problem:
            raise UrdfError(
                f"{urdf.source}: link '{shape.link}': the mesh '{path or name}' {problem}; or plan without collisions "
                "(--no-collisions)."
            )
    return meshes[shape.mesh]


def _clusters(urdf: Urdf, joints: Iterable[UrdfJoint]) -> dict[str, str]:
    """For each link the one that stands for all that these joints hold together."""
    up = {joint.child: joint.parent for joint in joints}

    def top(link: str) -> str:
        return top(up[link]) if link in up else link

    return {link: top(link) for link in urdf.links}


def _mounting_plane(
    robot: Robot, links: Sequence[Solid], rigid: Mapping[str, str], configuration: Array
) -> Solid:
    """All below z = 0 of the base (of the root, where the base moves), or of the lowest link that stands with it."""
    base = robot.urdf.root if robot.base_moves else robot.base
    model = full_model(robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration)
    T_base_root = data.oMf[link_frame(model, base)].inverse()
    ground, height = hppfcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), 0.0
    for part in links:
        if rigid[part.link] != rigid[base]:
            continue
        T = T_base_root * data.oMf[link_frame(model, part.link)] * pin.SE3(part.T_link_shape)
        if isinstance(part.geometry, hppfcl.BVHModelBase):
            low = np.min(part.geometry.vertices() @ T.rotation[2] + T.translation[2])
        else:
            asked, answer = hppfcl.DistanceRequest(), hppfcl.DistanceResult()
            placed = hppfcl.Transform3s(T.rotation, T.translation)
            unmoved = hppfcl.Transform3s()
            low = hppfcl.distance(part.geometry, placed, ground, unmoved, asked, answer)
        height = min(height, float(low))
    T_base_ground = np.eye(4)
    T_base_ground[2, 3] = height - 0.5 * _GROUND
    name = f"the mounting plane (z = {1e3 * height + 0.0:.4g} mm of '{base}')"
    shape = hppfcl.Box(2.0 * _GROUND, 2.0 * _GROUND, _GROUND)
    return Solid(name, "plane", base, T_base_ground, shape)


def _chosen_pairs(
    urdf: Urdf,
    scene: _Scene,
    parts: Sequence[Solid],
    rigid: Mapping[str, str],
    configurations: Array,
    clearance: float,
) -> tuple[_Scene, Names, dict[Code, list[str]]]:
    """The scene with the pairs to check, most often touching first; their names, and those of pairs as in `Code`."""
    moving = [joint for joint in urdf.joints if joint.type != "fixed"]
    welded = _clusters(urdf, (joint for joint in urdf.joints if joint.type == "fixed"))
    joined = {frozenset((welded[joint.parent], welded[joint.child])) for joint in moving}
    owned: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for i, j in itertools.combinations(range(len(parts)), 2):
        first, second = parts[i], parts[j]
        # One that stands around comes behind the other.
        if rigid[first.link] == rigid[second.link] or first.kind in ("box", "plane"):
            continue
        if (
            second.kind != "link"
            or frozenset((welded[first.link], welded[second.link])) not in joined
        ):
            owned.setdefault((first.owner, second.owner), []).append((i, j))
    flat = [pair for own in owned.values() for pair in own]
    touched = near = scene.comparing(flat, [0.0] * len(flat)).touched(configurations)
    if clearance > 0.0:
        near = scene.comparing(flat, [clearance] * len(flat)).touched(configurations)
    kept: list[tuple[int, tuple[int, int], float]] = []
    told: dict[Code, list[str]] = {"always_close": [], "always_touching": []}
    columns = iter(range(len(flat)))
    for names, pairs in owned.items():
        own = list(itertools.islice(columns, len(pairs)))
        always = touched[:, own].any(axis=1).mean() >= ALWAYS
        if always and parts[pairs[0][1]].kind != "box":
            told["always_touching"].append(" and ".join(names))
            continue
        too_close = not always and near[:, own].any(axis=1).mean() >= ALWAYS
        if too_close:
            told["always_close"].append(" and ".join(names))
        hits, margin = (touched, 0.0) if too_close else (near, clearance)
        kept += [(int(hits[:, k].sum()), flat[k], margin) for k in own]
    kept.sort(key=lambda one: -one[0])
    checked = dict.fromkeys((parts[i].owner, parts[j].owner) for _, (i, j), _ in kept)
    scene = scene.comparing([pair for _, pair, _ in kept], [margin for *_, margin in kept])
    return scene, tuple(checked), told
