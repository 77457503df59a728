"""Trees that are refused before and after Pinocchio reads them: too large for it, or read in another way."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.errors import UrdfError, choices
from calib.model.urdf import Urdf, UrdfJoint

MOST_JOINTS, DEEPEST, MOST_MOVING = 2000, 200, 150
"""The most joints of a robot, behind one another, and coordinates that move.

Pinocchio goes down a tree by recursion, and takes memory with the third power of the coordinates that move.
"""

#: Coordinates of the types that have not just one.
_COORDINATES = {"fixed": 0, "floating": 6, "planar": 3}

#: Poses of links that two readers make of a URDF may differ by this, relative to the largest entry.
_SAME_POSE = 1e-9


def check_size(urdf: Urdf) -> None:
    """Refuse a tree that is no robot's, and that would take Pinocchio all memory.

    Raises:
        UrdfError: More joints than `MOST_JOINTS`, `DEEPEST` or `MOST_MOVING`.
    """
    moving = sum(_COORDINATES.get(joint.type, 1) for joint in urdf.joints)
    counts = [
        (len(urdf.joints), MOST_JOINTS, "joints"),
        (moving, MOST_MOVING, "moving coordinates"),
    ]
    if len(urdf.joints) <= MOST_JOINTS:
        counts.append((_depth(urdf), DEEPEST, "joints behind one another"))
    for count, most, what in counts:
        if count > most:
            message = (
                f"{urdf.source} has {count:,} {what}; {most:,} are the most that a robot may have here. Leave out "
                "what does not carry the arm."
            )
            raise UrdfError(message)


def _depth(urdf: Urdf) -> int:
    """The most joints between the root and a link."""
    below: dict[str, list[str]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint.child)
    level, depth = [urdf.root], -1
    while level:
        level = [child for link in level for child in below.get(link, ())]
        depth += 1
    return depth


def check_same(urdf: Urdf, model: pin.Model) -> None:
    """Refuse a URDF that Pinocchio reads in another way than calib: corrections would go to other joints.

    Raises:
        UrdfError: A joint or link is missing in its model, or lies elsewhere with all joints at zero.
    """
    T_root_joint = [np.eye(4)]
    for i in range(1, model.njoints):
        T_root_joint.append(T_root_joint[model.parents[i]] @ model.jointPlacements[i].homogeneous)
    theirs = {
        frame.name: T_root_joint[frame.parentJoint] @ frame.placement.homogeneous
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
    }
    wrong = {joint.name for joint in urdf.joints if joint.type != "fixed"} - set(model.names)
    ours = {urdf.root: np.eye(4)}
    level = [urdf.root]
    below: dict[str, list[UrdfJoint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    while level:
        link = level.pop()
        T = theirs.get(link)
        largest = max(1.0, float(np.abs(ours[link]).max()))
        if T is None or not np.abs(T - ours[link]).max() <= _SAME_POSE * largest:
            wrong.add(link)
        for joint in below.get(link, ()):
            ours[joint.child] = ours[link] @ joint.T_parent_joint
            level.append(joint.child)
    if wrong:
        message = (
            f"{urdf.source}: Pinocchio reads this URDF in another way than it is written: {choices(sorted(wrong))} "
            "are missing there or lie elsewhere. Look for unusual characters in numbers and names, and for comments "
            "and other things inside of tags."
        )
        raise UrdfError(message)
