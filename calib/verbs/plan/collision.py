"""Collisions of a robot and what it holds, with itself and its surroundings.

Pinocchio places the shapes, coal compares them.

The whole robot is checked, not just the chain. Nothing may go below the mounting plane or touch a box. Pairs that give
the same answer at every pose are left out: links that a joint connects, links that never move against each other, and
pairs that touch at almost all joint values. Only the surfaces of meshes are compared: a mesh that lies entirely inside
another one is not found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from pinocchio import hppfcl

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.jobs import core_count
from calib.data.cell import Box
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.plan.notes import Note
from calib.verbs.plan.solids import (
    Solid,
    box_solids,
    clusters,
    mounting_plane,
    read_solids,
    rods,
    target_solids,
)

Pair = tuple[int, int]
Names = tuple[tuple[str, str], ...]

#: Largest step of a revolute joint along a path [rad].
TURN_STEP = math.radians(2.0)

#: Largest step of a prismatic joint along a path [m].
SLIDE_STEP = 5e-3

#: Thickness of a tracker's beam [m].
BEAM = 0.010

#: Distance before the target at which the beam ends, so that it does not touch the reflector's nest [m].
NEST = 0.030

#: Number of poses, spread over the joints' ranges, at which pairs that always touch are looked for.
SAMPLES = 256

#: Owners with a pair that touches at this share of these poses, or more, always touch.
ALWAYS = 0.95


#: Configurations that Pinocchio compares in one call: a tenth of a second.
_BLOCK = 1024

#: The processor's cores that compare them; more hardly help, as each needs a copy of the robot.
_CORES = min(core_count(), 8)


@dataclass(frozen=True, slots=True)
class CollisionCheck:
    """Extent and clearance of a check for collisions."""

    #: Least distance of all that is checked [m].
    clearance: float = 0.0
    #: Whether nothing may go below the mounting plane: z = 0 of the base, or the lowest link that is fixed to the base
    #: if that is lower.
    floor: bool = True
    #: Radius of the rod from the tip to the target that stands for the target and what holds it [m]; a reflector of
    #: 1.5 inch has 19 mm.
    holder_radius: float = 0.020
    #: Folders in which ``package://`` meshes are looked for before all others.
    package_dirs: tuple[str | Path, ...] = ()


class _Scene(NamedTuple):
    """Shapes, and pairs of them to compare, as Pinocchio has them."""

    #: The whole robot.
    model: pin.Model
    #: The shapes, numbered from 0 in the order of the solids, and the pairs.
    shapes: pin.GeometryModel
    #: Least distance of each pair [m]: a pair that is closer counts as touching.
    margins: Sequence[float] = ()
    #: Pinocchio's memory for each of the processor's cores; None without pairs, and of a Pinocchio without OpenMP.
    pool: pin.GeometryPool | None = None

    @classmethod
    def of(cls, urdf: Urdf, solids: Iterable[Solid]) -> _Scene:
        """Build the scene of a whole robot and solids fixed to its links, in their order, without pairs to compare."""
        model = full_model(urdf)
        shapes = pin.GeometryModel()
        for number, solid in enumerate(solids):
            frame = link_frame(model, solid.link)
            parent = model.frames[frame]
            placement = parent.placement * pin.SE3(solid.T_link_shape)
            shape = pin.GeometryObject(
                str(number), parent.parentJoint, frame, placement, solid.geometry
            )
            shapes.addGeometryObject(shape)
        return cls(model, shapes)

    def comparing(self, pairs: Iterable[Pair], margins: Sequence[float]) -> _Scene:
        """Return the scene with other pairs of shapes, each with its least distance [m]; this one stays as it is."""
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        pool = None
        if hasattr(pin, "GeometryPool"):
            pool = pin.GeometryPool(self.model, shapes, _CORES)
            for core in range(_CORES):
                _set_margins(pool.getGeometryData(core), margins)
        return _Scene(self.model, shapes, margins, pool)

    def new_data(self) -> tuple[pin.Data, pin.GeometryData]:
        """Return new data for Pinocchio's results, of the model and of the shapes, with the margin of each pair set."""
        geometry_data = self.shapes.createData()
        _set_margins(geometry_data, self.margins)
        return self.model.createData(), geometry_data

    def touches(self, configurations: Array, *, first: bool = False) -> Mask:
        """Return at which configurations (N, nq) of the whole robot any pair is closer than its margin, (N,).

        With ``first`` no configuration after the first of these is compared; later ones may then be missing.
        """
        if self.pool is None:
            data, geometry_data = self.new_data()
            touching = [
                pin.computeCollisions(self.model, data, self.shapes, geometry_data, each, True)
                for each in configurations
            ]
            return np.array(touching, dtype=np.bool_)
        parts = [np.zeros(0, dtype=np.bool_)]
        # In blocks, so that the program can be interrupted; of a path at once, by one core.
        size = max(len(configurations), 1) if first else _BLOCK
        for start in range(0, len(configurations), size):
            block = np.asfortranarray(configurations[start : start + size].T)
            cores = 1 if first else _CORES
            part = pin.computeCollisionsInParallel(cores, self.pool, block, True, first)
            parts.append(part.astype(np.bool_))
        return np.concatenate(parts)

    def touched(self, configurations: Array) -> Mask:
        """Return which of the scene's P pairs are closer than their margins, (N, P), in the scene's order.

        Configurations (N, nq) are of the whole robot, as Pinocchio has them.
        """
        data, geometry_data = self.new_data()
        touched = []
        for configuration in configurations:
            pin.computeCollisions(
                self.model, data, self.shapes, geometry_data, configuration, False
            )
            touched.append([result.isCollision() for result in geometry_data.collisionResults])
        return np.array(touched, dtype=np.bool_)


def _set_margins(geometry_data: pin.GeometryData, margins: Sequence[float]) -> None:
    """Set the least distance [m] of each pair in new data of Pinocchio."""
    for request, margin in zip(geometry_data.collisionRequests, margins, strict=True):
        request.security_margin = margin
        # Without it coal 3.0 misses some simple shapes that are deep in each other, such as a capsule in a box.
        request.enable_contact = True
        # How far bounding volumes are followed beyond the margin; the default of 1 mm takes three times as long.
        request.break_distance = 1e-6


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CollisionModel:
    """A robot and boxes around it, with the pairs of shapes that are compared."""

    #: The robot.
    robot: Robot
    #: Names of the pairs that are checked (links, targets, boxes, the plane), those that touch most often first.
    pairs: Names
    #: Notes on what is checked, and on what is not although a person might expect it.
    notes: tuple[Note, ...]
    #: The pairs that are checked, with their least distances.
    _scene: _Scene
    #: Pairs of the beam, which is the last shape, with links and boxes.
    _beams: _Scene

    @classmethod
    def of(
        cls,
        robot: Robot,
        boxes: Iterable[Box] = (),
        targets: Mapping[str, ArrayLike] | None = None,
        check: CollisionCheck | None = None,
        attached: Iterable[Solid] = (),
    ) -> CollisionModel:
        """Read the geometry of a robot and find the pairs of shapes that have to be checked.

        Left out are pairs of links that a joint connects or that never move against each other, and those that touch at
        95 % or more of 256 poses spread over the joints' ranges, unless one is a box.

        Args:
            robot: The robot; all links of its URDF are checked, not just those of the chain.
            boxes: Obstacles, which are fixed to the robot's base.
            targets: Positions of targets in the tip by name, shape (3,), [m]: a rod from the tip's origin to each
                stands for the target and what holds it; None: none.
            check: Extent and clearance of the check; None: the defaults of `CollisionCheck`.
            attached: Further shapes, fixed to any link, of the kind ``"target"``; those of the kind ``"box"`` last.

        Raises:
            UrdfError: Pinocchio cannot read the URDF, a mesh is missing or cannot be read, or no link has a shape.
        """
        check = check or CollisionCheck()
        links, unchecked = read_solids(robot.urdf, check.package_dirs)
        solids = [
            *links,
            *target_solids(robot, targets or {}, check.holder_radius),
            *attached,
            *box_solids(robot, boxes),
        ]
        values = robot.urdf_values(spread_poses(robot, SAMPLES))
        configurations = full_configurations(full_model(robot.urdf), values)
        # Links that never move against each other: held, fixed and unnamed joints do not move.
        moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
        rigid = clusters(
            robot.urdf, [joint for joint in robot.urdf.joints if joint.name not in moving]
        )
        if check.floor:
            solids.append(mounting_plane(robot, links, rigid, configurations[0]))
        # The last shape is the beam of a tracker, whose length and pose are set for each test.
        beam = len(solids)
        rod = hppfcl.Capsule(0.5 * BEAM, 1.0)
        scene = _Scene.of(
            robot.urdf, (*solids, Solid("the beam", "box", robot.base, np.eye(4), rod))
        )

        by_owners = _pairs_by_owners(robot.urdf, solids, rigid)
        every = [pair for pairs in by_owners.values() for pair in pairs]

        # All pairs at once: placing the robot takes longer than comparing the pairs of two owners.
        number = {pair: k for k, pair in enumerate(every)}
        touches = {
            margin: scene.comparing(every, [margin] * len(every)).touched(configurations)
            for margin in {0.0, check.clearance}
        }

        def touched(pairs: Sequence[Pair], margin: float) -> Mask:
            """Return which pairs are closer than a margin [m] at the poses spread over the ranges."""
            return np.asarray(touches[margin][:, [number[pair] for pair in pairs]])

        kept: list[tuple[int, Pair, float]] = []  # at how many poses it touches, shapes, margin
        always_close, always_touching = [], []
        for owners, pairs in by_owners.items():
            is_box = solids[pairs[0][1]].kind == "box"
            margin, times = _choose_margin(touched, pairs, check.clearance, is_box=is_box)
            if margin is None:
                always_touching.append(" and ".join(owners))
                continue
            if margin < check.clearance:
                always_close.append(" and ".join(owners))
            kept += [(count, pair, margin) for count, pair in zip(times, pairs, strict=True)]
        kept.sort(key=lambda one: -one[0])
        chosen = [pair for _, pair, _ in kept]
        names = dict.fromkeys((solids[i].owner, solids[j].owner) for i, j in chosen)

        around = [solid.owner for solid in solids if solid.kind in ("box", "plane")]
        notes = [
            Note("collisions_checked", (check.holder_radius, *around)),
            Note("no_geometry", tuple(unchecked)),
            Note("always_close", tuple(always_close)),
            Note("always_touching", tuple(always_touching)),
        ]
        # Targets and the mounting plane, which are assumed, do not block a beam.
        in_beam = [(k, beam) for k, solid in enumerate(solids) if solid.kind in ("link", "box")]
        return cls(
            robot=robot,
            pairs=tuple(names),
            notes=tuple(note for note in notes if note.values),
            _scene=scene.comparing(chosen, [margin for _, _, margin in kept]),
            _beams=scene.comparing(in_beam, [0.0] * len(in_beam)),
        )

    def free(self, q: ArrayLike) -> Mask:
        """Test at which poses no pair of shapes is closer than its least distance.

        Args:
            q: Joint values of N poses, shape (N, m), or (m,) of one, [rad] or for sliding joints [m], columns as
                ``robot.joint_names``.

        Returns:
            True where the pose is free, shape (N,).
        """
        return ~self._scene.touches(self._configurations(q))

    def path_free(self, q_from: ArrayLike, q_to: ArrayLike) -> bool:
        """Test whether the straight move in joint space between two poses is free, both ends included.

        It is tested at equal steps in which no joint turns more than 2 deg or slides more than 5 mm. Coarse divisions
        of the move come before finer ones, so that a collision is met early.

        Args:
            q_from: Joint values of the pose to leave, shape (m,), [rad] or for sliding joints [m], in the order of
                ``robot.joint_names``.
            q_to: Joint values of the pose to reach, shape (m,).
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
        path = self._configurations((1.0 - share) * ends[0] + share * ends[1])
        return not self._scene.touches(path, first=True).any()

    def beam_free(self, T_tip_target: Array, tracker: Array, q: Array, ahead: float = 0.0) -> Mask:
        """Test at which poses no link and no box is in the beam from a tracker to the target.

        The beam is a rod from the tracker, 10 mm thick, that ends 30 mm before the target. Targets and the mounting
        plane, which are assumed, do not block it.

        Args:
            T_tip_target: Pose of the target in the tip, shape (4, 4), [m]; its orientation does not matter.
            tracker: Position of the tracker in the robot's base, shape (3,), [m].
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            ahead: Distance from the tracker at which the beam begins [m].

        Returns:
            True where the line of sight is free, shape (N,); also if the target is so near that there is no beam.
        """
        points = (self.robot.poses(q) @ T_tip_target)[:, :3, 3]
        distance = np.linalg.norm(tracker - points, axis=1)
        # The rod's round ends lie between the same two planes as the beam's flat ones.
        away = (tracker - points) / np.maximum(distance, BEAM)[:, None]
        ends = points + (NEST + 0.5 * BEAM) * away
        T_base_beam, half_length = rods(tracker - (ahead + 0.5 * BEAM) * away, ends)
        has_beam = distance > NEST + BEAM + ahead

        scene = self._beams
        data, geometry_data = scene.new_data()
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
        """Return Pinocchio's configurations (N, nq) of the whole robot at joint values (N, m), other joints at 0."""
        return full_configurations(self._scene.model, self.robot.urdf_values(q))


def _pairs_by_owners(
    urdf: Urdf, solids: Sequence[Solid], rigid: Mapping[str, str]
) -> dict[tuple[str, str], list[Pair]]:
    """Return the pairs of solids to check, as indices in their order, by the names of their two owners.

    Left out are solids whose links never move against each other, which have the same link in ``rigid``, see
    `clusters`; boxes and the mounting plane among themselves; and the shapes of links that one moving joint connects,
    with all that fixed joints hold to them, because these always touch near the joint.
    """
    fixed = [joint for joint in urdf.joints if joint.type == "fixed"]
    welded = clusters(urdf, fixed)
    moving = [joint for joint in urdf.joints if joint.type != "fixed"]
    joined = {frozenset((welded[joint.parent], welded[joint.child])) for joint in moving}
    by_owners: dict[tuple[str, str], list[Pair]] = {}
    for i, j in itertools.combinations(range(len(solids)), 2):
        first, second = solids[i], solids[j]
        # Boxes and the plane come last; they are not compared with each other.
        if rigid[first.link] == rigid[second.link] or first.kind in ("box", "plane"):
            continue
        links = frozenset((welded[first.link], welded[second.link]))
        if second.kind == "link" and links in joined:
            continue
        by_owners.setdefault((first.owner, second.owner), []).append((i, j))
    return by_owners


def _choose_margin(
    touched: Callable[[Sequence[Pair], float], Mask],
    pairs: Sequence[Pair],
    clearance: float,
    *,
    is_box: bool,
) -> tuple[float | None, Integers]:
    """Choose the least distance [m] of the P pairs of two owners, and count at how many sampled poses each is closer.

    The counts are (P,); ``touched`` returns which pairs are closer than a distance [m] at the sampled poses. The least
    distance is the clearance [m]. Owners that are always closer are checked for touching alone, and those that always
    touch are not checked (None), unless the second is a box, which must not be touched in any case.
    """
    touching = touched(pairs, 0.0)
    if _is_always(touching) and not is_box:
        return None, touching.sum(axis=0)
    close = touched(pairs, clearance)
    if _is_always(close) and not _is_always(touching):
        return 0.0, touching.sum(axis=0)
    return clearance, close.sum(axis=0)


def _is_always(touched: Mask) -> bool:
    """Return whether at `ALWAYS` of N poses or more any of P pairs touches, by a mask (N, P)."""
    return bool(touched.any(axis=1).mean() >= ALWAYS)
