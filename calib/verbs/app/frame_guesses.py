"""Base and frame of a job's measurements, as the rows tell them.

Whether points were measured in a frame of the robot shows in them: then the position of the target in the tip is all
that is unknown, and is solved for linearly,

    p_i = R_i t + d_i,    T_base_tip(q_i) = (R_i, d_i),

for each link that is rigidly attached to the base.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.app.fields import Fields, plain

#: Values of the field of the frame.
FRAMES = plain(("known", "estimate"))

#: Rows are in a frame of the robot if half of them are as near to the nominal robot as this [m]: an arm is off by less.
_KNOWN = 0.03

#: Nearer than this it is beyond doubt; further than this that they are not [m].
_SURELY_KNOWN, _SURELY_NOT = 0.01, 0.1

#: A second link explains the rows as well if they are at most so many times as far off.
_AS_WELL = 1.5

#: Two links are at the same place if no number of their poses differs by more [m; rotation matrices: 1].
_SAME = 1e-6

#: Links in whose frame makers give positions, the usual ones first.
_USUAL_BASES = ("base_link", "base", "link_base", "link0", "root")


def add_frame_fields(fields: Fields, urdf: Urdf, arm: Robot, measurements: Measurements) -> None:
    """Add the fields of frame and base, as the rows tell them if these are positions.

    Args:
        fields: The fields.
        urdf: The robot.
        arm: Its chain; its base counts if it was chosen.
        measurements: The rows.
    """
    links = plain(urdf.links)
    kinds = {registry.get(name).position for name in measurements.kinds}
    points = measurements.points
    if kinds != {True} or not np.isfinite(points).any():
        fields.add("frame", "known", FRAMES, "doubt_frame")
        fields.add("base", arm.base, links)
        return
    bases = [arm.base] if fields.chosen("base") else rigid_links(urdf, arm.base)
    off: dict[str, float] = {}
    for base in bases:
        with contextlib.suppress(CalibError, np.linalg.LinAlgError):
            off[base] = _off(arm.rebuilt(base=base), measurements)
    if not off:
        fields.add("frame", "known", FRAMES, "doubt_frame")
        fields.add("base", arm.base, links)
        return
    best = min(off, key=lambda base: off[base])
    if best != arm.base and off[arm.base] <= _AS_WELL * off[best]:
        best = arm.base  # calib's own choice explains the rows as well
    size = off[best]
    words = {
        "size": f"{1e3 * size:.0f}" if size >= _SURELY_KNOWN else f"{1e3 * size:.1f}",
        "base": best,
    }
    guess = "known" if size < _KNOWN else "estimate"
    doubt = "doubt_frame_size" if _SURELY_KNOWN < size < _SURELY_NOT else ""
    frame = fields.add("frame", guess, FRAMES, doubt, **words)
    if frame == "known":
        as_well = [base for base in off if base != best and off[base] <= _AS_WELL * size]
        near = [base for base in as_well if _differs(urdf, best, base)]
        doubt = "doubt_base" if near and size < _KNOWN else ""
        fields.add("base", best, links, doubt, other=", ".join(near), **words)
    else:
        fields.add("base", usual_base(bases, arm.base), links)


def _differs(urdf: Urdf, one: str, other: str) -> bool:
    """Return True if two links that are rigidly attached to each other are at different places."""
    robot = Robot.from_urdf(urdf, base=one)
    second = robot.rebuilt(base=other)
    q = np.zeros((1, len(robot.joint_names)))
    return not np.allclose(robot.poses(q), second.poses(q), atol=_SAME)


def _off(arm: Robot, measurements: Measurements) -> float:
    """Return the median distance of measured positions from those of the nominal robot, its target solved for [m].

    Only the target and the station with the most rows count.
    """
    pairs = list(zip(measurements.groups, measurements.targets, strict=True))
    most = max(dict.fromkeys(pairs), key=pairs.count)
    used = np.array([pair == most for pair in pairs]) & np.isfinite(measurements.points).all(axis=1)
    T: Array = arm.poses(measurements.joints[used])
    p = measurements.points[used]
    A = T[:, :3, :3].reshape(-1, 3)
    b = (p - T[:, :3, 3]).reshape(-1)
    t, *_ = np.linalg.lstsq(A, b, rcond=None)
    return float(np.median(np.linalg.norm((b - A @ t).reshape(-1, 3), axis=1)))


def rigid_links(urdf: Urdf, link: str) -> list[str]:
    """Return the links that no moving joint parts from a link, itself first."""
    found = [link]
    for one in found:  # grows
        for joint in urdf.joints:
            if joint.type != "fixed":
                continue
            for here, there in ((joint.parent, joint.child), (joint.child, joint.parent)):
                if here == one and there not in found:
                    found.append(there)
    return found


def usual_base(links: Sequence[str], otherwise: str) -> str:
    """Return the first of the links that has a usual name of a base."""
    return next((name for name in _USUAL_BASES if name in links), otherwise)
