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
from types import MappingProxyType

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pinocchio import hppfcl

from calib.design.collision_pairs import Ignored, Scene, choose_pairs, mounting_plane, room_for
from calib.design.solids import Kind, Solid, read_solids, rods
from calib.errors import CalibError, choices
from calib.measure.cell_parts import is_number
from calib.measure.surroundings import Box, checked_boxes
from calib.model.chain import full_configurations, link_frame
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Largest step of a joint along a path, of one that turns [rad] and one that slides [m].
TURN_STEP, SLIDE_STEP = math.radians(2.0), 5e-3

#: Radius of a target and of what holds it, if nothing is said: a 1.5 inch reflector has 19 mm [m].
HOLDER_RADIUS = 0.020


@dataclass(frozen=True, slots=True, eq=False)
class CollisionModel:
    """A robot and boxes around it, ready to be asked at which joint values they touch.

    Attributes:
        robot: The robot.
        boxes: In the robot's base; they move with it where joints of the chain move the base.
        targets: By name their places in the tip, shape (3,), [m].
        holder_radius: Of the capsules from the tip to the targets [m].
        plane: The name of the mounting plane, with its height; None where it is not checked.
        clearance: Least distance between what is checked [m].
        pairs: The names of what is checked (links, targets, boxes, the plane), those that touch most often first.
        ignored: Those that are not, and why.
        close: Those that are always closer than the clearance; they are refused only where they touch.
        unchecked: Links that carry a mass but have no geometry that can be used, or not all of it.
        from_visuals: Links without collision geometry, whose visual geometry stands for it.
    """

    robot: Robot
    boxes: tuple[Box, ...]
    targets: Mapping[str, Array]
    holder_radius: float
    plane: str | None
    clearance: float
    pairs: tuple[tuple[str, str], ...]
    ignored: tuple[Ignored, ...]
    close: tuple[tuple[str, str], ...]
    unchecked: tuple[str, ...]
    from_visuals: tuple[str, ...]
    _scene: Scene

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
            boxes: In the robot's base.
            clearance: Least distance between all that is checked [m].
            package_dirs: Folders in which ``package://`` meshes are looked for before all others.
            targets: Places in the tip by name, shape (3,), [m]; each and what holds it joins the check.
            holder_radius: Of the capsules from the tip to the targets [m].
            floor: Whether nothing may come below the mounting plane: z = 0 of the base, or the lowest link that stands
                with the base where that is lower.

        Raises:
            UrdfError: A mesh cannot be found or read, or no link has geometry.
            CalibError: A clearance that is none; a box with a link's name; a box that swallows the robot.
        """
        boxes, folders = checked_boxes(tuple(boxes)), tuple(str(folder) for folder in package_dirs)
        if not is_number(clearance) or not clearance >= 0.0:
            raise CalibError(f"The clearance is {clearance!r} m; it must be a number, 0 or more.")
        if not is_number(holder_radius) or not holder_radius > 0.0:
            raise CalibError(
                f"The holder's radius is {holder_radius!r} m; it must be a number above 0."
            )
        same = [box.name for box in boxes if box.name in robot.urdf.links]
        if same:
            raise CalibError(
                f"A box has the name of a link of the robot: {choices(same)}. Give it another one."
            )
        solids = read_solids(robot.urdf, folders)
        places = {name: read_only(place) for name, place in (targets or {}).items()}
        parts = list(solids.solids)
        parts += [_holder(robot, name, at, holder_radius) for name, at in places.items()]
        parts += [
            Solid(box.name, Kind.BOX, robot.base, box.T_base_box, hppfcl.Box(*box.size))
            for box in boxes
        ]
        if floor:
            parts += mounting_plane(robot, [part for part in parts if part.kind is Kind.LINK])
        chosen = choose_pairs(robot, Scene.of(robot.urdf, parts), float(clearance))
        return cls(
            robot=robot,
            boxes=boxes,
            targets=MappingProxyType(places),
            holder_radius=float(holder_radius),
            plane=parts[-1].owner if floor else None,
            clearance=float(clearance),
            pairs=chosen.pairs,
            ignored=chosen.ignored,
            close=chosen.close,
            unchecked=solids.unchecked,
            from_visuals=solids.from_visuals,
            _scene=chosen.scene,
        )

    def __repr__(self) -> str:
        """In one line."""
        return f"CollisionModel({self.robot!r}, {len(self.boxes)} boxes, {len(self.pairs)} pairs)"

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what was not checked as a person might expect."""
        said = []
        if self.unchecked:
            names = choices(self.unchecked)
            said.append(f"Not checked for collisions, for want of geometry in the URDF: {names}.")
        if self.from_visuals:
            names = choices(self.from_visuals)
            said.append(f"Links without collision geometry, whose visual stands for it: {names}.")
        if self.close:
            names = ", ".join(f"'{a}' and '{b}'" for a, b in self.close)
            said.append(
                f"Always closer than the clearance of {1e3 * self.clearance:g} mm, and refused only where they touch: "
                f"{names}."
            )
        touching = [str(pair) for pair in self.ignored if pair.reason.startswith("touch")]
        if touching:
            said.append(f"Not checked against each other: {'; '.join(touching)}.")
        return tuple(said)

    def free(self, q: ArrayLike) -> Mask:
        """Where the robot touches neither itself nor a box, and keeps its clearance, shape (N,).

        Args:
            q: shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.

        Raises:
            ModelError: ``q`` has not one column for each joint, or a value is not finite.
        """
        touches = self._scene.touches()
        return np.array([not touches(one) for one in self._configurations(q)], dtype=np.bool_)

    def first_contact(self, q: ArrayLike) -> tuple[str, str] | None:
        """The names of two links, or of a link and a box, that touch at joint values, shape (m,); None if none do."""
        scene, (configuration,) = self._scene, self._configurations(q)
        data, found = scene.scratch()
        pin.updateGeometryPlacements(scene.model, data, scene.shapes, found, configuration)
        for k, pair in enumerate(scene.shapes.collisionPairs):
            if pin.computeCollision(scene.shapes, found, k):
                return scene.owners((pair.first, pair.second))
        return None

    def path_free(self, q_from: ArrayLike, q_to: ArrayLike) -> bool:
        """Whether the straight way in joint space from one pose to another is free, both ends among it.

        It is checked at equal steps in which no joint of the robot turns by more than `TURN_STEP` or slides by more
        than `SLIDE_STEP`; the middle first, then the quarters, and so on.

        Args:
            q_from: shape (m,), [rad] or [m].
            q_to: shape (m,).

        Raises:
            ModelError: A pose has not one value for each joint, or one that is not finite.
        """
        ends = np.array([np.ravel(q_from), np.ravel(q_to)], dtype=np.float64)
        sliding = {joint.name for joint in self.robot.urdf.joints if joint.type == "prismatic"}
        count = 1 + max(
            math.ceil(
                abs(float(value[1] - value[0])) / (SLIDE_STEP if name in sliding else TURN_STEP)
            )
            for name, value in self.robot.urdf_values(ends).items()
        )
        index = np.arange(max(count, 2))
        # The lowest bit of an index says how coarse a division it belongs to; index 0 is in the coarsest.
        order = np.argsort(-np.where(index == 0, len(index), index & -index), kind="stable")
        share = (index[order] / (len(index) - 1))[:, None]
        touches = self._scene.touches()
        way = self._configurations((1.0 - share) * ends[0] + share * ends[1])
        return not any(touches(one) for one in way)

    def crossed(self, q: ArrayLike, start: ArrayLike, end: ArrayLike, radius: float) -> Mask:
        """Whether a link or a box stands in the way of a rod with round ends, shape (N,).

        Every link with geometry and every box counts, those that never move among them; targets and the mounting
        plane, which are assumed and not known, do not.

        Args:
            q: shape (N, m) or (m,), [rad] or [m].
            start: shape (N, 3) or (3,), centre of one end in the robot's base [m].
            end: shape (N, 3) or (3,), centre of the other [m].
            radius: [m].
        """
        configurations = self._configurations(q)
        count = len(configurations)
        ends = np.stack([np.broadcast_to(np.asarray(p), (count, 3)) for p in (start, end)])
        T_base_rods, halves = rods(ends[0], ends[1])
        scene = self._scene
        rod = hppfcl.Capsule(radius, 1.0)
        shapes = scene.with_shape(rod)
        data, found = scene.model.createData(), room_for(shapes)
        base = scene.model.frames[link_frame(scene.model, self.robot.base)]
        result = np.empty(count, dtype=np.bool_)
        for i, configuration in enumerate(configurations):
            pin.updateGeometryPlacements(scene.model, data, shapes, found, configuration)
            rod.halfLength = halves[i]
            T_base_rod = pin.SE3(T_base_rods[i, :3, :3], T_base_rods[i, :3, 3])
            found.oMg[len(scene.parts)] = data.oMi[base.parentJoint] * base.placement * T_base_rod
            result[i] = pin.computeCollisions(shapes, found, True)
        return result

    def _configurations(self, q: ArrayLike) -> Array:
        """Pinocchio's configurations of the whole robot, shape (N, nq)."""
        return full_configurations(self._scene.model, self.robot.urdf_values(q))


def _holder(robot: Robot, name: str, place: Array, radius: float) -> Solid:
    """A target and what holds it: a rod with round ends from the tip's origin to the target."""
    T_tip_rod, half = rods(np.zeros((1, 3)), place[None])
    rod = hppfcl.Capsule(radius, 2.0 * float(half[0]))
    return Solid(f"{name} and its holder", Kind.TARGET, robot.tip, T_tip_rod[0], rod)
