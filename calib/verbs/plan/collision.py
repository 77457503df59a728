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

from calib.basics.arrays import Array, Mask
from calib.data.cell import Box
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.plan.notes import Code, Note
from calib.verbs.plan.solids import (
    Solid,
    box_solids,
    clusters,
    mounting_plane,
    read_solids,
    rods,
    target_solids,
)

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
        """Build the scene of a robot and solids fixed to its links, without pairs to compare.

        Args:
            urdf: The URDF of the whole robot, from which Pinocchio's model is made.
            solids: The shapes: of each ``link``, the name of the URDF link that it is fixed to, ``T_link_shape``, its
                pose in that link, shape (4, 4), [m], and ``geometry``, the shape of coal.

        Returns:
            Pinocchio's ``model`` of the whole robot, and its geometry model ``shapes``, numbered from 0 in the order of
            ``solids``; no pairs and no ``margins``.
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

        The ``model`` of the robot is shared; ``shapes``, Pinocchio's geometry model with its list of pairs, is copied.

        Args:
            pairs: Numbers of the two shapes of each pair, from 0, in the order of ``shapes``.
            margins: Least distance of each pair [m], as many as pairs: one that is closer counts as touching.

        Returns:
            The scene with these pairs in place of its own, in the order given.
        """
        shapes = self.shapes.copy()
        shapes.removeAllCollisionPairs()
        for first, second in pairs:
            shapes.addCollisionPair(pin.CollisionPair(first, second))
        return _Scene(self.model, shapes, margins)

    def workspace(self) -> tuple[pin.Data, pin.GeometryData]:
        """Return memory for Pinocchio's results, with the margin of each pair of shapes set in it.

        Each caller needs its own. Uses ``model``, the whole robot; ``shapes``, the geometry model with the pairs to
        compare; and ``margins``, the least distance of each pair [m], in the order of the pairs.

        Returns:
            Pinocchio's data of the robot, and its data of the shapes, whose collision requests have the margins set.
        """
        geometry_data = self.shapes.createData()
        for request, margin in zip(geometry_data.collisionRequests, self.margins, strict=True):
            request.security_margin = margin
            # Without it coal 3.0 misses some simple shapes that are deep in each other, such as a capsule in a box.
            request.enable_contact = True
            # How far bounding volumes are followed beyond the margin: 1 mm by default, a third of the time.
            request.break_distance = 1e-6
        return self.model.createData(), geometry_data

    def touches(self, configurations: Array) -> Iterator[bool]:
        """Test at each configuration whether any pair of shapes is closer than its margin, one configuration at a time.

        Uses ``model``, the whole robot; ``shapes``, the geometry model with the pairs to compare; and ``margins``, the
        least distance of each pair [m].

        Args:
            configurations: Pinocchio's configurations of the whole robot, shape (N, nq): [rad], of sliding joints [m],
                of continuous ones cosine and sine.

        Yields:
            True where at least one pair is closer than its margin; N values.
        """
        data, geometry_data = self.workspace()
        for configuration in configurations:
            is_touching = pin.computeCollisions(
                self.model, data, self.shapes, geometry_data, configuration, True
            )
            yield bool(is_touching)

    def touched(self, configurations: Array) -> Mask:
        """Test which pairs of shapes are closer than their margins.

        Uses ``model``, the whole robot; ``shapes``, the geometry model with the P pairs to compare; and ``margins``,
        the least distance of each pair [m].

        Args:
            configurations: Pinocchio's configurations of the whole robot, shape (N, nq): [rad], of sliding joints [m],
                of continuous ones cosine and sine.

        Returns:
            True where a pair is closer than its margin, shape (N, P), pairs in the order of the scene.
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
        attached: Iterable[Solid] = (),
    ) -> CollisionModel:
        """Read the geometry of a robot and find the pairs of shapes that have to be checked.

        Left out are pairs of links that a joint connects or that never move against each other, and pairs that touch at
        95 % or more of 256 poses spread over the joints' ranges, except those with a box.

        Args:
            robot: The robot; all links of its URDF are checked, also those beside the chain from base to tip.
            boxes: Obstacles: of each ``name``, ``size``, the lengths of its edges along its own axes, shape (3,), [m],
                and ``T_base_box``, the pose of its centre in the robot's base, shape (4, 4), [m].
            targets: Positions of targets in the tip by name, shape (3,), [m]: a rod from the tip's origin to each
                stands for the target and what holds it; None: none.
            check: ``clearance``, the least distance of all pairs [m]; ``floor``, whether nothing may come below the
                mounting plane; ``holder_radius``, the radius of the rods [m]; ``package_dirs``, folders of
                ``package://`` meshes. None: the defaults of `CollisionCheck`.
            attached: Further shapes, fixed to any link, of the kind ``"target"``; those of the kind ``"box"`` last.

        Returns:
            The model, with the names of the pairs that are checked, those that touch most often first, and notes on
            what is checked and what is not.

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

        The pairs of ``_scene`` are compared: links, targets with their holders, boxes and the mounting plane, each with
        its least distance [m].

        Args:
            q: Joint values of N poses, shape (N, m), or (m,) of one, [rad] or for sliding joints [m], columns as
                ``robot.joint_names``.

        Returns:
            True where the pose is free, shape (N,).
        """
        touches = self._scene.touches(self._configurations(q))
        return ~np.fromiter(touches, dtype=np.bool_)

    def path_free(self, q_from: ArrayLike, q_to: ArrayLike) -> bool:
        """Test whether the straight move in joint space between two poses is free, both ends included.

        The pairs of shapes in ``_scene`` are tested, as by `free`, at equal steps in which no joint of ``robot`` turns
        more than 2 deg or slides more than 5 mm. Coarse divisions of the move come before finer ones, so that a
        collision is soon met.

        Args:
            q_from: Joint values of the pose to leave, shape (m,), [rad] or for sliding joints [m], in the order of
                ``robot.joint_names``.
            q_to: Joint values of the pose to reach, shape (m,), likewise.

        Returns:
            True where no pair of shapes is closer than its least distance at any step.
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

    def beam_free(self, T_tip_target: Array, tracker: Array, q: Array, ahead: float = 0.0) -> Mask:
        """Test at which poses no link and no box is in the beam from a tracker to the target.

        The beam is a rod from the tracker, 10 mm thick, that ends 30 mm in front of the target. Targets and the
        mounting plane, which are assumed and not known, do not block it. Uses ``robot``, and by `_beams_free` the pairs
        of shapes in ``_beams``.

        Args:
            T_tip_target: Pose of the target in the tip, shape (4, 4), [m]; its orientation does not matter.
            tracker: Position of the tracker in the robot's base, shape (3,), [m].
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            ahead: The beam begins so far in front of the tracker [m].

        Returns:
            True where the line of sight is free, shape (N,); also where the tracker is 40 mm or less from the target,
            so that there is no beam.
        """
        points = (self.robot.poses(q) @ T_tip_target)[:, :3, 3]
        distance = np.linalg.norm(tracker - points, axis=1)
        # The rod's round ends lie between the same two planes as the beam's flat ones.
        away = (tracker - points) / np.maximum(distance, BEAM)[:, None]
        ends = points + (NEST + 0.5 * BEAM) * away
        T_base_beam, half_length = rods(tracker - (ahead + 0.5 * BEAM) * away, ends)
        has_beam = distance > NEST + BEAM + ahead
        return self._beams_free(q, T_base_beam, half_length, has_beam)

    def _beams_free(self, q: Array, T_base_beam: Array, half_length: Array, has_beam: Mask) -> Mask:
        """Test at which poses no link and no box touches the beam, a capsule 10 mm thick.

        Uses ``_beams``: a scene in which the last shape is the beam, paired with each link and box at no clearance; its
        length and pose are set anew for each pose. ``robot.base`` is the link in which the beam is placed.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
            T_base_beam: Pose of the middle of the beam at each pose in the robot's base, z along the beam, shape
                (N, 4, 4), [m].
            half_length: Half the length of each beam without its round ends, shape (N,), [m].
            has_beam: At which poses there is a beam, shape (N,); the others are not tested.

        Returns:
            True where nothing is in the beam, or there is no beam, shape (N,).
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
        """Return Pinocchio's configurations of the whole robot, with the joints beside the chain too.

        Uses ``robot``, which gives the values of mimic and held joints (all others are at 0), and the Pinocchio model
        in ``_scene``.

        Args:
            q: Joint values of N poses, shape (N, m), or (m,) of one, [rad] or for sliding joints [m], columns as
                ``robot.joint_names``.

        Returns:
            Shape (N, nq), [rad] or [m]; a continuous joint has two entries, cosine and sine.
        """
        return full_configurations(self._scene.model, self.robot.urdf_values(q))


def _beam_solid(base: str) -> Solid:
    """Return the shape of a tracker's beam, a capsule 10 mm thick; its length and pose are set for each test.

    Args:
        base: Name of the robot's base link, to which it is fixed.

    Returns:
        A solid of the kind ``"box"``, 1 m long, at the origin of the base.
    """
    rod = hppfcl.Capsule(0.5 * BEAM, 1.0)
    return Solid("the beam", "box", base, np.eye(4), rod)


def _beam_scene(scene: _Scene, solids: Sequence[Solid]) -> _Scene:
    """Return a scene that compares a tracker's beam with each link and box, at no clearance.

    Args:
        scene: The shapes of the solids in their order, and the shape of the beam as the last one.
        solids: The solids without the beam: ``kind`` is ``"link"``, ``"target"``, ``"box"`` or ``"plane"``. Targets and
            the plane do not block a beam.

    Returns:
        The scene with pairs of a link's or box's shape and the beam, each with a least distance of 0.
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
        """Test which pairs of shapes are closer than a margin at the sampled configurations.

        Uses ``scene``, the shapes on the robot, and ``configurations``, N configurations of Pinocchio's spread over the
        joints' ranges, shape (N, nq).

        Args:
            pairs: Numbers of the two shapes of each of the P pairs, from 0, in the order of the scene.
            margin: Least distance of all of them [m]; 0: only shapes that touch.

        Returns:
            True where a pair is closer, shape (N, P).
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

    Each pair of owners is judged by `_check_of_owners` at the sampled configurations.

    Args:
        candidates: Pairs of shapes to judge, by the names of their two owners: links, targets, boxes or the mounting
            plane. Each shape is an index in ``solids``, from 0; a box or the plane comes second.
        solids: The shapes: ``owner`` is the name of the link, target, box or plane that each belongs to, ``kind`` which
            of these it is.
        samples: The scene of the same shapes, and Pinocchio's configurations of the robot, spread over the joints'
            ranges, at which they are tested.
        clearance: Least distance of all that is checked [m].

    Returns:
        The pairs that are checked, as indices in ``solids``, with their least distances ``margins`` [m] and the
        ``names`` of their owners, each two names once; and, as texts ``"a and b"``, the owners that are
        ``always_close`` (checked for touching only) or ``always_touching`` (not checked).
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

    Owners that touch at 95 % or more of the sampled configurations are not checked, unless the second is a box, which
    stands where it must not be touched. Those that do not, but are closer than the clearance at 95 % or more, are
    checked for touching alone, with a least distance of 0.

    Args:
        samples: The scene of the shapes, and the configurations of the robot at which they are tested.
        pairs: Numbers of the two shapes of each pair, from 0 in the scene; all pairs are of the same two owners (links,
            targets, boxes or the mounting plane).
        clearance: Least distance [m].
        is_box: Whether the second owner is a box of the cell.

    Returns:
        ``kept``: the pairs to check, each with its least distance [m] and the number of sampled configurations at which
        it is closer; empty where they are not checked. ``remark``: ``"always_touching"`` where they are not checked,
        ``"always_close"`` where they are not checked for the clearance, else None.
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
    """Test whether at 95 % or more of the configurations at least one of the pairs touches, not always the same one.

    Args:
        touched: Which pairs touch at each configuration, shape (N, pairs).
    """
    return bool(touched.any(axis=1).mean() >= ALWAYS)


def _counted(pairs: Sequence[tuple[int, int]], margin: float, touched: Mask) -> list[_Pair]:
    """Return pairs of shapes with their least distance, and the number of configurations at which they are closer.

    Args:
        pairs: Numbers of the two shapes of each pair, from 0.
        margin: Least distance of all of them [m].
        touched: Which pairs are closer than the margin at each of N sampled configurations, shape (N, pairs).

    Returns:
        For each pair its two numbers, the margin [m], and the number of configurations, 0 to N; in the order given.
    """
    times = touched.sum(axis=0).tolist()
    return [_Pair(shapes, margin, count) for shapes, count in zip(pairs, times, strict=True)]


def _rigid_links(urdf: Urdf, values: Mapping[str, Array]) -> dict[str, str]:
    """Find the links that never move against each other: those behind fixed joints, and behind joints that do not move.

    Args:
        urdf: The URDF of the whole robot.
        values: Joint values by name, shape (N,) each, [rad] or for sliding joints [m], at samples spread over the
            ranges; a joint whose values are all the same, as of one that is held, or that is not named, does not move.

    Returns:
        For the name of each link the name of the topmost link, nearest to the URDF's root, of those that never move
        against it.
    """
    moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
    still = [joint for joint in urdf.joints if joint.name not in moving]
    return clusters(urdf, still)


def _pairs_by_owners(
    urdf: Urdf, solids: Sequence[Solid], rigid: Mapping[str, str]
) -> dict[tuple[str, str], list[tuple[int, int]]]:
    """Return the pairs of shapes whose links move against each other and are not connected by one moving joint.

    Links that a moving joint connects are left out, with all that is welded to them by fixed joints: they always touch
    near the joint. Boxes and the mounting plane are not compared with each other.

    Args:
        urdf: The URDF of the whole robot.
        solids: The shapes: ``owner`` is the name of the link, target, box or plane that each belongs to, ``kind`` which
            of these it is, ``link`` the name of the link that it is fixed to. Boxes and plane come last.
        rigid: For the name of each link the name of the topmost link of those that never move against it.

    Returns:
        Indices in ``solids`` of the two shapes of each pair, from 0, the first one smaller, by the names of their two
        owners.
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
        solids: The shapes, of which boxes and the mounting plane (by ``kind``) are named by their ``owner``.
        check: ``check.holder_radius``, radius of the rods that stand for targets and their holders [m].
        unchecked: Names of the links that carry a mass and have no shape, or whose shapes cannot all be used.
        chosen: ``chosen.always_close`` and ``chosen.always_touching``, texts ``"a and b"``: the owners of shapes that
            are checked for touching only, and that are not checked.

    Returns:
        Notes, each a code with values. First ``collisions_checked``: the radius [m], then the names of boxes and plane;
        then, each only where it has something to name, ``no_geometry`` (links), ``always_close`` and
        ``always_touching`` (texts of pairs).
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
