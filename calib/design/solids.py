"""What is compared for collisions: shapes of links, of targets and their holders, of boxes, and the mounting plane.

A link has the coal geometries of its ``<collision>``, or else of its ``<visual>``. Of all pairs of shapes those are
compared that can tell poses apart.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.errors import CalibError, UrdfError, choices
from calib.robot.chain import full_model, link_frame
from calib.robot.meshes import LinkShape, find_mesh, link_shapes, load_mesh, mesh_folders
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, UrdfJoint

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Pair = tuple[int, int]

#: Poses over the joints' ranges at which it is found which pairs always touch, and the share of them that is always.
SAMPLES, ALWAYS = 256, 0.95

#: What stands for all below the mounting plane is a box so thick and twice as wide [m].
_GROUND = 20.0


class Kind(Enum):
    """What a shape is part of."""

    LINK = "link"
    TARGET = "target"
    BOX = "box"
    PLANE = "plane"


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """One shape of coal: whose it is, and where it is fixed, T_link_shape of shape (4, 4) [m]."""

    owner: str
    kind: Kind
    link: str
    T_link_shape: Array
    geometry: Any


def read_solids(
    urdf: Urdf, package_dirs: Iterable[str | Path] = ()
) -> tuple[list[Solid], tuple[str, ...], tuple[str, ...]]:
    """The geometry of every link; each mesh file is read once.

    ``package_dirs`` are the folders in which ``package://`` meshes are looked for before all others.

    Returns:
        The shapes; the links without collision geometry, whose visual geometry stands for it; and the links that carry
        a mass but have no geometry that can be used, or not all of it.
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
    solids, from_visuals, unchecked = [], [], []
    for link in urdf.links:
        proper, visual = ([one for one in shapes[tag] if one.link == link] for tag in shapes)
        found = [(one, _geometry(urdf, one, folders, meshes)) for one in proper or visual]
        usable = [
            Solid(link, Kind.LINK, link, one.T_link_shape, g) for one, g in found if g is not None
        ]
        if usable and not proper:
            from_visuals.append(link)
        if len(usable) < len(found) or (not found and link in bodies):
            unchecked.append(link)
        solids += usable
    if not solids:
        raise UrdfError(
            f"{urdf.source}: no link has a <collision> or <visual> with a geometry that can be used. Take a URDF with "
            "geometry, or plan without collisions (--no-collisions)."
        )
    return solids, tuple(from_visuals), tuple(unchecked)


def rod(start: Array, end: Array) -> tuple[pin.SE3, float]:
    """The pose of a rod between two points, shape (3,), [m]: z along it, origin in the middle; and half its length.

    One without length points along z.
    """
    along, up = end - start, np.array([0.0, 0.0, 1.0])
    turn = pin.Quaternion(up, along if along.any() else up)
    return pin.SE3(turn.matrix(), 0.5 * (start + end)), 0.5 * float(np.linalg.norm(along))


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
        if path is None:
            problem = (
                f"was not found in {choices(map(str, folders))}. Name its folder by --package-dir"
            )
        else:
            meshes[shape.mesh], problem = load_mesh(path, scale)
        if problem:
            raise UrdfError(
                f"{urdf.source}: link '{shape.link}': the mesh '{path or name}' {problem}; or plan without collisions "
                "(--no-collisions)."
            )
    return meshes[shape.mesh]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Shapes as Pinocchio has them, and of those that are compared the least distance of each pair [m]."""

    model: pin.Model
    shapes: pin.GeometryModel
    parts: tuple[Solid, ...]
    margins: tuple[float, ...] = ()

    @classmethod
    def of(cls, urdf: Urdf, parts: Sequence[Solid]) -> Scene:
        """All shapes, without pairs."""
        model, shapes = full_model(urdf), pin.GeometryModel()
        for k, part in enumerate(parts):
            frame, T = link_frame(model, part.link), part.T_link_shape
            parent = model.frames[frame]
            placement = parent.placement * pin.SE3(T[:3, :3], T[:3, 3])
            shapes.addGeometryObject(
                pin.GeometryObject(str(k), parent.parentJoint, frame, placement, part.geometry)
            )
        return cls(model, shapes, tuple(parts))

    def names(self, pair: Pair) -> tuple[str, str]:
        """What two shapes are part of."""
        return self.parts[pair[0]].owner, self.parts[pair[1]].owner

    def comparing(self, pairs: Sequence[Pair], margins: Sequence[float]) -> Scene:
        """The scene with these pairs of shapes, in this order, to compare."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        return Scene(self.model, shapes, self.parts, tuple(margins))

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

    def touches(self) -> Callable[[Array], bool]:
        """Whether any pair is closer than its margin at a configuration of the model, shape (nq,)."""
        data, found = self.room()
        return lambda one: bool(
            pin.computeCollisions(self.model, data, self.shapes, found, one, True)
        )

    def touched(self, configurations: Array) -> Mask:
        """Which pairs are closer than their margins, shape (N, pairs)."""
        data, found = self.room()
        result = np.zeros((len(configurations), len(self.margins)), dtype=np.bool_)
        for i, one in enumerate(configurations):
            pin.computeCollisions(self.model, data, self.shapes, found, one, False)
            result[i] = [answer.isCollision() for answer in found.collisionResults]
        return result


def clusters(urdf: Urdf, joints: Iterable[UrdfJoint]) -> dict[str, str]:
    """For each link the one that stands for all that these joints hold together."""
    up = {joint.child: joint.parent for joint in joints}

    def top(link: str) -> str:
        return top(up[link]) if link in up else link

    return {link: top(link) for link in urdf.links}


def mounting_plane(
    robot: Robot, links: Sequence[Solid], rigid: Mapping[str, str], configuration: Array
) -> Solid:
    """What the robot stands on: all below z = 0 of its base, or below the lowest link that stands with the base.

    Where joints of the chain move the base, it is the plane of the URDF's root.
    """
    base = robot.urdf.root if robot.base_moves else robot.base
    model = full_model(robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration)
    T_base_root = data.oMf[link_frame(model, base)].inverse()
    ground, height = hppfcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), 0.0
    for part in links:
        if rigid[part.link] != rigid[base]:
            continue
        T = T_base_root * data.oMf[link_frame(model, part.link)]
        T = T * pin.SE3(part.T_link_shape[:3, :3], part.T_link_shape[:3, 3])
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
    return Solid(name, Kind.PLANE, base, T_base_ground, shape)


class Pairs(NamedTuple):
    """The scene with the pairs that can tell poses apart, those always too close, and those left out for touching."""

    scene: Scene
    checked: tuple[tuple[str, str], ...]
    close: tuple[tuple[str, str], ...]
    touching: tuple[tuple[str, str], ...]


def choose_pairs(
    robot: Robot, scene: Scene, rigid: Mapping[str, str], configurations: Array, clearance: float
) -> Pairs:
    """Pairs of shapes to compare, those that touch most often first; the scene's last shape is none of them.

    ``rigid`` is for each link what stands for all that never moves against it; ``configurations``, shape (SAMPLES, nq),
    are spread over the joints' ranges.
    """
    urdf, parts = robot.urdf, scene.parts
    welded = clusters(urdf, (joint for joint in urdf.joints if joint.type == "fixed"))
    joined = {
        frozenset((welded[joint.parent], welded[joint.child]))
        for joint in urdf.joints
        if joint.type != "fixed"
    }
    touching = []
    flat: list[Pair] = []
    for i, j in itertools.combinations(range(len(parts) - 1), 2):
        first, second = parts[i], parts[j]
        # One that stands around comes behind the other.
        if rigid[first.link] == rigid[second.link] or first.kind not in (Kind.LINK, Kind.TARGET):
            continue
        links = second.kind is Kind.LINK
        if not links or frozenset((welded[first.link], welded[second.link])) not in joined:
            flat.append((i, j))
    touched = near = scene.comparing(flat, [0.0] * len(flat)).touched(configurations)
    if clearance > 0.0:
        near = scene.comparing(flat, [clearance] * len(flat)).touched(configurations)
    _check_around(robot, scene, rigid, flat, touched, near)
    owned: dict[tuple[str, str], list[int]] = {}
    for k, pair in enumerate(flat):
        owned.setdefault(scene.names(pair), []).append(k)
    kept: list[tuple[int, Pair, float]] = []
    close = []
    for names, own in owned.items():
        share = touched[:, own].any(axis=1).mean()
        if share >= ALWAYS and parts[flat[own[0]][1]].kind is not Kind.BOX:
            touching.append(names)
            continue
        too_close = share < ALWAYS and near[:, own].any(axis=1).mean() >= ALWAYS
        if too_close:
            close.append(names)
        hits, margin = (touched, 0.0) if too_close else (near, clearance)
        kept += [(int(hits[:, k].sum()), flat[k], margin) for k in own]
    kept.sort(key=lambda one: -one[0])
    checked = tuple(dict.fromkeys(scene.names(pair) for _, pair, _ in kept))
    scene = scene.comparing([pair for _, pair, _ in kept], [margin for *_, margin in kept])
    return Pairs(scene, checked, tuple(close), tuple(touching))


def _check_around(
    robot: Robot,
    scene: Scene,
    rigid: Mapping[str, str],
    pairs: Sequence[Pair],
    touched: Mask,
    near: Mask,
) -> None:
    """Refuse a box that the robot touches wherever it goes, and a plane that its tip never leaves."""
    parts = scene.parts
    for j, part in enumerate(parts):
        own = [k for k, pair in enumerate(pairs) if pair[1] == j]
        if part.kind is Kind.BOX and own and near[:, own].any(axis=1).all():
            most = parts[pairs[max(own, key=lambda k: int(near[:, k].sum()))][0]].owner
            raise CalibError(
                f"The box '{part.owner}' touches the robot at all of {SAMPLES} poses over the joints' ranges, '{most}' "
                "most often. Move it, make it smaller, or leave it out."
            )
        held = [k for k in own if rigid[parts[pairs[k][0]].link] == rigid[robot.tip]]
        if part.kind is Kind.PLANE and held and touched[:, held].any(axis=1).mean() >= ALWAYS:
            raise CalibError(
                f"What the tip '{robot.tip}' carries is below {part.owner} wherever the robot goes: the robot is not "
                "mounted there. Leave the plane out (--no-floor), and give what stands around as boxes."
            )
