"""Which link a chain ends at where none is named."""

from __future__ import annotations

from collections.abc import Callable, Collection

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
    trials = [measured, None] if measured is not None else [None]
    for known in trials:
        for climb in (False, True):
            most, link = _farthest(urdf, base, known, held, climb=climb)
            if most:
                return link
    return link


def _farthest(
    urdf: Urdf, base: str, measured: Collection[str] | None, held: Collection[str], *, climb: bool
) -> tuple[int, str]:
    """The number of moving joints before the farthest link, and its name; ``climb``: joints are passed upwards too."""
    usable = _passable(measured, held)
    above = {joint.child: joint for joint in urdf.joints}
    start = base
    while start in above and above[start].type == "fixed":
        start = above[start].parent
    below: dict[str, list[tuple[UrdfJoint, str]]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append((joint, joint.child))
        if climb:
            below.setdefault(joint.child, []).append((joint, joint.parent))
    count = {start: 0}
    reached = [start]
    for link in reached:
        for joint, other in below.get(link, []):
            if usable(joint) and other not in count:
                count[other] = count[link] + (joint.type != "fixed" and joint.name not in held)
                reached.append(other)
    most = max(count.values())
    farthest = [link for link in reached if count[link] == most]
    return most, next((name for name in _USUAL_TIPS if name in farthest), farthest[-1])


def _passable(
    measured: Collection[str] | None, held: Collection[str]
) -> Callable[[UrdfJoint], bool]:
    """Whether a default chain may go through a joint: fixed, held, or moving by itself and measured."""

    def passable(joint: UrdfJoint) -> bool:
        if joint.type == "fixed" or joint.name in held:
            return True
        alone = joint.type in MOVING and joint.mimic is None
        return alone and (measured is None or joint.name in measured)

    return passable
