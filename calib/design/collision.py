"""Collisions of a robot and what it holds, with itself and its surroundings.

Pinocchio places the shapes, coal compares them.

The whole robot is checked, not the chain alone. Below the mounting plane nothing may come, and boxes are not touched.
What cannot tell poses apart is left out: links that a joint connects, links that never move against each other, and
pairs that touch at any joint values. Of meshes the surfaces are compared: one that lies wholly inside another mesh is
not found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pinocchio import hppfcl

from calib.data.cell import Box
from calib.design.notes import Code, Note
from calib.design.solids import (
    Solid,
    box_solids,
    clusters,
    mounting_plane,
    read_solids,
    rods,
    target_solids,
)
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.units import Array, Mask

Names = tuple[tuple[str, str], ...]

#: Largest step along a path of a joint that turns [rad].
TURN_STEP = math.radians(2.0)

#: Largest step along a path of a joint that slides [m].
SLIDE_STEP = 5e-3

#: Thickness of a tracker's beam [m].
BEAM = 0.010

#: How far in front of the target the beam ends: the reflector's nest does not count [m].
NEST = 0.030

#: Poses over the joints' ranges at which pairs that always touch are looked for.
SAMPLES = 256

#: Pairs that touch at this share of them always touch.
ALWAYS = 0.95


@dataclass(frozen=True, slots=True)
class CollisionCheck:
    """Extent and clearance of a check for collisions."""

    #: Least distance of all that is checked [m].
    clearance: float = 0.0
    #: Whether nothing may come below the mounting plane: z = 0 of the base, or the lowest link that is fixed to the
    #: base where that is lower.
    floor: bool = True
    #: A target and what holds it are a rod of this radius from the tip to the target [m].
    #: A 1.5 inch reflector has 19 mm
    holder_radius: float = 0.020
    #: Folders in which ``package://`` meshes are looked for before all others.
    package_dirs: tuple[str | Path, ...] = ()


class _Scene(NamedTuple):
    """Shapes, and pairs of them to compare, as Pinocchio has them."""

    #: The whole robot
    model: pin.Model
    shapes: pin.GeometryModel
    #: Least distance of each pair [m]
    margins: Sequence[float] = ()

    @classmethod
    def of(cls, urdf: Urdf, solids: Iterable[Solid]) -> _Scene:
        """Return the scene of solids, without pairs."""
        model, shapes = full_model(urdf), pin.GeometryModel()
        for k, solid in enumerate(solids):
            frame = link_frame(model, solid.link)
            parent = model.frames[frame]
            placement = parent.placement * pin.SE3(solid.T_link_shape)
            shapes.addGeometryObject(
                pin.GeometryObject(str(k), parent.parentJoint, frame, placement, solid.geometry)
            )
        return cls(model, shapes)

    def comparing(self, pairs: Iterable[tuple[int, int]], margins: Sequence[float]) -> _Scene:
        """Return the scene with pairs of shapes, by their numbers, and the least distance of each [m]."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        return _Scene(self.model, shapes, margins)

    def workspace(self) -> tuple[pin.Data, pin.GeometryData]:
        """Return memory for the results of one caller."""
        geometry_data = self.shapes.createData()
        for request, margin in zip(geometry_data.collisionRequests, self.margins, strict=True):
            request.security_margin = margin
            # Without it coal 3.0 misses some simple shapes that are deep in each other, such as a capsule in a box.
            request.enable_contact = True
            # How far bounding volumes are followed beyond the margin: 1 mm by default, a third of the time.
            request.break_distance = 1e-6
        return self.model.createData(), geometry_data

    def touches(self, configurations: Array) -> Iterator[bool]:
        """Yield whether any pair is closer than its margin, at each configuration of the model, (N, nq)."""
        data, geometry_data = self.workspace()
        for configuration in configurations:
            yield bool(
                pin.computeCollisions(
                    self.model, data, self.shapes, geometry_data, configuration, True
                )
            )

    def touched(self, configurations: Array) -> Mask:
        """Return which pairs are closer than their margins, shape (N, pairs), at configurations (N, nq)."""
        data, geometry_data = self.workspace()
        touched = []
        for configuration in configurations:
            pin.computeCollisions(
                self.model, data, self.shapes, geometry_data, configuration, False
            )
            touched.append([result.isCollision() for result in geometry_data.collisionResults])
        return np.array(touched, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CollisionModel:
    """A robot and boxes around it, with the pairs of shapes that are compared."""

    #: The robot.
    robot: Robot
    #: Names of the pairs that are checked (links, targets, boxes, the plane), those that touch most often first.
    pairs: Names
    #: What was checked, and what was not as a person might expect.
    notes: tuple[Note, ...]
    _scene: _Scene
    #: The last shape, a beam, with links and boxes
    _beams: _Scene

    @classmethod
    def of(
        cls,
        robot: Robot,
        boxes: Iterable[Box] = (),
        targets: Mapping[str, ArrayLike] | None = None,
        check: CollisionCheck | None = None,
    ) -> CollisionModel:
        """Read the geometry of a robot and find the pairs that have to be checked.

        Args:
            robot: The robot.
            boxes: In the robot's base.
            targets: Places in the tip by name, shape (3,), [m]; None: none.
            check: Extent and clearance; None: the default.

        Raises:
            UrdfError: See `calib.design.solids.read_solids`.
        """
        check = check or CollisionCheck()
        links, unchecked = read_solids(robot.urdf, check.package_dirs)
        solids = [
            *links,
            *target_solids(robot, targets or {}, check.holder_radius),
            *box_solids(robot, boxes),
        ]
        values = robot.urdf_values(spread_poses(robot, SAMPLES))
        configurations = full_configurations(full_model(robot.urdf), values)
        moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
        still = (joint for joint in robot.urdf.joints if joint.name not in moving)
        rigid = clusters(robot.urdf, still)
        if check.floor:
            solids.append(mounting_plane(robot, links, rigid, configurations[0]))
        beam = Solid("the beam", "box", robot.base, np.eye(4), hppfcl.Capsule(0.5 * BEAM, 1.0))
        scene = _Scene.of(robot.urdf, (*solids, beam))
        chosen = _choose_pairs(robot.urdf, scene, solids, rigid, configurations, check.clearance)
        return cls(
            robot=robot,
            pairs=chosen.names,
            notes=_notes(solids, check, unchecked, chosen),
            _scene=scene.comparing(chosen.pairs, chosen.margins),
            _beams=_beam_scene(scene, solids),
        )

    def free(self, q: ArrayLike) -> Mask:
        """Test where the robot keeps clear.

        Args:
            q: shape (N, m) or (m,), [rad] or [m].

        Returns:
            shape (N,).
        """
        touches = self._scene.touches(self._configurations(q))
        return ~np.fromiter(touches, dtype=np.bool_)

    def path_free(self, q_from: ArrayLike, q_to: ArrayLike) -> bool:
        """Test whether the straight way in joint space between two poses is free, both ends among it.

        It is checked at equal steps of at most `TURN_STEP` and `SLIDE_STEP`; the middle first, then the quarters.

        Args:
            q_from: shape (m,), [rad] or [m].
            q_to: shape (m,).
        """
        ends = np.array([q_from, q_to], dtype=np.float64)
        sliding = {joint.name for joint in self.robot.urdf.joints if joint.type == "prismatic"}
        steps = []
        for name, (first, last) in self.robot.urdf_values(ends).items():
            step = SLIDE_STEP if name in sliding else TURN_STEP
            steps.append(abs(float(last - first)) / step)
        count = max(math.ceil(max(steps)), 1)
        # The lowest bit of an index says how coarse a division it belongs to; index 0 is in the coarsest.
        coarse_first = sorted(range(count + 1), key=lambda i: -(i & -i or count + 1))
        share = np.array(coarse_first)[:, None] / count
        way = self._configurations((1.0 - share) * ends[0] + share * ends[1])
        return not any(self._scene.touches(way))

    def beam_free(self, T_tip_target: Array, tracker: Array, q: Array) -> Mask:
        """Test whether no link and no box is in the beam from a tracker to the target.

        The beam is a rod of thickness `BEAM` that ends `NEST` in front of the target. Targets and the mounting plane,
        which are assumed and not known, do not count.

        Args:
            T_tip_target: Pose of the target in the tip, shape (4, 4), [m].
            tracker: Its position in the robot's base, shape (3,), [m].
            q: shape (N, m), [rad] or [m].

        Returns:
            shape (N,).
        """
        points = (self.robot.poses(q) @ T_tip_target)[:, :3, 3]
        distance = np.linalg.norm(tracker - points, axis=1)
        # The rod's round ends lie between the same two planes as the beam's flat ones.
        away = (tracker - points) / np.maximum(distance, BEAM)[:, None]
        ends = points + (NEST + 0.5 * BEAM) * away
        T_base_beam, half_length = rods(tracker - 0.5 * BEAM * away, ends)
        has_beam = distance > NEST + BEAM
        return self._beams_free(q, T_base_beam, half_length, has_beam)

    def _beams_free(self, q: Array, T_base_beam: Array, half_length: Array, has_beam: Mask) -> Mask:
        """Test whether no link and no box touches a beam at each pose, shape (N,).

        Args:
            q: shape (N, m), [rad] or [m].
            T_base_beam: Pose of each beam's middle, z along it, shape (N, 4, 4), [m].
            half_length: Of each, shape (N,), [m].
            has_beam: Where there is one, shape (N,).
        """
        scene = self._beams
        data, geometry_data = scene.workspace()
        base = scene.model.frames[link_frame(scene.model, self.robot.base)]
        last = scene.shapes.ngeoms - 1
        beam = scene.shapes.geometryObjects[last].geometry
        configurations = self._configurations(q)
        is_free = np.ones(len(q), dtype=np.bool_)
        for i in np.flatnonzero(has_beam).tolist():
            beam.halfLength = half_length[i]
            pin.updateGeometryPlacements(
                scene.model, data, scene.shapes, geometry_data, configurations[i]
            )
            T_root_base = data.oMi[base.parentJoint] * base.placement
            geometry_data.oMg[last] = T_root_base * pin.SE3(T_base_beam[i])
            is_free[i] = not pin.computeCollisions(scene.shapes, geometry_data, True)
        return is_free

    def _configurations(self, q: ArrayLike) -> Array:
        """Return Pinocchio's configurations of the whole robot, shape (N, nq)."""
        return full_configurations(self._scene.model, self.robot.urdf_values(q))


def _beam_scene(scene: _Scene, solids: Sequence[Solid]) -> _Scene:
    """Return the scene with the pairs of the beam, its last shape, and links and boxes."""
    beam = len(solids)
    others = [k for k, solid in enumerate(solids) if solid.kind in ("link", "box")]
    return scene.comparing([(k, beam) for k in others], [0.0] * len(others))


class _ChosenPairs(NamedTuple):
    """Pairs of shapes to check."""

    #: Numbers of the shapes, those that touch most often first
    pairs: list[tuple[int, int]]
    #: Least distance of each [m]
    margins: list[float]
    #: Of their owners, each pair of these once
    names: Names
    #: Owners that are always closer than the clearance, and refused only where they touch
    always_close: list[str]
    #: Owners that always touch, and are not checked
    always_touching: list[str]


def _choose_pairs(
    urdf: Urdf,
    scene: _Scene,
    solids: Sequence[Solid],
    rigid: Mapping[str, str],
    configurations: Array,
    clearance: float,
) -> _ChosenPairs:
    """Choose the pairs of shapes that can tell poses apart.

    Args:
        urdf: The URDF.
        scene: The shapes.
        solids: The same, with their owners.
        rigid: For each link the topmost one of those that never move against it.
        configurations: Pinocchio's, spread over the joints' ranges, shape (N, nq).
        clearance: Least distance [m].
    """
    always_close, always_touching = [], []
    kept: list[_Pair] = []
    for owners, pairs in _pairs_by_owners(urdf, solids, rigid).items():
        touched = _touched(scene, pairs, 0.0, configurations)
        always_touches = touched.any(axis=1).mean() >= ALWAYS
        is_box = solids[pairs[0][1]].kind == "box"
        if always_touches and not is_box:
            always_touching.append(" and ".join(owners))
            continue
        hits, margin = _touched(scene, pairs, clearance, configurations), clearance
        if not always_touches and hits.any(axis=1).mean() >= ALWAYS:
            always_close.append(" and ".join(owners))
            hits, margin = touched, 0.0
        for shapes, times in zip(pairs, hits.sum(axis=0).tolist(), strict=True):
            kept.append(_Pair(shapes, margin, times))
    kept.sort(key=lambda pair: -pair.times)
    names = dict.fromkeys(
        (solids[first].owner, solids[second].owner) for (first, second), *_ in kept
    )
    return _ChosenPairs(
        pairs=[pair.shapes for pair in kept],
        margins=[pair.margin for pair in kept],
        names=tuple(names),
        always_close=always_close,
        always_touching=always_touching,
    )


class _Pair(NamedTuple):
    """Two shapes to compare."""

    #: Their numbers
    shapes: tuple[int, int]
    #: Their least distance [m]
    margin: float
    #: Number of configurations at which they are closer
    times: int


def _touched(
    scene: _Scene, pairs: Sequence[tuple[int, int]], margin: float, configurations: Array
) -> Mask:
    """Return which pairs of shapes are closer than a margin [m] at configurations (N, nq), shape (N, pairs)."""
    return scene.comparing(pairs, [margin] * len(pairs)).touched(configurations)


def _pairs_by_owners(
    urdf: Urdf, solids: Sequence[Solid], rigid: Mapping[str, str]
) -> dict[tuple[str, str], list[tuple[int, int]]]:
    """Return the pairs of shapes whose links move against each other and are not connected by a joint.

    Args:
        urdf: The URDF.
        solids: The shapes; boxes and plane come behind links and targets.
        rigid: For each link the topmost one of those that never move against it.

    Returns:
        Numbers of the shapes, by the names of their owners.
    """
    fixed = (joint for joint in urdf.joints if joint.type == "fixed")
    welded = clusters(urdf, fixed)
    moving = [joint for joint in urdf.joints if joint.type != "fixed"]
    joined = {frozenset((welded[joint.parent], welded[joint.child])) for joint in moving}
    by_owners: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for i, j in itertools.combinations(range(len(solids)), 2):
        first, second = solids[i], solids[j]
        # A box or the plane comes second; two of them are not compared.
        if rigid[first.link] == rigid[second.link] or first.kind in ("box", "plane"):
            continue
        links = frozenset((welded[first.link], welded[second.link]))
        if second.kind == "link" and links in joined:
            continue
        by_owners.setdefault((first.owner, second.owner), []).append((i, j))
    return by_owners


def _notes(
    solids: Sequence[Solid], check: CollisionCheck, unchecked: list[str], chosen: _ChosenPairs
) -> tuple[Note, ...]:
    """Return remarks on what was checked, and what was not."""
    around = [solid.owner for solid in solids if solid.kind in ("box", "plane")]
    notes = [Note("collisions_checked", (check.holder_radius, *around))]
    names_by_code: dict[Code, list[str]] = {
        "no_geometry": unchecked,
        "always_close": chosen.always_close,
        "always_touching": chosen.always_touching,
    }
    for code, names in names_by_code.items():
        if names:
            notes.append(Note(code, tuple(names)))
    return tuple(notes)
