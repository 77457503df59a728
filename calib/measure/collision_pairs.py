"""Which links of a robot, and which boxes around it, have to be compared to find its collisions."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pinocchio import hppfcl

from calib.errors import CalibError, choices
from calib.measure.solid import Solid
from calib.measure.surroundings import Box
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
    """The robot's links and the boxes as Pinocchio has them.

    Attributes:
        model: All joints of the URDF.
        shapes: The geometry on them, and the pairs of shapes that are checked.
        owners: For each shape the name of its link or box.
        margins: For each pair the least distance [m].
    """

    model: pin.Model
    shapes: pin.GeometryModel
    owners: tuple[str, ...]
    margins: tuple[float, ...]

    @classmethod
    def of(cls, robot: Robot, solids: Iterable[Solid], boxes: Sequence[Box]) -> Scene:
        """All shapes, without pairs."""
        model, shapes = full_model(robot.urdf), pin.GeometryModel()
        placed = [(s.link, s.link, s.T_link_shape, s.geometry) for s in solids]
        placed += [(box.name, robot.base, box.T_base_box, hppfcl.Box(*box.size)) for box in boxes]
        for k, (_, link, T, geometry) in enumerate(placed):
            frame = link_frame(model, link)
            parent = model.frames[frame]
            placement = parent.placement * pin.SE3(T[:3, :3], T[:3, 3])
            shapes.addGeometryObject(
                pin.GeometryObject(str(k), parent.parentJoint, frame, placement, geometry)
            )
        return cls(model, shapes, tuple(owner for owner, *_ in placed), ())

    def checking(self, pairs: Sequence[tuple[int, int]], margins: Sequence[float]) -> Scene:
        """The scene with these pairs of shapes, in this order, to check."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        return Scene(self.model, shapes, self.owners, tuple(margins))

    def with_shape(self, geometry: Any) -> pin.GeometryModel:  # noqa: ANN401  coal has no types
        """The shapes and one more behind them, checked against all of them and nothing else."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        count = len(self.owners)
        shapes.addGeometryObject(pin.GeometryObject("beam", 0, 0, pin.SE3.Identity(), geometry))
        for k in range(count):
            shapes.addCollisionPair(pin.CollisionPair(k, count))
        return shapes

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
    """The pairs that are checked; see `calib.measure.collision.CollisionModel`."""

    scene: Scene
    pairs: tuple[tuple[str, str], ...]
    ignored: tuple[Ignored, ...]
    close: tuple[tuple[str, str], ...]


def choose_pairs(robot: Robot, scene: Scene, boxes: Sequence[Box], clearance: float) -> Chosen:
    """The pairs that can tell poses apart, those that touch most often first.

    Args:
        robot: The robot.
        scene: Its links and the boxes, without pairs.
        boxes: The same boxes.
        clearance: [m].

    Raises:
        CalibError: A box holds the whole base, or touches moving links wherever the robot goes.
    """
    values = robot.urdf_values(spread_poses(robot, SAMPLES))
    configurations = full_configurations(scene.model, values)
    moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
    rigid = _clusters(robot.urdf, [j for j in robot.urdf.joints if j.name not in moving])
    standing = {link for link in robot.urdf.links if rigid[link] == rigid[robot.base]}
    for box in boxes:
        _check_base(robot, scene, box, standing, configurations[0])

    candidates, ignored = _candidates(robot.urdf, scene, boxes, rigid, standing)
    ignored += _resting(scene, boxes, standing, configurations[:1])
    flat = [shapes for pair in candidates.values() for shapes in pair]
    owner = np.repeat(np.arange(len(candidates)), [len(pair) for pair in candidates.values()])
    touched = _touched(scene, flat, configurations, 0.0)
    near = touched if clearance == 0.0 else _touched(scene, flat, configurations, clearance)

    box_names = {box.name for box in boxes}
    kept: list[tuple[int, int]] = []
    margins: list[float] = []
    hits: list[Mask] = []
    close = []
    for k, pair in enumerate(candidates):
        own = np.flatnonzero(owner == k)
        always = touched[:, own].any(axis=1).mean() >= ALWAYS
        if always and not box_names & set(pair):
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
        hits += list((touched if too_close else near)[:, own].T)

    counted = [int(hit.sum()) for hit in hits]
    order = sorted(range(len(kept)), key=lambda i: -counted[i])
    for box in boxes:
        _check_box(robot, scene, box, kept, hits)
    names = [(scene.owners[kept[i][0]], scene.owners[kept[i][1]]) for i in order]
    return Chosen(
        scene=scene.checking([kept[i] for i in order], [margins[i] for i in order]),
        pairs=tuple(dict.fromkeys(names)),
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
    urdf: Urdf,
    scene: Scene,
    boxes: Sequence[Box],
    rigid: Mapping[str, str],
    standing: Collection[str],
) -> tuple[dict[tuple[str, str], list[tuple[int, int]]], list[Ignored]]:
    """The pairs of names that may touch, each with its pairs of shapes, and the links that a joint joins."""
    welded = _clusters(urdf, [joint for joint in urdf.joints if joint.type == "fixed"])
    joined = {
        frozenset((welded[joint.parent], welded[joint.child]))
        for joint in urdf.joints
        if joint.type != "fixed"
    }
    box_names = {box.name for box in boxes}
    candidates: dict[tuple[str, str], list[tuple[int, int]]] = {}
    ignored: dict[tuple[str, str], Ignored] = {}
    for i, j in itertools.combinations(range(len(scene.owners)), 2):
        pair = first, second = scene.owners[i], scene.owners[j]
        if second in box_names:  # boxes stand behind the links
            apart = first not in box_names and first not in standing
        elif rigid[first] == rigid[second]:
            apart = False
        else:
            apart = frozenset((welded[first], welded[second])) not in joined
            if not apart:
                ignored[pair] = Ignored(*pair, "a joint joins them")
        if apart:
            candidates.setdefault(pair, []).append((i, j))
    return candidates, list(ignored.values())


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


def _resting(
    scene: Scene, boxes: Sequence[Box], standing: Collection[str], configurations: Array
) -> list[Ignored]:
    """The boxes and links that touch, and of which none moves: a table and the base that stands on it."""
    box_names = {box.name for box in boxes}
    pairs = [
        (i, j)
        for i, j in itertools.combinations(range(len(scene.owners)), 2)
        if scene.owners[j] in box_names and scene.owners[i] in standing
    ]
    (touched,) = _touched(scene, pairs, configurations, 0.0)
    names = [
        (scene.owners[i], scene.owners[j])
        for (i, j), hit in zip(pairs, touched, strict=True)
        if hit
    ]
    return [Ignored(*pair, "touching, and neither moves") for pair in dict.fromkeys(names)]


def _check_base(
    robot: Robot, scene: Scene, box: Box, standing: Collection[str], configuration: Array
) -> None:
    """Refuse a box that holds all of the robot that does not move.

    Raises:
        CalibError: It does.
    """
    data, found = scene.model.createData(), scene.shapes.createData()
    pin.updateGeometryPlacements(scene.model, data, scene.shapes, found, configuration)
    own = scene.owners.index(box.name)
    T_box_root = rigid_inverse(found.oMg[own].homogeneous)
    inside = []
    for k, owner in enumerate(scene.owners):
        if owner in standing:
            bounds = scene.shapes.geometryObjects[k].geometry
            bounds.computeLocalAABB()
            low, high = np.ravel(bounds.aabb_local.min_), np.ravel(bounds.aabb_local.max_)
            corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
            T = T_box_root @ found.oMg[k].homogeneous
            inside.append(bool((np.abs(corners @ T[:3, :3].T + T[:3, 3]) <= 0.5 * box.size).all()))
    if inside and all(inside):
        links = choices(dict.fromkeys(owner for owner in scene.owners if owner in standing))
        message = f"The box '{box.name}' swallows the robot: all of its base ({links}) is inside. {_where(robot, box)}"
        raise CalibError(message)


def _check_box(
    robot: Robot,
    scene: Scene,
    box: Box,
    pairs: Sequence[tuple[int, int]],
    hits: Sequence[Mask],
) -> None:
    """Refuse a box that moving links touch wherever the robot goes.

    Raises:
        CalibError: They do.
    """
    own = [k for k, (_, j) in enumerate(pairs) if scene.owners[j] == box.name]
    if own and np.any([hits[k] for k in own], axis=0).all():
        most = max(own, key=lambda k: int(hits[k].sum()))
        message = (
            f"The box '{box.name}' swallows the robot: it touches moving links at all of {SAMPLES} poses over the "
            f"joints' ranges, '{scene.owners[pairs[most][0]]}' most often. {_where(robot, box)}"
        )
        raise CalibError(message)


def _where(robot: Robot, box: Box) -> str:
    """Where a box stands and how large it is, and what to do."""
    size, centre = (" x ".join(f"{1e3 * v:g}" for v in box.size), 1e3 * box.T_base_box[:3, 3])
    x, y, z = (f"{v:g}" for v in centre)
    return (
        f"It measures {size} mm about the point ({x}, {y}, {z}) mm of the base '{robot.base}'; move it, make it "
        "smaller, or leave it out."
    )
