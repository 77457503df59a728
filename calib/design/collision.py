"""Collisions of a robot and what it holds, with itself and with what stands around: Pinocchio places, coal compares.

The whole robot is checked, not the chain alone: every link stands where `Robot.urdf_values` puts it. A target and what
holds it are a capsule, a rod with round ends, from the tip to the target. Below the mounting plane nothing may come,
and boxes are not touched. What cannot tell poses apart is left out: links that a joint joins, links that never move
against each other, and what touches wherever the joints stand. Of meshes the surfaces are compared: one that lies
wholly inside another mesh is not found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pinocchio import hppfcl

from calib.data.surroundings import Box, Reflector, Tracker, checked_boxes
from calib.design.notes import Code, Note
from calib.design.solids import (
    SAMPLES,
    Kind,
    Scene,
    Solid,
    choose_pairs,
    clusters,
    mounting_plane,
    read_solids,
    rod,
)
from calib.errors import CalibError, choices
from calib.robot.chain import full_configurations, full_model, link_frame
from calib.robot.readback import spread_poses
from calib.robot.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Largest step of a joint along a path, of one that turns [rad] and one that slides [m].
TURN_STEP, SLIDE_STEP = math.radians(2.0), 5e-3

#: Thickness of a tracker's beam, and how far in front of the target it ends: the reflector's nest does not count [m].
BEAM, NEST = 0.010, 0.030


@dataclass(frozen=True, slots=True)
class CollisionCheck:
    """What is checked for collisions, and how.

    Attributes:
        clearance: Least distance of all that is checked [m].
        floor: Whether nothing may come below the mounting plane: z = 0 of the base, or the lowest link that stands with
            the base where that is lower.
        holder_radius: A target and what holds it are a rod of this radius from the tip to the target [m].
        package_dirs: Folders in which ``package://`` meshes are looked for before all others.
    """

    clearance: float = 0.0
    floor: bool = True
    holder_radius: float = 0.020  # a 1.5 inch reflector has 19 mm
    package_dirs: tuple[str | Path, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CollisionModel:
    """A robot and boxes around it, ready to be asked at which joint values they touch.

    Attributes:
        robot: The robot.
        pairs: The names of what is checked (links, targets, boxes, the plane), those that touch most often first.
        close: Those that are always closer than the clearance; they are refused only where they touch.
        touching: Those that are not checked, for they always touch.
        notes: What was checked, and what was not as a person might expect.
    """

    robot: Robot
    pairs: tuple[tuple[str, str], ...]
    close: tuple[tuple[str, str], ...]
    touching: tuple[tuple[str, str], ...]
    notes: tuple[Note, ...]
    _scene: Scene
    _beam: hppfcl.Capsule

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
        boxes, check = checked_boxes(tuple(boxes)), check or CollisionCheck()
        same = [box.name for box in boxes if box.name in robot.urdf.links]
        if same:
            raise CalibError(
                f"A box has the name of a link of the robot: {choices(same)}. Give it another one."
            )
        links, from_visuals, unchecked = read_solids(robot.urdf, check.package_dirs)
        parts = list(links)
        for name, place in (targets or {}).items():
            T, half = rod(np.zeros(3), np.asarray(place, dtype=np.float64))
            holder = hppfcl.Capsule(check.holder_radius, 2.0 * half)
            owner = f"{name} and its holder"
            parts.append(Solid(owner, Kind.TARGET, robot.tip, T.homogeneous, holder))
        for box in boxes:
            shape = hppfcl.Box(*box.size)
            parts.append(Solid(box.name, Kind.BOX, robot.base, box.T_base_box, shape))
        values = robot.urdf_values(spread_poses(robot, SAMPLES))
        configurations = full_configurations(full_model(robot.urdf), values)
        moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
        rigid = clusters(robot.urdf, (j for j in robot.urdf.joints if j.name not in moving))
        if check.floor:
            parts.append(mounting_plane(robot, links, rigid, configurations[0]))
        around = [part.owner for part in parts if part.kind in (Kind.BOX, Kind.PLANE)]
        beam = hppfcl.Capsule(0.5 * BEAM, 1.0)
        parts.append(Solid("the beam", Kind.BOX, robot.base, np.eye(4), beam))
        scene, pairs, close, touching = choose_pairs(
            robot, Scene.of(robot.urdf, parts), rigid, configurations, float(check.clearance)
        )
        notes = [Note("collisions_checked", (check.holder_radius, *around))]
        notes += [] if check.floor else [Note("floor_not_checked")]
        listed: tuple[tuple[Code, Sequence[str]], ...] = (
            ("no_geometry", unchecked),
            ("visual_geometry", from_visuals),
            ("always_close", [f"{a} and {b}" for a, b in close]),
            ("always_touching", [f"{a} and {b}" for a, b in touching]),
        )
        notes += [Note(code, tuple(names)) for code, names in listed if names]
        return cls(robot, pairs, close, touching, tuple(notes), scene, beam)

    def free(self, q: ArrayLike) -> Mask:
        """Where the robot keeps clear, shape (N,), of q of shape (N, m) or (m,), [rad] or [m]."""
        touches = self._scene.touches()
        return np.array([not touches(one) for one in self._configurations(q)], dtype=np.bool_)

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
        index = np.arange(max(1 + math.ceil(max(steps)), 2))
        # The lowest bit of an index says how coarse a division it belongs to; index 0 is in the coarsest.
        order = np.argsort(-np.where(index == 0, len(index), index & -index), kind="stable")
        share = (index[order] / (len(index) - 1))[:, None]
        touches = self._scene.touches()
        way = self._configurations((1.0 - share) * ends[0] + share * ends[1])
        return not any(touches(one) for one in way)

    def crossed(self, q: Array, start: Array, end: Array) -> Mask:
        """Whether a link or a box stands in the way of a beam with round ends, shape (N,).

        Targets and the mounting plane, which are assumed and not known, do not count. ``q`` is of shape (N, m); the
        beams' ends, of shape (N, 3), are in the robot's base [m].
        """
        *parts, _ = self._scene.parts
        solid = [k for k, part in enumerate(parts) if part.kind in (Kind.LINK, Kind.BOX)]
        scene = self._scene.comparing([(k, len(parts)) for k in solid], [0.0] * len(solid))
        data, found = scene.room()
        base = scene.model.frames[link_frame(scene.model, self.robot.base)]
        result = np.empty(len(q), dtype=np.bool_)
        for i, configuration in enumerate(self._configurations(q)):
            pin.updateGeometryPlacements(scene.model, data, scene.shapes, found, configuration)
            T_base_beam, self._beam.halfLength = rod(start[i], end[i])
            found.oMg[len(parts)] = data.oMi[base.parentJoint] * base.placement * T_base_beam
            result[i] = pin.computeCollisions(scene.shapes, found, True)
        return result

    def _configurations(self, q: ArrayLike) -> Array:
        """Pinocchio's configurations of the whole robot, shape (N, nq)."""
        return full_configurations(self._scene.model, self.robot.urdf_values(q))


class Sight(NamedTuple):
    """Whether the target is within the tracker's range, faces it, and has nothing in the beam, shape (N,) each.

    The beam is not looked at, and True, where range or cone refuse the pose.
    """

    tracker_range: Mask
    reflector_cone: Mask
    beam: Mask


def in_sight(
    robot: Robot,
    q: Array,
    T_tip_target: Array,
    tracker: Tracker,
    reflector: Reflector | None = None,
    collision: CollisionModel | None = None,
) -> Sight:
    """At which poses q, shape (N, m), a tracker sees the target at T_tip_target, shape (4, 4), on the tip.

    The cone: the angle between the reflector's normal and the direction from target to tracker is at most its
    acceptance; without a reflector it is turned by hand. The beam: a rod of thickness `BEAM` from the tracker to `NEST`
    in front of the target touches no link and no box; without ``collision`` it is not looked at.
    """
    T_base_tip = robot.poses(q)
    points = (T_base_tip @ T_tip_target)[:, :3, 3]
    towards = tracker.position - points
    distance = np.linalg.norm(towards, axis=1)
    within = (distance >= tracker.nearest) & (distance <= tracker.farthest)
    faces, clear = np.ones((2, len(points)), dtype=np.bool_)
    if reflector is not None:
        normal = T_base_tip[:, :3, :3] @ reflector.normal
        across = np.linalg.norm(np.cross(normal, towards), axis=1)
        angle = np.arctan2(across, np.einsum("ni,ni->n", normal, towards))
        faces = angle <= reflector.acceptance
    # The rod's round ends lie between the same two planes as the beam's flat ones.
    asked = within & faces & (distance > NEST + BEAM)
    if collision is not None and asked.any():
        away = towards[asked] / distance[asked, None]
        start = tracker.position - 0.5 * BEAM * away
        end = points[asked] + (NEST + 0.5 * BEAM) * away
        clear[asked] = ~collision.crossed(q[asked], start, end)
    return Sight(within, faces, clear)
