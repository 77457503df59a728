"""Which link a chain ends at where none is named."""

from __future__ import annotations

import itertools
from collections.abc import Collection

from calib.model.chain import MOVING
from calib.model.urdf import Urdf, UrdfJoint

#: Names of a tip, in the order of preference, where several links lie equally far out.
_USUAL_TIPS = ("tool0", "tcp", "tool", "flange", "ee_link")


def farthest_link(
    urdf: Urdf, base: str, measured: Collection[str] | None = None, held: Collection[str] = ()
) -> str:
    """The link with the most moving joints between it and ``base``; a usual tip's name breaks ties.

    Only links that measured joints alone lead to count, if there are any with a moving joint before them. Links
    below the base come first; where nothing moves below it, as on a camera's link, all others are looked at.

    Args:
        urdf: The URDF.
        base: Name of a link.
        measured: Names of the joints whose values are known; all joints if None.
        held: Names of joints that stay where they are; they lead on but do not count.

    Raises:
        UrdfError: The base is not a link.
    """
    urdf.chain(base, base)  # raises, with the names there are, for a link that does not exist
    every = {joint.name for joint in urdf.joints}
    knowns = [every] if measured is None else [measured, every]
    for known, climb in itertools.product(knowns, (False, True)):
        count = _counted(urdf, base, known, held, climb=climb)
        most = max(count.values())
        if most:
            break
    farthest = [link for link in count if count[link] == most]
    return next((name for name in _USUAL_TIPS if name in farthest), farthest[-1])


def _counted(
    urdf: Urdf, base: str, known: Collection[str], held: Collection[str], *, climb: bool
) -> dict[str, int]:
    """The number of moving joints before each link that can be reached; ``climb``: joints are passed upwards too."""
    above = {joint.child: joint for joint in urdf.joints}
    start = base
    while start in above and above[start].type == "fixed":
        start = above[start].parent
    below: dict[str, list[tuple[UrdfJoint, str]]] = {}
    for joint in urdf.joints:
        moves = joint.type in MOVING and joint.mimic is None and joint.name in known
        if joint.type == "fixed" or joint.name in held or moves:
            below.setdefault(joint.parent, []).append((joint, joint.child))
            if climb:
                below.setdefault(joint.child, []).append((joint, joint.parent))
    count = {start: 0}
    waiting = [start]
    for link in waiting:
        for joint, other in below.get(link, []):
            if other not in count:
                count[other] = count[link] + (joint.type != "fixed" and joint.name not in held)
                waiting.append(other)
    return count
