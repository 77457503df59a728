"""Places of the robots, labels and cameras on a page of robots: values only.

Two robots stand side by side, or one over the other; a robot alone stands at its base.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.show.scene.posed_robot import BASE_MOVER, PosedRobot
from calib.show.scene.scene import ViewCamera, camera_direction, look_at

#: Upper end of the text at the foot and lower end of the heading; the picture is from -1 to 1, see `look_at`.
_TEXT = (-0.54, 0.67)

#: The same for one robot that goes through its joints' ranges: its page has fewer lines of text.
_TEXT_OF_MOTION = (-0.72, 0.85)

#: Angle between the directions from the robot to a tracker and to the camera, seen from above [rad]: the tracker is
#: beyond the robot, at the right of the picture.
_TRACKER_VIEW = np.deg2rad(112.0)

#: Gap between two robots side by side, as a fraction of the scene's size.
_GAP = 0.06

#: Least distance of two robots side by side, as a fraction of the scene's size.
_LEAST_DISTANCE = 0.4

#: Labels are in front of the parts of a robot up to this height above its foot, as a fraction of the scene's size.
_FOOT_HEIGHT = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """Places of the robots, labels and cameras of a page; the frame is the base of the calibrated robot."""

    #: Diagonal of a robot's bounding box over all poses [m]
    size: float
    #: Shape (3,), displacement of each robot side by side [m]
    offsets: dict[str, Array]
    #: Shape (3,), place of the label of a robot that is not displaced [m]
    foot: Array
    #: The camera for the robots side by side
    side: ViewCamera
    #: The camera for the overlaid robots
    over: ViewCamera


def arrange(
    shown: Mapping[str, PosedRobot],
    start: int,
    size: float,
    *,
    magnified: Array,
    around: Array,
    tracker: Array | None = None,
    only_moves: bool = False,
) -> Arrangement:
    """Place robots, labels and cameras.

    Measured positions are ignored, because a wild measurement must not make the robots small. So are, for a robot that
    only moves and stands on the floor, its parts below the floor.

    Args:
        shown: The robots by ``"nominal"`` and ``"calibrated"``, in the base of the latter; a robot alone is
            ``"nominal"``.
        start: Index of the pose shown first, from 0.
        size: Size of the scene: the diagonal of the box around `outline_of`, see `calib.show.scene.scene.span` [m].
        magnified: shape (M, 3), targets of the overlaid robots with their difference magnified [m].
        around: shape (K, 3), points around the robots that the cameras see too [m].
        tracker: shape (3,), a point that is seen beyond the robot, at the right [m]; None: the arm is seen from its
            side.
        only_moves: One robot alone goes through its joints' ranges, without a table or a plan.
    """
    first = shown["nominal"]
    if tracker is None:
        towards_camera = camera_direction(first.poses[start, :, :3, 3])
    else:
        towards_camera = camera_direction(np.array([np.zeros(3), tracker]), _TRACKER_VIEW)
    right = np.array([-towards_camera[1], towards_camera[0], 0.0])

    at_start = outline_of(shown, slice(start, start + 1))
    outline = np.concatenate([at_start, outline_of(shown)])
    middle_height = 0.5 * (at_start[:, 2].min() + at_start[:, 2].max())
    stands = first.poses[start, BASE_MOVER, 2, 3] <= middle_height
    if only_moves and stands:
        outline = outline[outline[:, 2] >= at_start[:, 2].min()]

    # The label is below the middle of the robot, in front of what is near the floor.
    across = at_start @ right
    foot: Array = 0.5 * (across.min() + across.max()) * right
    foot[2] = at_start[:, 2].min()
    low = at_start[at_start[:, 2] < foot[2] + _FOOT_HEIGHT * size]
    foot += (low @ towards_camera).max() * towards_camera

    offsets = {"nominal": np.zeros(3)}
    if len(shown) > 1:
        width = np.ptp(outline @ right) + _GAP * size
        half_distance = 0.5 * max(width, _LEAST_DISTANCE * size) * right
        offsets = {"nominal": -half_distance, "calibrated": half_distance}

    text = _TEXT_OF_MOTION if only_moves else _TEXT
    seen = np.vstack([outline, around, foot])
    side_by_side = np.concatenate([seen + offset for offset in offsets.values()])
    return Arrangement(
        size,
        offsets,
        foot,
        side=look_at(side_by_side, towards_camera, text),
        over=look_at(np.vstack([seen, magnified]), towards_camera, text),
    )


def outline_of(shown: Mapping[str, PosedRobot], poses: slice = slice(None)) -> Array:
    """Return points (K, 3) [m] that enclose all robots at some of their poses; see `PosedRobot.outline`.

    Args:
        shown: The robots by ``"nominal"`` and ``"calibrated"``.
        poses: The poses; by default all.
    """
    return np.concatenate([robot.outline(poses) for robot in shown.values()])
