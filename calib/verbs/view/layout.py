"""Places of robots, labels and cameras of a page of robots: values only.

Two robots stand side by side, or one over the other; a robot alone stands at its base.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import calib.show.scene.scene as stage
from calib.basics.arrays import Array
from calib.show.scene.puppet import BASE_MOVER, Puppet
from calib.show.scene.scene import Camera

#: Ends of the text below and of the heading above, as a part of the picture's half height, see `look_at`.
_TEXT = (-0.54, 0.67)

#: The same of one robot that only moves, whose text has fewer lines.
_TEXT_OF_MOTION = (-0.72, 0.85)

#: Angle between the directions from the robot to a tracker and to the camera, seen from above [rad]: the tracker stands
#: behind the robot, at the right of the picture.
_TRACKER_VIEW = np.deg2rad(112.0)

#: Gap between two robots side by side, as a part of the scene's size.
_GAP = 0.06

#: Least distance of two robots side by side, as a part of the scene's size.
_LEAST_DISTANCE = 0.4

#: Labels stand in front of the parts of a robot up to this height above its foot, as a part of the scene's size.
_FOOT_HEIGHT = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Places of the robots, labels and cameras of a page; the frame is the base of the calibrated robot."""

    #: Diagonal of a robot's bounding box over all poses [m]
    size: float
    #: Shape (3,), displacement of each robot side by side [m]
    offsets: dict[str, Array]
    #: Shape (3,), place of the label of a robot that is not displaced [m]
    foot: Array
    #: The camera for the robots side by side
    side: Camera
    #: The camera for the overlaid robots
    over: Camera


def layout_of(
    shown: Mapping[str, Puppet],
    start: int,
    size: float,
    *,
    magnified: Array,
    around: Array,
    tracker: Array | None = None,
    only_moves: bool = False,
) -> Layout:
    """Place robots, labels and cameras.

    Measured positions do not count: a wild measurement must not make the robots small. Nor does what a robot that
    stands on the floor would do below it where it only moves.

    Args:
        shown: The robots by ``"nominal"`` and ``"calibrated"``, in the base of the latter; a robot alone is
            ``"nominal"``.
        start: Index of the pose shown first, from 0.
        size: Size of the scene: the diagonal of the box around `outline_of`, see `calib.show.scene.scene.span` [m].
        magnified: shape (M, 3), targets of the overlaid robots with their difference magnified [m].
        around: shape (K, 3), points about the robots that the cameras see too [m].
        tracker: shape (3,), a point that is seen behind the robot, at the right [m]; None for the arm to be seen from
            its side.
        only_moves: One robot alone, whose poses are of no table and of no plan, but go through the joints' ranges.
    """
    at_start = outline_of(shown, slice(start, start + 1))
    outline = np.concatenate([at_start, outline_of(shown)])
    if only_moves and _stands(shown, start, at_start):
        outline = outline[outline[:, 2] >= at_start[:, 2].min()]
    text = _TEXT_OF_MOTION if only_moves else _TEXT
    towards_camera = _towards_camera(shown["nominal"].poses[start, :, :3, 3], tracker)
    foot = _foot(at_start, towards_camera, size)
    seen = np.vstack([outline, around, foot])
    offsets = {"nominal": np.zeros(3)}
    if len(shown) > 1:
        offsets = _offsets(outline, towards_camera, size)
    return Layout(
        size,
        offsets,
        foot,
        side=stage.look_at(_side_by_side(seen, offsets), towards_camera, text),
        over=stage.look_at(np.vstack([seen, magnified]), towards_camera, text),
    )


def outline_of(shown: Mapping[str, Puppet], poses: slice = slice(None)) -> Array:
    """Return points (K, 3) [m] that enclose all robots at some of their poses; see `Puppet.outline`.

    Args:
        shown: The robots by ``"nominal"`` and ``"calibrated"``.
        poses: The poses; by default all.
    """
    return np.concatenate([puppet.outline(poses) for puppet in shown.values()])


def _towards_camera(arm: Array, tracker: Array | None) -> Array:
    """Return the horizontal unit vector (3,) from the robot to the cameras.

    Args:
        arm: Origins of the robot's links at the pose shown first, shape (L, 3), [m].
        tracker: A point that is seen behind the robot, shape (3,), [m]; None for the arm to be seen from its side.
    """
    if tracker is None:
        return stage.camera_direction(arm)
    return stage.camera_direction(np.array([np.zeros(3), tracker]), _TRACKER_VIEW)


def _stands(shown: Mapping[str, Puppet], start: int, at_start: Array) -> bool:
    """Return whether the robot's base is in the lower half of it at the first pose, with points (K, 3) [m]."""
    height = shown["nominal"].poses[start, BASE_MOVER, 2, 3]
    return bool(height <= 0.5 * (at_start[:, 2].min() + at_start[:, 2].max()))


def _to_the_right(towards_camera: Array) -> Array:
    """Return the horizontal unit vector to the right of the picture, shape (3,)."""
    return np.array([-towards_camera[1], towards_camera[0], 0.0])


def _offsets(outline: Array, towards_camera: Array, size: float) -> dict[str, Array]:
    """Return the displacements (3,) [m] of two robots side by side, which then do not overlap.

    Args:
        outline: shape (K, 3), points that enclose both robots at all poses [m].
        towards_camera: shape (3,), horizontal unit vector.
        size: The scene's size [m].

    Returns:
        By ``"nominal"``, to the left of the picture, and ``"calibrated"``, to the right.
    """
    right = _to_the_right(towards_camera)
    width = np.ptp(outline @ right) + _GAP * size
    half_distance = 0.5 * max(width, _LEAST_DISTANCE * size) * right
    return {"nominal": -half_distance, "calibrated": half_distance}


def _side_by_side(points: Array, offsets: Mapping[str, Array]) -> Array:
    """Return points (K, 3) [m] displaced with each of R robots, shape (R K, 3)."""
    return np.concatenate([points + offset for offset in offsets.values()])


def _foot(at_start: Array, towards_camera: Array, size: float) -> Array:
    """Return the point (3,) [m] for a label: below the middle of a robot, in front of what stands on the floor.

    Args:
        at_start: shape (K, 3), points that enclose the robot at the first pose [m].
        towards_camera: shape (3,), horizontal unit vector.
        size: The scene's size [m].
    """
    right = _to_the_right(towards_camera)
    across = at_start @ right
    foot: Array = 0.5 * (across.min() + across.max()) * right
    foot[2] = at_start[:, 2].min()
    low = at_start[at_start[:, 2] < foot[2] + _FOOT_HEIGHT * size]
    foot += (low @ towards_camera).max() * towards_camera
    return foot
