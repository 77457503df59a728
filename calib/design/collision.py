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
from typing import Literal, NamedTuple

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
    #: A target and what holds it are a rod of this radius from the tip to the target [m]; a 1.5 inch reflector has
    #: 19 mm.
    holder_radius: float = 0.020
    #: Folders in which ``package://`` meshes are looked for before all others.
    package_dirs: tuple[str | Path, ...] = ()


class _Scene(NamedTuple):
    """Shapes, and pairs of them to compare, as Pinocchio has them."""

    #: The whole robot.
    model: pin.Model
    #: The shapes, numbered from 0 in the order of the solids, and the pairs.
    shapes: pin.GeometryModel
    #: Least distance of each pair [m].
    margins: Sequence[float] = ()

    @classmethod
    def of(cls, urdf: Urdf, solids: Iterable[Solid]) -> _Scene:
        """Return the scene of a robot's solids, without pairs.

        Args:
            urdf: The URDF of the whole robot.
            solids: Shapes, each with the link that it is fixed to and its pose there; the scene numbers them from 0.
        """
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

    def comparing(self, pairs: Iterable[tuple[int, int]], margins: Sequence[float]) -> _Scene:
        """Return the scene with other pairs of shapes to compare; this one stays as it is.

        Args:
            pairs: Numbers of two shapes each, from 0.
            margins: Least distance of each pair [m]: one that is closer counts as touching.
        """
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        return _Scene(self.model, shapes, margins)

    def workspace(self) -> tuple[pin.Data, pin.GeometryData]:
        """Return memory for Pinocchio's results of one caller: the robot's, and that of shapes with the margins set."""
        geometry_data = self.shapes.createData()
        for request, margin in zip(geometry_data.collisionRequests, self.margins, strict=True):
            request.security_margin = margin
            # Without it coal 3.0 misses some simple shapes that are deep in each other, such as a capsule in a box.
            request.enable_contact = True
            # How far bounding volumes are followed beyond the margin: 1 mm by default, a third of the time.
            request.break_distance = 1e-6
        return self.model.createData(), geometry_data

    def touches(self, configurations: Array) -> Iterator[bool]:
        """Test at each configuration whether any pair is closer than its margin, one configuration at a time.

        Args:
            configurations: Pinocchio's, of the whole robot, shape (N, nq).

        Yields:
            True where a pair is; N values.
        """
        data, geometry_data = self.workspace()
        for configuration in configurations:
            is_touching = pin.computeCollisions(
                self.model, data, self.shapes, geometry_data, configuration, True
            )
            yield bool(is_touching)

    def touched(self, configurations: Array) -> Mask:
        """Test which pairs are closer than their margins.

        Args:
            configurations: Pinocchio's, of the whole robot, shape (N, nq).

        Returns:
            True where a pair is, shape (N, pairs).
        """
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
    ) -> CollisionModel:
        """Read the geometry of a robot and find the pairs of shapes that have to be checked.

        Args:
            robot: The robot; all links of its URDF are checked, also those beside the chain from base to tip.
            boxes: Obstacles, each with the lengths of its edges and the pose of its centre in the robot's base [m].
            targets: Positions of targets in the tip by name, shape (3,), [m]: a rod from the tip to each stands for
                the target and what holds it; None: none.
            check: Clearance, radius of the rods, folders of meshes, and whether nothing may come below the mounting
                plane; None: the defaults of `CollisionCheck`.

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
        rigid = _rigid_links(robot.urdf, values)
        if check.floor:
            solids.append(mounting_plane(robot, links, rigid, configurations[0]))
        scene = _Scene.of(robot.urdf, (*solids, _beam_solid(robot.base)))
        candidates = _pairs_by_owners(robot.urdf, solids, rigid)
        chosen = _choose_pairs(candidates, solids, _Samples(scene, configurations), check.clearance)
        return cls(
            robot=robot,
            pairs=chosen.names,
            notes=_notes(solids, check, unchecked, chosen),
            _scene=scene.comparing(chosen.pairs, chosen.margins),
            _beams=_beam_scene(scene, solids),
        )

    def free(self, q: ArrayLike) -> Mask:
        """Test at which poses the robot keeps clear: no pair of shapes is closer than its least distance.

        Args:
            q: Joint values of N poses, shape (N, m), or (m,) of one, [rad] or for sliding joints [m], columns as
                ``robot.joint_names``.

        Returns:
            True where the pose is free, shape (N,).
        """
        touches = self._scene.touches(self._configurations(q))
        return ~np.fromiter(touches, dtype=np.bool_)

    def path_free(self, q_from: ArrayLike, q_to: ArrayLike) -> bool:
        """Test whether the straight way in joint space between two poses is free, both ends among it.

        It is checked at equal steps, in which no joint turns more than 2 deg or slides more than 5 mm; the middle
        first, then the quarters.

        Args:
            q_from: Joint values of the pose to leave, shape (m,), [rad] or for sliding joints [m], in the order of
                ``robot.joint_names``.
            q_to: Joint values of the pose to reach, shape (m,), likewise.

        Returns:
            True where the robot keeps clear at all steps.
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

        The beam is a rod, 10 mm thick, that ends 30 mm in front of the target. Targets and the mounting plane, which
        are assumed and not known, do not count.

        Args:
            T_tip_target: Pose of the target in the tip, shape (4, 4), [m]; its orientation does not matter.
            tracker: Position of the tracker in the robot's base, shape (3,), [m].
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as
                ``robot.joint_names``.

        Returns:
            True where the line of sight is free, shape (N,); also where the tracker is so near to the target that there
            is no beam.
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
        """Test at which poses no link and no box touches the beam.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m].
            T_base_beam: Pose of the middle of the beam at each pose in the robot's base, z along the beam, shape
                (N, 4, 4), [m].
            half_length: Half the length of each beam, shape (N,), [m].
            has_beam: At which poses there is a beam, shape (N,); the others are free.

        Returns:
            True where nothing is in the beam, shape (N,).
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
        """Return Pinocchio's configurations of the whole robot, which all joints of the URDF are in.

        Args:
            q: Joint values of N poses, shape (N, m), or (m,) of one, [rad] or for sliding joints [m], columns as
                ``robot.joint_names``.

        Returns:
            Shape (N, nq); a continuous joint has two entries, cosine and sine.
        """
        return full_configurations(self._scene.model, self.robot.urdf_values(q))


def _beam_solid(base: str) -> Solid:
    """Return the shape of a tracker's beam, a rod of 1 m; its length and pose are set for each test.

    Args:
        base: Name of the robot's base link.
    """
    rod = hppfcl.Capsule(0.5 * BEAM, 1.0)
    return Solid("the beam", "box", base, np.eye(4), rod)


def _beam_scene(scene: _Scene, solids: Sequence[Solid]) -> _Scene:
    """Return the scene with the pairs of the beam and each link or box, at no clearance.

    Args:
        scene: The shapes of the solids, and behind them that of the beam.
        solids: The solids without the beam, in the order of the scene's shapes.
    """
    beam = len(solids)
    others = [k for k, solid in enumerate(solids) if solid.kind in ("link", "box")]
    pairs = [(k, beam) for k in others]
    return scene.comparing(pairs, [0.0] * len(pairs))


class _Pair(NamedTuple):
    """Two shapes to compare."""

    #: Their numbers, from 0.
    shapes: tuple[int, int]
    #: Their least distance [m].
    margin: float
    #: Number of sampled configurations at which they are closer.
    times: int


class _OwnersCheck(NamedTuple):
    """Pairs of shapes of two owners that are checked, and what a person should know of these owners."""

    #: The pairs that are checked.
    kept: list[_Pair]
    #: Why they are not checked, or not with the clearance; None: they are.
    remark: Literal["always_close", "always_touching"] | None


class _ChosenPairs(NamedTuple):
    """Pairs of shapes to check."""

    #: Numbers of the shapes, from 0; pairs that touch most often first.
    pairs: list[tuple[int, int]]
    #: Least distance of each [m].
    margins: list[float]
    #: Names of their owners, each pair of these once.
    names: Names
    #: Owners that are always closer than the clearance, and refused only where they touch.
    always_close: list[str]
    #: Owners that always touch, and are not checked.
    always_touching: list[str]


class _Samples(NamedTuple):
    """Configurations of a robot, spread over its joints' ranges, at which pairs of shapes are tested."""

    #: The shapes; its own pairs do not matter.
    scene: _Scene
    #: Pinocchio's configurations of the whole robot, shape (N, nq).
    configurations: Array

    def touched(self, pairs: Sequence[tuple[int, int]], margin: float) -> Mask:
        """Test which pairs of shapes are closer than a margin.

        Args:
            pairs: Numbers of two shapes each, from 0.
            margin: Least distance of all of them [m].

        Returns:
            True where a pair is closer, shape (N, pairs).
        """
        margins = [margin] * len(pairs)
        return self.scene.comparing(pairs, margins).touched(self.configurations)


def _choose_pairs(
    candidates: Mapping[tuple[str, str], Sequence[tuple[int, int]]],
    solids: Sequence[Solid],
    samples: _Samples,
    clearance: float,
) -> _ChosenPairs:
    """Choose the pairs of shapes that can tell poses apart, those that touch most often first.

    Args:
        candidates: Pairs of shapes, by the names of their two owners: links, targets, boxes or the mounting plane.
            Numbers are indices of ``solids``.
        solids: The shapes.
        samples: The scene of the same shapes, and configurations spread over the joints' ranges.
        clearance: Least distance of all that is checked [m].
    """
    kept: list[_Pair] = []
    remarks: dict[str, list[str]] = {"always_close": [], "always_touching": []}
    for owners, pairs in candidates.items():
        is_box = solids[pairs[0][1]].kind == "box"
        owners_check = _check_of_owners(samples, pairs, clearance, is_box=is_box)
        kept += owners_check.kept
        if owners_check.remark is not None:
            remarks[owners_check.remark].append(" and ".join(owners))
    kept.sort(key=lambda pair: -pair.times)
    names: dict[tuple[str, str], None] = {}
    for pair in kept:
        first, second = pair.shapes
        names[solids[first].owner, solids[second].owner] = None
    return _ChosenPairs(
        pairs=[pair.shapes for pair in kept],
        margins=[pair.margin for pair in kept],
        names=tuple(names),
        always_close=remarks["always_close"],
        always_touching=remarks["always_touching"],
    )


def _check_of_owners(
    samples: _Samples,
    pairs: Sequence[tuple[int, int]],
    clearance: float,
    *,
    is_box: bool,
) -> _OwnersCheck:
    """Choose how the pairs of shapes of two owners are checked, by how often they touch over the joints' ranges.

    Owners that touch at nearly all sampled configurations are not checked, unless the second is a box, which stands
    where it must not be touched. Those that are only closer than the clearance at nearly all are checked for touching.

    Args:
        samples: The shapes, and configurations spread over the joints' ranges.
        pairs: Numbers of two shapes each, from 0, of the same two owners.
        clearance: Least distance [m].
        is_box: Whether the second owner is a box of the cell.

    Returns:
        The pairs with their least distances, and how often each is closer than that.
    """
    touched = samples.touched(pairs, 0.0)
    always_touches = _is_always(touched)
    if always_touches and not is_box:
        return _OwnersCheck([], "always_touching")
    close = samples.touched(pairs, clearance)
    if _is_always(close) and not always_touches:
        return _OwnersCheck(_counted(pairs, 0.0, touched), "always_close")
    return _OwnersCheck(_counted(pairs, clearance, close), None)


def _is_always(touched: Mask) -> bool:
    """Test whether some pair touches at nearly all configurations, 95 % of them or more.

    Args:
        touched: Which pairs touch at each configuration, shape (N, pairs).
    """
    return bool(touched.any(axis=1).mean() >= ALWAYS)


def _counted(pairs: Sequence[tuple[int, int]], margin: float, touched: Mask) -> list[_Pair]:
    """Return pairs of shapes with their least distance, and the number of configurations at which they are closer.

    Args:
        pairs: Numbers of two shapes each, from 0.
        margin: Least distance of all of them [m].
        touched: Which pairs are closer at each sampled configuration, shape (N, pairs).
    """
    times = touched.sum(axis=0).tolist()
    return [_Pair(shapes, margin, count) for shapes, count in zip(pairs, times, strict=True)]


def _rigid_links(urdf: Urdf, values: Mapping[str, Array]) -> dict[str, str]:
    """Find the links that never move against each other: those behind fixed joints, and joints that are held.

    Args:
        urdf: The URDF of the whole robot.
        values: Joint values by name, shape (N,) each, [rad] or for sliding joints [m], at samples spread over the
            ranges; a joint whose values are all the same, or that is not named, does not move.

    Returns:
        For the name of each link that of the topmost link of those that never move against it.
    """
    moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
    still = [joint for joint in urdf.joints if joint.name not in moving]
    return clusters(urdf, still)


def _pairs_by_owners(
    urdf: Urdf, solids: Sequence[Solid], rigid: Mapping[str, str]
) -> dict[tuple[str, str], list[tuple[int, int]]]:
    """Return the pairs of shapes whose links move against each other and are not connected by a joint.

    Args:
        urdf: The URDF of the whole robot.
        solids: The shapes; boxes and plane come behind links and targets.
        rigid: For the name of each link that of the topmost link of those that never move against it.

    Returns:
        Indices in ``solids`` of the two shapes of each pair, by the names of their two owners.
    """
    fixed = [joint for joint in urdf.joints if joint.type == "fixed"]
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
    solids: Sequence[Solid],
    check: CollisionCheck,
    unchecked: list[str],
    chosen: _ChosenPairs,
) -> tuple[Note, ...]:
    """Return remarks on what is checked for collisions, and what is not.

    Args:
        solids: The shapes, of which boxes and the mounting plane are named.
        check: Gives the radius of the rods that stand for targets and their holders.
        unchecked: Names of the links that have no shape that can be used, or not all of theirs.
        chosen: The pairs that are checked, and the owners that always touch or are always close.

    Returns:
        ``collisions_checked`` first; others only where there is something to name.
    """
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
