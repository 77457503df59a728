"""The geometry of a chain: its placements, in path order, and the ``<origin>`` that holds each of them.

The path from base to tip may climb from the base to the link where the branches part, and then descend to the tip.
A joint of the base's side is walked from its child link to its parent, so that its motion and its origin O turn round:

    (O J(axis, q))^-1 = J(-axis, q) O^-1

With its axis turned round it is a joint like any other, at the same q, and the whole path is one serial chain.

Its joints may be more than the columns of q, where some mimic others or are held: q_chain = A theta + b, with one
column for each joint that moves freely, a joint of the chain or the driver of one that mimics it. theta = q unless
readings are coupled (`calib.robot.readings`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.units import unit_fault
from calib.basics.values import Value
from calib.errors import UrdfError, choices, did_you_mean
from calib.robot.full_model import full_model
from calib.robot.urdf import Urdf, UrdfJoint

MOVING = ("revolute", "continuous", "prismatic")
"""The types of joints that a chain may move by."""

#: Names of a tip, in the order of preference, where several links lie equally far out.
_USUAL_TIPS = ("tool0", "tcp", "tool", "flange", "ee_link")

#: What the names of the joints and links of a gripper or hand contain, in lower case.
_FINGER_WORDS = ("finger", "thumb", "pinky", "jaw")
_HAND_WORDS = (*_FINGER_WORDS, "gripper", "hand")

#: What tells a wrist joint from a hand's, as in ``gripper_yaw_joint``.
_WRIST_WORDS = ("roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True, eq=False)
class OriginFactors(Value):
    """A placement as the product of a URDF joint's ``<origin>`` O and constant poses: before O after.

    A placement that no ``<origin>`` holds has none of them, and identities here.
    """

    #: Shape (4, 4), [m].
    before: Array
    #: Shape (4, 4), [m].
    after: Array
    #: True where the joint is walked from child to parent: before O^-1 after.
    inverted: bool

    def origin(self, placement: Array) -> Array:
        """Return the ``<origin>`` O of a placement, both of shape (4, 4), [m]."""
        factor = rigid_inverse(self.before) @ placement @ rigid_inverse(self.after)
        if self.inverted:
            return rigid_inverse(factor)
        return factor


@dataclass(frozen=True, slots=True, eq=False)
class SerialChain:
    """The path between two links as a serial chain of n moving joints; see `calib.robot.robot.Robot`."""

    #: Base to tip, n of them; those on the base's side with the axis turned round.
    joints: tuple[UrdfJoint, ...]
    #: Shape (n + 1, 4, 4), [m]: of each joint in the one before it, of the tip in the last.
    placements: Array
    #: n + 1 names of URDF joints whose ``<origin>`` holds the placement; None where a moving joint carries the end.
    carriers: tuple[str | None, ...]
    #: Shape (4, 4), [m], pose of the base in the frame that the first placement is given in.
    T_root_base: Array
    #: The n + 1 placements as products of an ``<origin>`` and constants.
    factors: tuple[OriginFactors, ...]
    #: True if joints lie on the base's side of the link where the branches part.
    base_moves: bool


def chain_between(urdf: Urdf, base: str, tip: str) -> SerialChain:
    """Return the path between two links as a serial chain.

    Args:
        urdf: The robot.
        base: Link that the chain starts at.
        tip: Link that it ends at.

    Raises:
        UrdfError: No joint moves between the links, one is of a type other than `MOVING`, a link does not exist, or
            Pinocchio reads the URDF otherwise than it is written.
    """
    path = _path(urdf, base, tip)
    moving = [step for step in path if step.joint.type != "fixed"]
    _check_moving(urdf, base, tip, [step.joint for step in moving])
    full_model(urdf)  # which refuses what Pinocchio cannot read, or reads otherwise
    T_root_base = np.eye(4)
    if not moving[0].up:
        # The chain starts in the URDF's root, with the joints above the base at zero.
        T_root_base = _product(_path(urdf, urdf.root, base))
        path = _path(urdf, urdf.root, tip)
    groups = _placement_groups(path, {step.joint.name for step in moving})
    carriers: list[str | None] = []
    factors = []
    for k, group in enumerate(groups):
        # A moving joint's own origin, at the chain's ends else that of the fixed joint next to the moving one, so
        # that all that is mounted behind it moves along.
        carried_by_last = k == 0 or (k < len(moving) and not moving[k].up)
        carrier, factor = _origin_factors(group, carried_by_last=carried_by_last)
        carriers.append(carrier)
        factors.append(factor)
    return SerialChain(
        joints=tuple(step.path_joint for step in moving),
        placements=read_only([_product(group) for group in groups]),
        carriers=tuple(carriers),
        T_root_base=read_only(T_root_base),
        factors=tuple(factors),
        base_moves=moving[0].up,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """A joint of the path, fixed ones included."""

    joint: UrdfJoint
    #: True where the path goes from the joint's child link to its parent.
    up: bool

    @property
    def origin(self) -> Array:
        """The factor that the joint's origin is in the path, shape (4, 4), [m]."""
        T = self.joint.T_parent_joint
        return rigid_inverse(T) if self.up else T

    @property
    def path_joint(self) -> UrdfJoint:
        """The joint with its axis in the sense of the path."""
        if not self.up:
            return self.joint
        return replace(self.joint, axis=read_only(-self.joint.axis + 0.0))


def _path(urdf: Urdf, base: str, tip: str) -> list[_Step]:
    """Return all joints from base to tip: up to the link where the branches part, and down from it."""
    to_base, to_tip = urdf.chain(base, tip)
    up = [_Step(urdf.joint(name), up=True) for name in reversed(to_base)]
    return up + [_Step(urdf.joint(name), up=False) for name in to_tip]


def _check_moving(urdf: Urdf, base: str, tip: str, joints: Sequence[UrdfJoint]) -> None:
    """Refuse a path without moving joints, or with one of several coordinates."""
    wrong = [joint for joint in joints if joint.type not in MOVING]
    if joints and not wrong:
        return
    fault = "no joint moves"
    if wrong:
        fault = f"joint '{wrong[0].name}' of type '{wrong[0].type}' is not one of {choices(MOVING)}"
    raise UrdfError(
        f"{urdf.source}: {fault} between the base '{base}' and the tip '{tip}'. Name two links with the arm "
        f"between them by --base and --tip; the links are {choices(urdf.links)}."
    )


def _placement_groups(path: Sequence[_Step], moving: Collection[str]) -> list[list[_Step]]:
    """Return the steps whose origins each placement is the product of, n + 1 lists; ``moving`` are n joints' names."""
    groups: list[list[_Step]] = [[]]
    for step in path:
        moves = step.joint.name in moving
        if moves and step.up:  # it moves first, its origin comes behind it
            groups.append([])
        groups[-1].append(step)
        if moves and not step.up:
            groups.append([])
    return groups


def _origin_factors(
    group: list[_Step], *, carried_by_last: bool
) -> tuple[str | None, OriginFactors]:
    """Return the name of the joint that carries a placement, the last or the first of its steps, and its factors."""
    before: list[_Step] = []
    after: list[_Step] = []
    if carried_by_last:
        before = group[:-1]
    else:
        after = group[1:]
    if not group:
        return None, OriginFactors(_product(before), _product(after), inverted=False)
    carrier = group[-1] if carried_by_last else group[0]
    factors = OriginFactors(_product(before), _product(after), inverted=carrier.up)
    return carrier.joint.name, factors


def _product(steps: Sequence[_Step]) -> Array:
    """Return the product of the steps' origins, (4, 4)."""
    T = np.eye(4)
    for step in steps:
        T = T @ step.origin
    return T


def pinocchio_chain(joints: Sequence[UrdfJoint], placements: Array) -> pin.Model:
    """Return a Pinocchio model of n joints in a row, whose configuration is their values.

    Args:
        joints: The n joints, base to tip.
        placements: Shape (n, 4, 4) or more, [m], of each joint in the one before it; a tip's is left out.
    """
    model = pin.Model()
    for parent, (joint, P) in enumerate(zip(joints, placements, strict=False)):
        axis = np.array(joint.axis)
        if joint.type == "prismatic":
            kind = pin.JointModelPrismaticUnaligned(axis)
        else:
            kind = pin.JointModelRevoluteUnaligned(axis)
        model.addJoint(parent, kind, pin.SE3(P), joint.name)
    return model


def farthest_link(
    urdf: Urdf,
    base: str,
    measured: Collection[str] | None = None,
    held: Collection[str] = (),
) -> str:
    """Return the link with the most moving joints between it and the base: the default tip.

    Joints of a gripper or hand, which their names tell, do not count unless no other joint moves. Among links equally
    far out a usual name such as ``tool0`` wins, else the last one that is not part of a gripper or hand.

    Args:
        urdf: The robot.
        base: Link that the chain starts at.
        measured: Names of joints; links that these alone lead to are preferred. None for all joints.
        held: Names of joints that stay where they are: they lead on, but do not count.

    Raises:
        UrdfError: There is no link ``base``.
    """
    urdf.chain(base, base)  # raises, with the names of all links, for one that does not exist
    count = _joints_of_arm_to(urdf, base, measured, held)
    most = max(count.values())
    farthest = [link for link, number in count.items() if number == most]
    before_hand = [link for link in farthest if not _is_in_hand(urdf, link)] or farthest
    return next((name for name in _USUAL_TIPS if name in farthest), before_hand[-1])


def _joints_of_arm_to(
    urdf: Urdf,
    base: str,
    measured: Collection[str] | None,
    held: Collection[str],
) -> dict[str, int]:
    """Return the number of moving joints from the base to each link that they lead to.

    Those that are measured and no gripper's or hand's count; where none of them moves, those that are one or the other;
    where none of these does, all. The arguments are those of `farthest_link`.
    """
    every = {joint.name for joint in urdf.joints}
    arm = every - {joint.name for joint in urdf.joints if _moves_hand(joint)}
    given = every if measured is None else set(measured)
    start = _fixed_ancestor(urdf, base)
    count: dict[str, int] = {}
    for known in (given & arm, given, arm, every):
        count = _moving_joints_to(urdf, start, known, held)
        if max(count.values()):
            break
    return count


def _moves_hand(joint: UrdfJoint) -> bool:
    """Return True if a joint is one of a gripper or hand, by its name and that of the link that it moves."""
    name, link = joint.name.casefold(), joint.child.casefold()
    if any(word in name or word in link for word in _FINGER_WORDS):
        return True
    of_hand = any(word in name for word in _HAND_WORDS)
    return of_hand and not any(word in name for word in _WRIST_WORDS)


def _is_in_hand(urdf: Urdf, link: str) -> bool:
    """Return True if a link, or one that it is fixed to, is part of a gripper or hand, by its name."""
    above = {joint.child: joint for joint in urdf.joints}
    while not any(word in link.casefold() for word in _HAND_WORDS):
        if link not in above or above[link].type != "fixed":
            return False
        link = above[link].parent
    return True


def _fixed_ancestor(urdf: Urdf, link: str) -> str:
    """Return the uppermost link that a link is fixed to."""
    above = {joint.child: joint for joint in urdf.joints}
    while link in above and above[link].type == "fixed":
        link = above[link].parent
    return link


def _moving_joints_to(
    urdf: Urdf,
    start: str,
    known: Collection[str],
    held: Collection[str],
) -> dict[str, int]:
    """Return the number of known moving joints from a link to each link below it that these, fixed and held lead to."""
    below: dict[str, list[UrdfJoint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    count = {start: 0}
    waiting = [start]
    for link in waiting:
        for joint in below.get(link, []):
            still = joint.type == "fixed" or joint.name in held
            moves = joint.type in MOVING and joint.mimic is None and joint.name in known
            if still or moves:
                count[joint.child] = count[link] + (not still)
                waiting.append(joint.child)
    return count


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """Motion of a chain's n joints with the m joints that move freely: q_chain = A theta + b."""

    #: The m joints that move freely, one for each column of q; the driver of a mimic joint may lie beside the chain.
    inputs: tuple[UrdfJoint, ...]
    #: A, shape (n, m): 1 where a joint is its own column, the multiplier where it mimics another.
    matrix: Array
    #: b, shape (n,), offsets of mimic joints and held values [rad or m].
    offset: Array


def coupling_of(urdf: Urdf, joints: Sequence[UrdfJoint], held: Mapping[str, float]) -> Coupling:
    """Return how the joints of a chain follow those that move freely.

    Args:
        urdf: The robot.
        joints: The n joints of the chain, base to tip.
        held: Values [rad or m] of joints that stay where they are, by name.

    Raises:
        UrdfError: No joint is left to move, or one mimics what cannot drive it.
    """
    # A joint of the chain may have its axis turned round.
    by_name = {joint.name: joint for joint in (*urdf.joints, *joints)}
    rules = [_rule(urdf.source, by_name, joint.name, held) for joint in joints]
    drivers = list(dict.fromkeys(rule.driver for rule in rules if rule.driver is not None))
    if not drivers:
        raise UrdfError(
            f"{urdf.source}: the joints of the chain are {choices(joint.name for joint in joints)}, and none of "
            "them is left to move: each is held at a value or mimics one that is. Hold fewer joints."
        )
    matrix = np.zeros((len(joints), len(drivers)))
    for row, rule in zip(matrix, rules, strict=True):
        if rule.driver is not None:
            row[drivers.index(rule.driver)] = rule.factor
    return Coupling(
        inputs=tuple(by_name[name] for name in drivers),
        matrix=read_only(matrix),
        offset=read_only([rule.offset for rule in rules]),
    )


def checked_held(urdf: Urdf, held: Mapping[str, float] | None) -> tuple[tuple[str, float], ...]:
    """Return the held joints and their values [rad or m], sorted by name.

    Args:
        urdf: The robot.
        held: Values by the joint's name; None for none.

    Raises:
        UrdfError: A joint does not exist or does not move, or its value is no number or of the wrong unit.
    """
    given = dict(held or {})
    moving = {joint.name: joint for joint in urdf.joints if joint.type in MOVING}
    for name, value in given.items():
        if name not in moving:
            raise UrdfError(
                f"{urdf.source}: the joint '{name}', to be held at {value:g}, is none that moves"
                f"{did_you_mean(name, moving)}. Joints that can be held: {choices(moving, limit=60)}."
            )
        fault = unit_fault(value, slides=moving[name].type == "prismatic")
        if fault is None and not np.isfinite(value):
            fault = f"is {value}; give a finite number"
        if fault is not None:
            raise UrdfError(f"{urdf.source}: the value that the joint '{name}' is held at {fault}.")
    return tuple(sorted((name, float(value)) for name, value in given.items()))


def all_values(
    urdf: Urdf,
    columns: Mapping[str, Array],
    held: Mapping[str, float],
    count: int,
) -> dict[str, Array]:
    """Return the value of every joint of a URDF that has one coordinate.

    Args:
        urdf: The robot.
        columns: Values of the joints that move freely, by name, each of shape (N,), [rad] or [m].
        held: Values of joints that stay where they are, by name [rad or m].
        count: N.

    Returns:
        Values by the joint's name, each of shape (N,), [rad] or [m]. A joint that is neither a column nor held nor
        mimics one is at zero, or at its mimic offset.
    """
    by_name = {joint.name: joint for joint in urdf.joints}
    result = {}
    for joint in urdf.joints:
        if joint.type in MOVING:
            try:
                rule = _rule(urdf.source, by_name, joint.name, held)
            except UrdfError:  # it mimics what cannot drive it; the chain's own joints were checked
                rule = _Rule(None, 0.0, 0.0)
            driver_values = np.zeros(count)
            if rule.driver is not None:
                driver_values = columns.get(rule.driver, driver_values)
            result[joint.name] = rule.factor * driver_values + rule.offset
    return result


@dataclass(frozen=True, slots=True)
class _Rule:
    """A joint's value by the one that drives it: factor * driver + offset."""

    #: Name of the driving joint, the joint itself where it moves freely; None where none drives it.
    driver: str | None
    factor: float
    #: [rad or m].
    offset: float


def _rule(
    source: str,
    by_name: Mapping[str, UrdfJoint],
    name: str,
    held: Mapping[str, float],
) -> _Rule:
    """Return how a joint follows the joint at the end of its chain of mimics.

    Args:
        source: Name of the URDF, for messages.
        by_name: All joints.
        name: The joint's name.
        held: Values [rad or m] of joints that stay where they are, by name.

    Raises:
        UrdfError: It mimics itself, a joint that does not exist, or one that cannot drive it.
    """
    factor = 1.0
    offset = 0.0
    followed = [name]
    while True:
        if name in held:
            return _Rule(None, 0.0, factor * held[name] + offset)
        joint = by_name[name]
        if joint.type == "fixed" or factor == 0.0:
            return _Rule(None, 0.0, offset)
        if joint.type not in MOVING:
            raise UrdfError(
                f"{source}: joint '{followed[0]}' mimics '{name}', which is of type '{joint.type}'; only "
                f"{choices(MOVING)} joints can drive others. Hold '{followed[0]}' at a value instead."
            )
        if joint.mimic is None:
            return _Rule(name, factor, offset)
        offset += factor * joint.mimic_offset
        factor *= joint.mimic_multiplier
        if joint.mimic not in by_name or joint.mimic in followed:
            fault = "which follows it in turn"
            if joint.mimic not in by_name:
                fault = f"which does not exist{did_you_mean(joint.mimic, by_name)}"
            raise UrdfError(
                f"{source}: joint '{name}' mimics '{joint.mimic}', {fault}. Correct the <mimic> in the URDF, or "
                f"hold '{name}' at a value."
            )
        name = joint.mimic
        followed.append(name)
