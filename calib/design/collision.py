"""Collisions of a robot and what it holds, with itself and with what stands around: Pinocchio places, coal compares.

The whole robot is checked, not the chain alone: every link stands where `Robot.urdf_values` puts it. A target and what
holds it are a capsule, a rod with round ends, from the tip to the target. Below the mounting plane nothing may come,
and boxes are not touched. What cannot tell poses apart is left out: links that a joint joins, links that never move
against each other, and what touches wherever the joints stand. Of meshes the surfaces are compared: one that lies
wholly inside another mesh is not found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pinocchio import hppfcl

from calib.data.surroundings import Box, Reflector, Tracker, checked_boxes
from calib.design.solids import (
    JOINED,
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

#: Radius of a target and of what holds it, if nothing is said: a 1.5 inch reflector has 19 mm [m].
HOLDER_RADIUS = 0.020

#: Thickness of a tracker's beam, and how far in front of the target it ends: the reflector's nest does not count [m].
BEAM, NEST = 0.010, 0.030


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CollisionModel:
    """A robot and boxes around it, ready to be asked at which joint values they touch.

    Attributes:
        robot: The robot.
        pairs: The names of what is checked (links, targets, boxes, the plane), those that touch most often first.
        ignored: The names of those that are not, and why.
        close: Those that are always closer than the clearance; they are refused only where they touch.
        notes: Sentences on what was checked, and what was not as a person might expect.
    """

    robot: Robot
    pairs: tuple[tuple[str, str], ...]
    ignored: Mapping[tuple[str, str], str]
    close: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    _scene: Scene
    _beam: hppfcl.Capsule

    @classmethod
    def of(
        cls,
        robot: Robot,
        boxes: Iterable[Box] = (),
        clearance: float = 0.0,
        package_dirs: Iterable[str | Path] = (),
        *,
        targets: Mapping[str, ArrayLike] | None = None,
        holder_radius: float = HOLDER_RADIUS,
        floor: bool = False,
    ) -> CollisionModel:
        """Read the geometry of a robot and find out which pairs have to be checked.

        Args:
            robot: The robot; its URDF names the meshes.
            boxes: In the robot's base; they move with it where joints of the chain move the base.
            clearance: Least distance between all that is checked [m].
            package_dirs: Folders in which ``package://`` meshes are looked for before all others.
            targets: Places in the tip by name, shape (3,), [m]; each and what holds it joins the check.
            holder_radius: Of the capsules from the tip to the targets [m].
            floor: Whether nothing may come below the mounting plane: z = 0 of the base, or the lowest link that stands
                with the base where that is lower.

        Raises:
            UrdfError: A mesh cannot be found or read, or no link has geometry.
            CalibError: A holder without a radius; a box with a link's name or that swallows the robot, or a plane that
                its tip never leaves.
        """
        boxes, targets = checked_boxes(tuple(boxes)), targets or {}
        if not holder_radius > 0.0:
            raise CalibError(
                f"The holder's radius is {holder_radius!r} m; it must be a number above 0."
            )
        same = [box.name for box in boxes if box.name in robot.urdf.links]
        if same:
            raise CalibError(
                f"A box has the name of a link of the robot: {choices(same)}. Give it another one."
            )
        links, from_visuals, unchecked = read_solids(robot.urdf, package_dirs)
        parts = list(links)
        for name, place in targets.items():
            T, half = rod(np.zeros(3), np.asarray(place, dtype=np.float64))
            holder = hppfcl.Capsule(holder_radius, 2.0 * half)
            owner = f"{name} and its holder"
            parts.append(Solid(owner, Kind.TARGET, robot.tip, T.homogeneous, holder))
        for box in boxes:
            shape = hppfcl.Box(*box.size)
            parts.append(Solid(box.name, Kind.BOX, robot.base, box.T_base_box, shape))
        values = robot.urdf_values(spread_poses(robot, SAMPLES))
        configurations = full_configurations(full_model(robot.urdf), values)
        moving = {name for name, value in values.items() if np.ptp(value) > 0.0}
        rigid = clusters(robot.urdf, (j for j in robot.urdf.joints if j.name not in moving))
        if floor:
            parts.append(mounting_plane(robot, links, rigid, configurations[0]))
        around = [f"the box '{box.name}'" for box in boxes] + [
            p.owner for p in parts if p.kind is Kind.PLANE
        ]
        beam = hppfcl.Capsule(0.5 * BEAM, 1.0)
        parts.append(Solid("the beam", Kind.BOX, robot.base, np.eye(4), beam))
        scene, pairs, ignored, close = choose_pairs(
            robot, Scene.of(robot.urdf, parts), rigid, configurations, float(clearance)
        )
        many = "each target and its holder" if len(targets) > 1 else "the target and its holder"
        notes = [
            f"Checked for collisions: the robot's links and {many}, taken as a rod of {1e3 * holder_radius:g} mm "
            "radius from the tip to the target (--holder), with each other"
            + (f", and with {' and '.join(around)}." if around else "."),
            "Not known, and not checked: what stands around and was not named (--box), "
            + ("" if floor else "the floor, ")
            + "cables and hoses, holders of another shape, the instrument and its stand, people. Drive the first round "
            "slowly.",
        ]
        for said, names in (
            (
                "Not checked for collisions, for want of geometry in the URDF",
                [f"'{link}'" for link in unchecked],
            ),
            (
                "Links without collision geometry, whose visual stands for it",
                [f"'{link}'" for link in from_visuals],
            ),
            (
                f"Always closer than the clearance of {1e3 * clearance:g} mm, and refused only where they touch",
                [f"'{a}' and '{b}'" for a, b in close],
            ),
            (
                "Not checked against each other",
                [f"'{a}' and '{b}': {why}" for (a, b), why in ignored.items() if why != JOINED],
            ),
        ):
            notes += [f"{said}: {', '.join(names)}."] if names else []
        return cls(robot, pairs, ignored, close, tuple(notes), scene, beam)

    def free(self, q: ArrayLike) -> Mask:
        """Where the robot touches neither itself nor a box, and keeps its clearance, shape (N,).

        Args:
            q: shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.

        Raises:
            ModelError: ``q`` has not one column for each joint, or a value is not finite.
        """
        touches = self._scene.touches()
        return np.array([not touches(one) for one in self._configurations(q)], dtype=np.bool_)

    def path_free(self, q_from: ArrayLike, q_to: ArrayLike) -> bool:
        """Whether the straight way in joint space from one pose to another is free, both ends among it.

        It is checked at equal steps in which no joint of the robot turns by more than `TURN_STEP` or slides by more
        than `SLIDE_STEP`; the middle first, then the quarters, and so on.

        Args:
            q_from: shape (m,), [rad] or [m].
            q_to: shape (m,).
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

        Every link with geometry and every box counts, those that never move among them; targets and the mounting
        plane, which are assumed and not known, do not.

        Args:
            q: shape (N, m), [rad] or [m].
            start: shape (N, 3), centre of one end in the robot's base [m].
            end: shape (N, 3), centre of the other [m].
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

    range: Mask
    cone: Mask
    beam: Mask


def in_sight(
    robot: Robot,
    q: Array,
    T_tip_target: Array,
    tracker: Tracker,
    reflector: Reflector | None = None,
    collision: CollisionModel | None = None,
) -> Sight:
    """At which poses a tracker sees the target on the tip.

    The cone: the angle between the reflector's normal and the direction from target to tracker is at most its
    acceptance. The beam: a rod of thickness `BEAM` from the tracker to `NEST` in front of the target touches
    no link and no box; the link that carries the target counts like the others.

    Args:
        robot: The robot.
        q: shape (N, m), [rad] or [m], in the order of ``robot.joint_names``.
        T_tip_target: shape (4, 4), pose of the target in the tip.
        tracker: In the robot's base.
        reflector: In the tip; None: it is turned by hand, and seen from everywhere.
        collision: The same robot's geometry, and boxes; None: the beam is not looked at.
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
