"""Which links of a robot, targets on its tip and boxes around it have to be compared to find its collisions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.design.solids import Kind, Solid
from calib.errors import CalibError, choices
from calib.model.chain import full_configurations, full_model, link_frame
from calib.model.readback import spread_poses
from calib.model.robot import Robot, rigid_inverse
from calib.model.urdf import Urdf, UrdfJoint

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Poses over the joints' ranges at which it is found which pairs always touch.
SAMPLES = 256

#: A pair that touches in this share of them touches by its construction.
ALWAYS = 0.95


@dataclass(frozen=True, slots=True)
class Ignored:
    """Two links, or a box and a link, that are not checked against each other, and why."""

    first: str
    second: str
    reason: str

    def __str__(self) -> str:
        """In words."""
        return f"'{self.first}' and '{self.second}': {self.reason}"


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The robot, its targets and what stands around as Pinocchio has them.

    Attributes:
        model: All joints of the URDF.
        shapes: The geometry on them, and the pairs of shapes that are checked.
        parts: What each shape is: the links', the targets', the boxes', hulls and plane.
        margins: For each pair the least distance [m].
    """

    model: pin.Model
    shapes: pin.GeometryModel
    parts: tuple[Solid, ...]
    margins: tuple[float, ...]

    @classmethod
    def of(cls, urdf: Urdf, parts: Sequence[Solid]) -> Scene:
        """All shapes, without pairs."""
        model, shapes = full_model(urdf), pin.GeometryModel()
        for k, part in enumerate(parts):
            frame = link_frame(model, part.link)
            parent = model.frames[frame]
            T = part.T_link_shape
            placement = parent.placement * pin.SE3(T[:3, :3], T[:3, 3])
            shapes.addGeometryObject(
                pin.GeometryObject(str(k), parent.parentJoint, frame, placement, part.geometry)
            )
        return cls(model, shapes, tuple(parts), ())

    def owners(self, pair: tuple[int, int]) -> tuple[str, str]:
        """The names of what two shapes are part of."""
        return self.parts[pair[0]].owner, self.parts[pair[1]].owner

    def checking(self, pairs: Sequence[tuple[int, int]], margins: Sequence[float]) -> Scene:
        """The scene with these pairs of shapes, in this order, to check."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        return Scene(self.model, shapes, self.parts, tuple(margins))

    def with_shape(self, geometry: Any) -> pin.GeometryModel:  # noqa: ANN401  coal has no types
        """The shapes and one more behind them, checked against links and boxes and nothing else."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        count = len(self.parts)
        shapes.addGeometryObject(pin.GeometryObject("beam", 0, 0, pin.SE3.Identity(), geometry))
        for k, part in enumerate(self.parts):
            if part.kind in (Kind.LINK, Kind.BOX):
                shapes.addCollisionPair(pin.CollisionPair(k, count))
        return shapes

    def touches(self) -> Callable[[Array], bool]:
        """Whether any pair is closer than its margin at a configuration of the model, shape (nq,)."""
        data, found = self.scratch()
        return lambda one: bool(
            pin.computeCollisions(self.model, data, self.shapes, found, one, True)
        )

    def scratch(self) -> tuple[pin.Data, pin.GeometryData]:
        """Room for the results of one caller, the margins set."""
        found = room_for(self.shapes)
        for request, margin in zip(found.collisionRequests, self.margins, strict=True):
            request.security_margin = margin
        return self.model.createData(), found


def room_for(shapes: pin.GeometryModel) -> pin.GeometryData:
    """Room for the results of one caller."""
    found = shapes.createData()
    for request in found.collisionRequests:
        # Without it coal 3.0 misses some simple shapes that are deep in each other, such as a capsule through a box.
        request.enable_contact = True
        # How far bounding volumes are followed beyond the margin: 1 mm by default, which costs a third of the time.
        request.break_distance = 1e-6
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """The pairs that are checked; see `calib.design.collision.CollisionModel`."""

    scene: Scene
    pairs: tuple[tuple[str, str], ...]
    ignored: tuple[Ignored, ...]
    close: tuple[tuple[str, str], ...]


def choose_pairs(robot: Robot, scene: Scene, clearance: float) -> Chosen:
    """The pairs that can tell poses apart, those that touch most often first.

    Args:
        robot: The robot.
        scene: All shapes, without pairs.
        clearance: [m].

    Raises:
        CalibError: A box or the mounting plane holds the whole base, or is touched wherever the robot goes.
    """
    values = robot.urdf_values(spread_poses(robot, SAMPLES))
    configurations = full_configurations(scene.model, values)
    moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
    rigid = _clusters(robot.urdf, [j for j in robot.urdf.joints if j.name not in moving])
    _check_base(robot, scene, rigid, configurations[0])

    candidates, ignored = _candidates(robot.urdf, scene, rigid)
    ignored += _resting(scene, rigid, configurations[:1])
    flat = [shapes for pair in candidates.values() for shapes in pair]
    owner = np.repeat(np.arange(len(candidates)), [len(pair) for pair in candidates.values()])
    touched = _touched(scene, flat, configurations, 0.0)
    near = touched if clearance == 0.0 else _touched(scene, flat, configurations, clearance)
    _check_touched(robot, scene, rigid, flat, touched, near)

    kept: list[tuple[int, int]] = []
    margins: list[float] = []
    hits: list[int] = []
    close = []
    for k, pair in enumerate(candidates):
        own = np.flatnonzero(owner == k)
        always = touched[:, own].any(axis=1).mean() >= ALWAYS
        if always and scene.parts[flat[own[0]][1]].kind is not Kind.BOX:
            count = np.count_nonzero(touched[:, own].any(axis=1))
            ignored.append(
                Ignored(*pair, f"touching at {count} of {SAMPLES} poses over the joints' ranges")
            )
            continue
        too_close = not always and near[:, own].any(axis=1).mean() >= ALWAYS
        if too_close:
            close.append(pair)
        kept += [flat[i] for i in own]
        margins += [0.0 if too_close else clearance] * len(own)
        hits += (touched if too_close else near)[:, own].sum(axis=0).tolist()

    order = sorted(range(len(kept)), key=lambda i: -hits[i])
    return Chosen(
        scene=scene.checking([kept[i] for i in order], [margins[i] for i in order]),
        pairs=tuple(dict.fromkeys(scene.owners(kept[i]) for i in order)),
        ignored=tuple(ignored),
        close=tuple(close),
    )


def _clusters(urdf: Urdf, joints: Iterable[UrdfJoint]) -> dict[str, str]:
    """For each link the one that stands for all that these joints hold together."""
    up = {joint.child: joint.parent for joint in joints}
    result = {}
    for link in urdf.links:
        top = link
        while top in up:
            top = up[top]
        result[link] = top
    return result


def _candidates(
    urdf: Urdf, scene: Scene, rigid: Mapping[str, str]
) -> tuple[dict[tuple[str, str], list[tuple[int, int]]], list[Ignored]]:
    """The pairs of names that may touch, each with its pairs of shapes, and the links that a joint joins."""
    welded = _clusters(urdf, [joint for joint in urdf.joints if joint.type == "fixed"])
    joined = {
        frozenset((welded[joint.parent], welded[joint.child]))
        for joint in urdf.joints
        if joint.type != "fixed"
    }
    candidates: dict[tuple[str, str], list[tuple[int, int]]] = {}
    ignored: dict[tuple[str, str], Ignored] = {}
    for i, j in itertools.combinations(range(len(scene.parts)), 2):
        first, second = scene.parts[i], scene.parts[j]
        pair = scene.owners((i, j))
        if rigid[first.link] == rigid[second.link] or not _comparable(first, second):
            continue
        links = first.kind is Kind.LINK and second.kind is Kind.LINK
        if links and frozenset((welded[first.link], welded[second.link])) in joined:
            ignored[pair] = Ignored(*pair, "a joint joins them")
        else:
            candidates.setdefault(pair, []).append((i, j))
    return candidates, list(ignored.values())


def _comparable(first: Solid, second: Solid) -> bool:
    """Whether two shapes have to do with each other; one that stands around comes behind the other."""
    if second.kind is Kind.PLANE:
        return first.kind is not Kind.BOX and not first.is_mesh
    return Kind.HULL not in (first.kind, second.kind) and first.kind is not Kind.BOX


def _touched(
    scene: Scene, pairs: Sequence[tuple[int, int]], configurations: Array, margin: float
) -> Mask:
    """Which pairs of shapes are closer than a margin, shape (N, pairs)."""
    checking = scene.checking(pairs, [margin] * len(pairs))
    data, found = checking.scratch()
    result = np.zeros((len(configurations), len(pairs)), dtype=np.bool_)
    for i, configuration in enumerate(configurations):
        pin.computeCollisions(scene.model, data, checking.shapes, found, configuration, False)
        result[i] = [one.isCollision() for one in found.collisionResults]
    return result


def _resting(scene: Scene, rigid: Mapping[str, str], configurations: Array) -> list[Ignored]:
    """The boxes and links that touch, and of which none moves: a table and the base that stands on it."""
    pairs = [
        (i, j)
        for i, j in itertools.combinations(range(len(scene.parts)), 2)
        if scene.parts[j].kind is Kind.BOX
        and _comparable(scene.parts[i], scene.parts[j])
        and rigid[scene.parts[i].link] == rigid[scene.parts[j].link]
    ]
    (touched,) = _touched(scene, pairs, configurations, 0.0)
    names = [scene.owners(pair) for pair, hit in zip(pairs, touched, strict=True) if hit]
    return [Ignored(*pair, "touching, and neither moves") for pair in dict.fromkeys(names)]


def _check_base(robot: Robot, scene: Scene, rigid: Mapping[str, str], configuration: Array) -> None:
    """Refuse a box that holds all of the robot that does not move.

    Raises:
        CalibError: It does.
    """
    data, found = scene.model.createData(), scene.shapes.createData()
    pin.updateGeometryPlacements(scene.model, data, scene.shapes, found, configuration)
    standing = [
        k
        for k, part in enumerate(scene.parts)
        if part.kind is Kind.LINK and rigid[part.link] == rigid[robot.base]
    ]
    for own, part in enumerate(scene.parts):
        if part.kind is not Kind.BOX or not standing:
            continue
        T_box_root = rigid_inverse(found.oMg[own].homogeneous)
        half = part.geometry.halfSide
        corners = [T_box_root @ found.oMg[k].homogeneous @ scene.parts[k].corners for k in standing]
        if all((np.abs(c[:3]) <= half[:, None]).all() for c in corners):
            links = choices(dict.fromkeys(scene.parts[k].owner for k in standing))
            raise CalibError(
                f"The box '{part.owner}' swallows the robot: all of its base ({links}) is inside. "
                f"{_where(robot, part)}"
            )


def _check_touched(
    robot: Robot,
    scene: Scene,
    rigid: Mapping[str, str],
    pairs: Sequence[tuple[int, int]],
    touched: Mask,
    near: Mask,
) -> None:
    """Refuse a box that the robot touches wherever it goes, and a plane that its tip never leaves.

    Raises:
        CalibError: It does.
    """
    for j, part in enumerate(scene.parts):
        own = [k for k, pair in enumerate(pairs) if pair[1] == j]
        if part.kind is Kind.BOX and own and near[:, own].any(axis=1).all():
            most = max(own, key=lambda k: int(near[:, k].sum()))
            raise CalibError(
                f"The box '{part.owner}' swallows the robot: it touches moving links at all of {SAMPLES} poses over "
                f"the joints' ranges, '{scene.parts[pairs[most][0]].owner}' most often. {_where(robot, part)}"
            )
        held = [k for k in own if rigid[scene.parts[pairs[k][0]].link] == rigid[robot.tip]]
        if part.kind is Kind.PLANE and held and touched[:, held].any(axis=1).mean() >= ALWAYS:
            raise CalibError(
                f"What the tip '{robot.tip}' carries is below {part.owner} wherever the robot goes: the robot is not "
                "mounted there. Leave the plane out (--no-floor), and name what stands around as boxes."
            )


def mounting_plane(robot: Robot, links: Sequence[Solid]) -> list[Solid]:
    """What the robot stands on: all below z = 0 of its base, or below the lowest link that stands with the base.

    Where joints of the chain move the base, it is the plane of the URDF's root. Before the plane come the hulls of the
    links' meshes: a half-space touches a mesh where it touches its convex hull, and a hull has few corners.

    Args:
        robot: The robot.
        links: The shapes of its links.
    """
    base = robot.urdf.root if robot.base_moves else robot.base
    values = robot.urdf_values(spread_poses(robot, 2))
    moving = [name for name, value in values.items() if np.ptp(value) > 0.0]
    rigid = _clusters(robot.urdf, [j for j in robot.urdf.joints if j.name not in moving])
    hulls = [part.hull() for part in links if part.is_mesh]
    convex = [*hulls, *(part for part in links if not part.is_mesh)]
    standing = [part for part in convex if rigid[part.link] == rigid[base]]
    scene = Scene.of(robot.urdf, standing)
    data, found = scene.model.createData(), scene.shapes.createData()
    configuration = full_configurations(scene.model, values)[0]
    pin.updateGeometryPlacements(scene.model, data, scene.shapes, found, configuration)
    frame = scene.model.frames[link_frame(scene.model, base)]
    T_base_root = (data.oMi[frame.parentJoint] * frame.placement).inverse()
    plane = hppfcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    height = 0.0
    for part, T_root_shape in zip(standing, found.oMg, strict=True):
        T = T_base_root * T_root_shape
        asked, answer = hppfcl.DistanceRequest(), hppfcl.DistanceResult()
        placed = hppfcl.Transform3s(T.rotation, T.translation)
        low = hppfcl.distance(part.geometry, placed, plane, hppfcl.Transform3s(), asked, answer)
        height = min(height, float(low))
    T_base_plane = np.eye(4)
    T_base_plane[2, 3] = height
    name = f"the mounting plane (z = {1e3 * height + 0.0:.4g} mm of '{base}')"
    return [*hulls, Solid(name, Kind.PLANE, base, T_base_plane, plane)]


def _where(robot: Robot, part: Solid) -> str:
    """Where a box stands and how large it is, and what to do."""
    size = " x ".join(f"{2e3 * v:g}" for v in part.geometry.halfSide)
    x, y, z = (f"{1e3 * v:g}" for v in part.T_link_shape[:3, 3])
    return (
        f"It measures {size} mm about the point ({x}, {y}, {z}) mm of the base '{robot.base}'; move it, make it "
        "smaller, or leave it out."
    )
