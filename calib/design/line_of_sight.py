"""Whether a tracker sees a target: within its range, inside the reflector's cone, with nothing in the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.design.collision import CollisionModel
from calib.errors import CalibError
from calib.measure.cell_parts import pose, vector
from calib.measure.surroundings import Reflector, Tracker
from calib.model.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Thickness of the beam that must be free [m].
BEAM = 0.010

#: The beam is looked at from this far in front of the target on, so that the reflector's own nest does not count [m].
NEST = 0.030


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What the tracker sees at N poses. Each is an array of bool, shape (N,), True where the target is seen.

    Attributes:
        range: Not too near and not too far.
        cone: The tracker stands inside the reflector's cone.
        beam: Nothing stands in the beam; True too where range or cone refuse the pose, for it is not looked at there.
    """

    range: Mask
    cone: Mask
    beam: Mask

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.range, self.cone, self.beam):
            array.setflags(write=False)

    @property
    def all(self) -> Mask:
        """Whether the target is seen."""
        return self.range & self.cone & self.beam


def in_sight(
    robot: Robot,
    q: ArrayLike,
    T_tip_target: ArrayLike,
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
        q: shape (N, m) or (m,), [rad] or [m], in the order of ``robot.joint_names``.
        T_tip_target: shape (4, 4), pose of the target in the tip, or its position, shape (3,) [m].
        tracker: In the robot's base.
        reflector: In the tip; None: it is turned by hand, and seen from everywhere.
        collision: The same robot's geometry, and boxes; None: the beam is not looked at.

    Raises:
        CalibError: A target that is neither; another robot's geometry.
        ModelError: ``q`` has not one column for each joint, or a value is not finite.
    """
    target = _position(T_tip_target)
    if collision is not None and (collision.robot.urdf, collision.robot.base) != (
        robot.urdf,
        robot.base,
    ):
        raise CalibError(
            f"The collision model is of {collision.robot!r}, the poses of {robot!r}; make it of the same robot "
            "(CollisionModel.of)."
        )
    T_base_tip = robot.poses(q)
    points = T_base_tip[:, :3, :3] @ target + T_base_tip[:, :3, 3]
    towards = tracker.position - points
    distance = np.linalg.norm(towards, axis=1)
    within = (distance >= tracker.nearest) & (distance <= tracker.farthest)
    faces = np.ones(len(points), dtype=np.bool_)
    if reflector is not None:
        faces = _angle(T_base_tip[:, :3, :3] @ reflector.normal, towards) <= reflector.acceptance
    clear = np.ones(len(points), dtype=np.bool_)
    # The rod's round ends lie between the same two planes as the beam's flat ones.
    shortest = NEST + BEAM
    asked = within & faces & (distance > shortest)
    if collision is not None and asked.any():
        away = towards[asked] / distance[asked, None]
        start = tracker.position - 0.5 * BEAM * away
        end = points[asked] + (NEST + 0.5 * BEAM) * away
        rows = np.reshape(np.asarray(q, dtype=np.float64), (len(points), -1))[asked]
        clear[asked] = ~collision.crossed(rows, start, end, 0.5 * BEAM)
    return Sight(within, faces, clear)


def _position(T_tip_target: ArrayLike) -> Array:
    """The target's position in the tip, shape (3,), [m], from its pose or from itself."""
    if np.shape(T_tip_target) == (4, 4):
        return pose(T_tip_target, "The pose of the target")[:3, 3]
    return vector(T_tip_target, "target's position in the tip")


def _angle(one: Array, other: Array) -> Array:
    """Angles between vectors, shape (N,), [rad]; exact at small angles too. A vector without length is at 0."""
    cross = np.linalg.norm(np.cross(one, other), axis=1)
    result: Array = np.arctan2(cross, np.einsum("ni,ni->n", one, other))
    return result
