"""The geometry of a chain: its placements, in path order, and the ``<origin>`` that holds each of them.

The path from base to tip may climb from the base to the link where the branches part, and then descend to the tip.
A joint of the base's side is walked from its child link to its parent, so that its motion and its origin O turn round:

    (O J(axis, q))^-1 = J(-axis, q) O^-1

With its axis turned round it is a joint like any other, at the same q, and the whole path is one serial chain.

Its joints may be more than the columns of q, where some mimic others or are held: q_chain = A q + b, with one column
for each joint that moves freely, a joint of the chain or the driver of one that mimics it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from calib.errors import UrdfError, choices, did_you_mean
from calib.robot.full_model import full_model
from calib.robot.urdf import Urdf, UrdfJoint, read_only
from calib.units import Array, unit_fault

MOVING = ("revolute", "continuous", "prismatic")
"""The types of joints that a chain may move by."""


#: Where an <origin> is in a placement: before, after, inverted; before @ origin (or its inverse) @ after.
Around: TypeAlias = tuple[Array, Array, bool]

#: joints, placements, carriers, T_root_base, around, base_moves, see `calib.robot.robot.Robot`.
Geometry: TypeAlias = tuple[
    tuple[UrdfJoint, ...], Array, tuple[str | None, ...], Array, tuple[Around, ...], bool
]


def chain_between(urdf: Urdf, base: str, tip: str) -> Geometry:
    """The path between two links as a serial chain of n moving joints."""
    path = _path(urdf, base, tip)
    moving = [step for step in path if step.joint.type != "fixed"]
    wrong = [step.joint for step in moving if step.joint.type not in MOVING]
    if not moving or wrong:
        types = [f"'{joint.name}' of type '{joint.type}'" for joint in wrong]
        fault = f"joint {types[0]} is not one of {choices(MOVING)}" if wrong else "no joint moves"
        raise UrdfError(
            f"{urdf.source}: {fault} between the base '{base}' and the tip '{tip}'. Name two links with the arm "
            f"between them by --base and --tip; the links are {choices(urdf.links)}."
        )
    full_model(urdf)  # which refuses what Pinocchio cannot read, or reads otherwise
    T_root_base, base_moves = np.eye(4), moving[0].up
    if not base_moves:  # then the chain starts in the URDF's root, joints above the base at zero
        T_root_base = _product(_path(urdf, urdf.root, base))
        path = _path(urdf, urdf.root, tip)
    names = {step.joint.name for step in moving}
    groups: list[list[_Step]] = [[]]  # the origins that each placement is the product of
    for step in path:
        if step.joint.name in names and step.up:  # it moves first, its origin comes behind it
            groups.append([])
        groups[-1].append(step)
        if step.joint.name in names and not step.up:
            groups.append([])
    carriers: list[str | None] = []
    around = []
    for k, group in enumerate(groups):
        # A moving joint's own origin, at the chain's ends else that of the fixed joint next to the moving one, so
        # that all that is mounted behind it moves along.
        last = k == 0 or (k < len(moving) and not moving[k].up)
        carrier = group[-1 if last else 0] if group else None
        before, after = (group[:-1], []) if last else ([], group[1:])
        around.append((_product(before), _product(after), carrier is not None and carrier.up))
        carriers.append(None if carrier is None else carrier.joint.name)
    return (
        tuple(step.path_joint for step in moving),
        read_only([_product(group) for group in groups]),
        tuple(carriers),
        read_only(T_root_base),
        tuple(around),
        base_moves,
    )


def rigid_inverse(T: Array) -> Array:
    """The inverses of poses, shape (..., 4, 4): (R^T, -R^T p)."""
    result = np.zeros_like(T)
    R_T = np.swapaxes(T[..., :3, :3], -1, -2)
    result[..., :3, :3] = R_T
    result[..., :3, 3] = -(R_T @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """A joint of the path, fixed ones included; ``up`` where it is walked from its child to its parent."""

    joint: UrdfJoint
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
    """All joints from base to tip: up to the link where the branches part, and down from there."""
    to_base, to_tip = urdf.chain(base, tip)
    up = [_Step(urdf.joint(name), up=True) for name in reversed(to_base)]
    return up + [_Step(urdf.joint(name), up=False) for name in to_tip]


def _product(steps: Sequence[_Step]) -> Array:
    """The product of the steps' origins, (4, 4)."""
    T = np.eye(4)
    for step in steps:
        T = T @ step.origin
    return T


def pinocchio_chain(joints: Sequence[UrdfJoint], placements: Array) -> pin.Model:
    """A Pinocchio model of n joints in a row, whose configuration is their values; a tip's placement is no part."""
    model = pin.Model()
    for parent, (joint, P) in enumerate(zip(joints, placements, strict=False)):
        slides = joint.type == "prismatic"
        kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
        model.addJoint(parent, kind(np.array(joint.axis)), pin.SE3(P), joint.name)
    return model


#: Names of a tip, in the order of preference, where several links lie equally far out.
_USUAL_TIPS = ("tool0", "tcp", "tool", "flange", "ee_link")


def farthest_link(
    urdf: Urdf, base: str, measured: Collection[str] | None = None, held: Collection[str] = ()
) -> str:
    """The link with the most moving joints between it and ``base``; a usual tip's name breaks ties.

    Only links that ``measured`` joints alone lead to count (all joints if None), if there are any; ``held`` joints lead
    on but do not count.
    """
    urdf.chain(base, base)  # raises, with the names there are, for a link that does not exist
    every = {joint.name for joint in urdf.joints}
    above, start = {joint.child: joint for joint in urdf.joints}, base
    while start in above and above[start].type == "fixed":
        start = above[start].parent
    below: dict[str, list[UrdfJoint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    for known in (every if measured is None else measured, every):
        count, waiting = {start: 0}, [start]
        for link in waiting:
            for joint in below.get(link, []):
                still = joint.type == "fixed" or joint.name in held
                moves = joint.type in MOVING and joint.mimic is None and joint.name in known
                if still or moves:
                    count[joint.child] = count[link] + (not still)
                    waiting.append(joint.child)
        if max(count.values()):
            break
    farthest = [link for link in count if count[link] == max(count.values())]
    return next((name for name in _USUAL_TIPS if name in farthest), farthest[-1])


def coupling(
    urdf: Urdf, joints: Sequence[UrdfJoint], held: Mapping[str, float]
) -> tuple[tuple[UrdfJoint, ...], Array, Array]:
    """How the n joints of a chain follow m columns: the joint of each column, A (n, m) and b (n,).

    A has 1 where a joint is its own column and the multiplier where it mimics another; b, [rad] or [m], has the offsets
    of mimic joints and held values.
    """
    # A joint of the chain may have its axis turned round.
    by_name = {joint.name: joint for joint in (*urdf.joints, *joints)}
    rules = [_rule(urdf.source, by_name, joint.name, held) for joint in joints]
    drivers = list(dict.fromkeys(driver for driver, _, _ in rules if driver is not None))
    if not drivers:
        raise UrdfError(
            f"{urdf.source}: the joints of the chain are {choices(joint.name for joint in joints)}, and none of "
            "them is left to move: each is held at a value or mimics one that is. Hold fewer joints."
        )
    matrix = np.zeros((len(joints), len(drivers)))
    for row, (driver, factor, _) in zip(matrix, rules, strict=True):
        if driver is not None:
            row[drivers.index(driver)] = factor
    columns = tuple(by_name[name] for name in drivers)
    return columns, read_only(matrix), read_only([offset for _, _, offset in rules])


def checked_held(urdf: Urdf, held: Mapping[str, float] | None) -> tuple[tuple[str, float], ...]:
    """The held joints and their values [rad or m], by name."""
    given = dict(held or {})
    moving = {joint.name: joint for joint in urdf.joints if joint.type in MOVING}
    for name, value in given.items():
        if name not in moving:
            raise UrdfError(
                f"{urdf.source}: the joint '{name}', to be held at {value:g}, is none that moves"
                f"{did_you_mean(name, moving)}. Joints that can be held: {choices(moving, limit=60)}."
            )
        fault = unit_fault(value, slides=moving[name].type == "prismatic")
        if fault is not None or not np.isfinite(value):
            fault = fault or f"is {value}; give a finite number"
            raise UrdfError(f"{urdf.source}: the value that the joint '{name}' is held at {fault}.")
    return tuple(sorted((name, float(value)) for name, value in given.items()))


def all_values(
    urdf: Urdf, columns: Mapping[str, Array], held: Mapping[str, float], count: int
) -> dict[str, Array]:
    """The value of every joint of a URDF that has one coordinate, by name, shape (N,), [rad] or [m].

    A joint that is neither a column nor held nor follows one is at zero, or at its mimic offset.
    """
    by_name = {joint.name: joint for joint in urdf.joints}
    result = {}
    for joint in urdf.joints:
        if joint.type in MOVING:
            try:
                driver, factor, offset = _rule(urdf.source, by_name, joint.name, held)
            except UrdfError:  # it follows nothing; the chain's own joints were checked
                driver, factor, offset = None, 0.0, 0.0
            moved = np.zeros(count) if driver is None else columns.get(driver, np.zeros(count))
            result[joint.name] = factor * moved + offset
    return result


def _rule(
    source: str, by_name: Mapping[str, UrdfJoint], name: str, held: Mapping[str, float]
) -> tuple[str | None, float, float]:
    """Driver, factor, offset: a joint's value is factor * driver + offset, or the offset where none drives it."""
    factor, offset = 1.0, 0.0
    followed = [name]
    while True:
        if name in held:
            return None, 0.0, factor * held[name] + offset
        joint = by_name[name]
        if joint.type == "fixed" or factor == 0.0:
            return None, 0.0, offset
        if joint.type not in MOVING:
            raise UrdfError(
                f"{source}: joint '{followed[0]}' mimics '{name}', which is of type '{joint.type}'; only "
                f"{choices(MOVING)} joints can drive others. Hold '{followed[0]}' at a value instead."
            )
        if joint.mimic is None:
            return name, factor, offset
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
