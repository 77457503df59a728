"""The default tip of a robot: the link that the most joints of its arm move.

A joint that mimics others moves with its driver: it leads on, and does not count. Grippers and hands are left out, by
what moves them or by their names. A gripper has one driver, and fingers that follow it side by side:

    the joints that one driver moves are not all on one path from the root,
    and no joint of the arm moves freely beyond them

A parallelogram inside an arm is none, because the wrist lies beyond its rods.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from calib.errors import UrdfError, choices
from calib.robot.chain import MOVING, driver_of
from calib.robot.urdf import Urdf
from calib.robot.urdf_tree import UrdfJoint

#: Usual names of a tip, the preferred ones first.
_USUAL_TIPS = ("tool0", "tcp", "tool", "flange", "ee_link")

#: Words in the names of joints and links of a gripper or hand, in lower case.
_FINGER_WORDS = ("finger", "thumb", "pinky", "jaw")
_HAND_WORDS = (*_FINGER_WORDS, "gripper", "hand")

#: Words in the names of wrist joints, which may also contain a word of a hand: ``gripper_yaw_joint``.
_WRIST_WORDS = ("roll", "pitch", "yaw")

#: Two arms have at least so many measured joints each that the other has not; a head or fingers have fewer.
_FEWEST_OF_ARM = 3


class SeveralArmsError(UrdfError):
    """The joints of several arms are measured, and the tip is not named."""

    def __init__(self, source: str, tips: Sequence[str], targets: Sequence[str] = ()) -> None:
        """Word what to type, of a URDF by the ends of its arms and by the targets that the table names, if known."""
        self.source, self.tips = source, tuple(tips)
        ends = (
            f"{source}: the joints of {len(tips)} arms are measured, which end at {choices(tips)}"
        )
        if len(targets) > 1:
            named = " ".join(f"--tip {target}=LINK" for target in targets)
            fix = f", and the targets {choices(targets)}. Name the link of each: {named}."
        else:
            each = " ".join(f"--tip NAME={link}" for link in tips)
            fix = (
                f". Name the one that carries the target, --tip {tips[0]}; or each, with its name in the column "
                f"'target': {each}."
            )
        super().__init__(ends + fix)


def farthest_link(
    urdf: Urdf,
    base: str,
    measured: Collection[str] | None = None,
    held: Mapping[str, float] | None = None,
) -> str:
    """Return the link with the most moving joints between it and the base: the default tip.

    Joints that mimic others do not count. Joints of a gripper or hand do not, unless no other joint moves. Among links
    equally far out a usual name such as ``tool0`` wins, or else the last one that is not part of a gripper or hand.

    Args:
        urdf: The robot.
        base: Link that the chain starts at.
        measured: Names of joints; links that these alone, and joints that mimic them, lead to are preferred. None for
            all joints.
        held: Values [rad or m] of joints that stay where they are, by name: they lead on, but do not count.

    Raises:
        UrdfError: There is no link ``base``; or joints of two arms, equally long, are measured.
    """
    urdf.chain(base, base)  # raises, with the names of all links, for one that does not exist
    above = {joint.child: joint for joint in urdf.joints}
    start = base
    while start in above and above[start].type == "fixed":
        start = above[start].parent

    # Joints of the arm that are measured count; if none moves, all that are measured; then the arm's; then all.
    drivers = _drivers(urdf, held or {})
    every = {name for name, driver in drivers.items() if driver is not None}
    hand = _hand_joints(urdf, drivers)
    given = every
    if measured is not None:
        given = {name for name in every if drivers[name] in measured}
    moved_by: dict[str, frozenset[str]] = {}
    for passed in (given - hand, given, every - hand, every):
        moved_by = _drivers_of_links(urdf, start, drivers, passed, hand)
        if any(moved_by.values()):
            break
    most = max(map(len, moved_by.values()))
    farthest = [link for link, names in moved_by.items() if len(names) == most]
    palms = {joint.parent for joint in urdf.joints if joint.name in hand}
    before_hand = [link for link in farthest if not _is_in_hand(above, palms, link)] or farthest
    if measured is not None:
        _check_one_arm(urdf, {link: moved_by[link] for link in before_hand})
    return next((name for name in _USUAL_TIPS if name in farthest), before_hand[-1])


def _check_one_arm(urdf: Urdf, tips: Mapping[str, frozenset[str]]) -> None:
    """Raise UrdfError, with what to type, if tips are the ends of different arms, by the joints that move each.

    Arms differ by `_FEWEST_OF_ARM` joints or more, each by other ones; fingers of a hand differ by fewer.
    """
    arms: dict[frozenset[str], str] = {}
    for link, names in tips.items():
        if arms.get(names) not in _USUAL_TIPS:
            arms[names] = link
    apart = [
        link
        for names, link in arms.items()
        if any(len(names - other) >= _FEWEST_OF_ARM for other in arms)
    ]
    if len(apart) > 1:
        raise SeveralArmsError(urdf.source, apart)


def _drivers(urdf: Urdf, held: Mapping[str, float]) -> dict[str, str | None]:
    """Return the joint that moves each joint, itself or another, by name; None: it is still.

    Joints that no chain can pass, such as floating ones or mimics of what does not exist, are left out.
    """
    by_name = {joint.name: joint for joint in urdf.joints}
    drivers: dict[str, str | None] = {}
    for joint in urdf.joints:
        try:
            driver, _, _ = driver_of(urdf.source, by_name, joint.name, held)
        except UrdfError:
            continue
        if joint.type == "fixed" or joint.type in MOVING:
            drivers[joint.name] = driver
    return drivers


def _hand_joints(urdf: Urdf, drivers: Mapping[str, str | None]) -> set[str]:
    """Return the names of the moving joints of grippers and hands, see the module's text."""
    paths = {joint.name: urdf.chain(urdf.root, joint.child)[1] for joint in urdf.joints}
    groups: dict[str, list[str]] = {}
    for name, driver in drivers.items():
        if driver is not None:
            groups.setdefault(driver, []).append(name)
    hand = {joint.name for joint in urdf.joints if _moves_hand(joint) and drivers.get(joint.name)}
    # A gripper on a gripper is seen once that is known: from the tips to the base.
    by_depth = sorted(groups.values(), key=lambda group: -max(len(paths[name]) for name in group))
    for group in by_depth:
        members = set(group)
        deepest = max(group, key=lambda name: len(paths[name]))
        side_by_side = not members <= set(paths[deepest])
        beyond = {
            name for name in drivers if drivers[name] is not None and members & set(paths[name])
        }
        if side_by_side and beyond - members <= hand:
            hand |= members
    return hand


def _moves_hand(joint: UrdfJoint) -> bool:
    """Return True if a joint belongs to a gripper or hand, by its name and that of the link that it moves."""
    name, link = joint.name.casefold(), joint.child.casefold()
    if any(word in name or word in link for word in _FINGER_WORDS):
        return True
    of_hand = any(word in name for word in _HAND_WORDS)
    return of_hand and not any(word in name for word in _WRIST_WORDS)


def _is_in_hand(above: Mapping[str, UrdfJoint], palms: Collection[str], link: str) -> bool:
    """Return True if a link, or one that it is fixed to, is part of a gripper or hand, by its name or as a palm.

    ``above`` has the joint above each link by the link's name, ``palms`` the links that joints of a hand start at. A
    palm that a joint moves directly, with no fixed one between, is the last link of the arm.
    """
    while not any(word in link.casefold() for word in _HAND_WORDS):
        if link not in above or above[link].type != "fixed":
            return False
        if link in palms:
            return True
        link = above[link].parent
    return True


def _drivers_of_links(
    urdf: Urdf,
    start: str,
    drivers: Mapping[str, str | None],
    passed: Collection[str],
    hand: Collection[str],
) -> dict[str, frozenset[str]]:
    """Return the joints that drive each link below one, for links that passed and still joints lead to."""
    below: dict[str, list[UrdfJoint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    moved_by: dict[str, frozenset[str]] = {start: frozenset()}
    waiting = [start]
    for link in waiting:
        for joint in below.get(link, []):
            if joint.name not in drivers:
                continue
            driver = drivers[joint.name]
            if driver is not None and joint.name not in passed:
                continue
            # A finger that follows another one is not the one to choose.
            if joint.name in hand and driver not in {joint.name, *moved_by[link]}:
                continue
            moved_by[joint.child] = moved_by[link] | ({driver} if driver is not None else set())
            waiting.append(joint.child)
    return moved_by
