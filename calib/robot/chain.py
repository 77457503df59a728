"""The geometry of a chain: its placements, in path order, and the ``<origin>`` that holds each of them.

The path from base to tip may climb from the base to the link where the branches part, and then descend to the tip.
A joint on the base's side is passed from its child link to its parent, which reverses its motion and its origin O:

    (O J(axis, q))^-1 = J(-axis, q) O^-1

With its axis reversed it is a joint like any other, at the same q, and the whole path is one serial chain.

The chain may have more joints than q has columns, if some mimic others or are held: q_chain = A theta + b, with one
column for each joint that moves freely, a joint of the chain or the driver of one that mimics it. theta = q unless
readings are coupled (`calib.robot.coupled_readings`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.units import unit_fault
from calib.basics.values import Value
from calib.errors import UrdfError, choices, did_you_mean
from calib.robot.full_model import full_model
from calib.robot.urdf import Urdf
from calib.robot.urdf_tree import UrdfJoint

MOVING = ("revolute", "continuous", "prismatic")
"""The types of joints that a chain may move by."""


@dataclass(frozen=True, slots=True, eq=False)
class OriginFactors(Value):
    """A placement as the product of a URDF joint's ``<origin>`` O and constant poses: before O after.

    If no ``<origin>`` holds the placement, the constants are identities.
    """

    #: Shape (4, 4), [m].
    before: Array
    #: Shape (4, 4), [m].
    after: Array
    #: True if the path passes the joint from child to parent: before O^-1 after.
    inverted: bool

    def origin(self, placement: Array) -> Array:
        """Return the ``<origin>`` O of a placement, both of shape (4, 4), [m]."""
        factor = rigid_inverse(self.before) @ placement @ rigid_inverse(self.after)
        if self.inverted:
            return rigid_inverse(factor)
        return factor


class OnPath(NamedTuple):
    """The place of a URDF joint's ``<origin>`` in a chain: the placement that it is a factor of."""

    #: Index of the placement that it is a factor of, from 0.
    placement: int
    #: That placement by this ``<origin>``.
    factors: OriginFactors


@dataclass(frozen=True, slots=True, eq=False)
class SerialChain:
    """The path between two links as a serial chain of n moving joints; see `calib.robot.robot.Robot`."""

    #: Base to tip, n of them; those on the base's side with the axis reversed.
    joints: tuple[UrdfJoint, ...]
    #: Shape (n + 1, 4, 4), [m]: of each joint in the one before it, of the tip in the last.
    placements: Array
    #: n + 1 names of URDF joints whose ``<origin>`` holds the placement; None if a moving joint carries the end.
    carriers: tuple[str | None, ...]
    #: Shape (4, 4), [m], pose of the base in the frame that the first placement is given in.
    T_root_base: Array
    #: The n + 1 placements as products of an ``<origin>`` and constants.
    factors: tuple[OriginFactors, ...]
    #: The URDF joints between base and tip, fixed ones too, by name: see `OnPath`.
    path: Mapping[str, OnPath]
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
            Pinocchio reads the URDF differently from what is written.
    """
    path = _path(urdf, base, tip)
    between = {step.joint.name for step in path}
    moving = [step for step in path if step.joint.type != "fixed"]
    mjcf = urdf.mjcf
    for step in path:
        if mjcf is not None and step.joint.name in mjcf.refused:
            raise UrdfError(
                f"{mjcf.refused[step.joint.name]}, or name other links by --base and --tip."
            )
    wrong = [step.joint for step in moving if step.joint.type not in MOVING]
    if wrong or not moving:
        fault = "no joint moves"
        if wrong:
            fault = (
                f"joint '{wrong[0].name}' of type '{wrong[0].type}' is not one of {choices(MOVING)}"
            )
        raise UrdfError(
            f"{urdf.source}: {fault} between the base '{base}' and the tip '{tip}'. Name two links with the arm "
            f"between them by --base and --tip; the links are {choices(urdf.links)}."
        )
    full_model(urdf)  # which refuses what Pinocchio cannot read, or reads differently
    T_root_base = np.eye(4)
    if not moving[0].up:
        # The chain starts in the URDF's root, with the joints above the base at zero.
        T_root_base = _product(_path(urdf, urdf.root, base))
        path = _path(urdf, urdf.root, tip)

    # The steps whose origins each of the n + 1 placements is the product of.
    groups: list[list[_Step]] = [[]]
    names = {step.joint.name for step in moving}
    for step in path:
        moves = step.joint.name in names
        if moves and step.up:  # its motion comes before its origin
            groups.append([])
        groups[-1].append(step)
        if moves and not step.up:
            groups.append([])

    carriers: list[str | None] = []
    factors = []
    on_path = {}
    for k, group in enumerate(groups):
        for i, step in enumerate(group):
            if step.joint.name in between:
                by_step = OriginFactors(_product(group[:i]), _product(group[i + 1 :]), step.up)
                on_path[step.joint.name] = OnPath(k, by_step)
        # A moving joint's own origin carries the placement; at the chain's ends that of the fixed joint next to the
        # moving one, so that everything mounted on it moves along.
        carried_by_last = k == 0 or (k < len(moving) and not moving[k].up)
        carrier = None
        by_carrier = OriginFactors(np.eye(4), np.eye(4), inverted=False)
        if group:
            i = len(group) - 1 if carried_by_last else 0
            carrier = group[i].joint.name
            by_carrier = OriginFactors(_product(group[:i]), _product(group[i + 1 :]), group[i].up)
        carriers.append(carrier)
        factors.append(by_carrier)
    return SerialChain(
        joints=tuple(step.path_joint for step in moving),
        placements=read_only([_product(group) for group in groups]),
        carriers=tuple(carriers),
        T_root_base=read_only(T_root_base),
        factors=tuple(factors),
        path=on_path,
        base_moves=moving[0].up,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """A joint of the path, fixed ones included."""

    joint: UrdfJoint
    #: True if the path goes from the joint's child link to its parent.
    up: bool

    @property
    def origin(self) -> Array:
        """The factor that the joint's origin is in the path, shape (4, 4), [m]."""
        T = self.joint.T_parent_joint
        return rigid_inverse(T) if self.up else T

    @property
    def path_joint(self) -> UrdfJoint:
        """The joint, its axis reversed if the path passes it from child to parent."""
        if not self.up:
            return self.joint
        return replace(self.joint, axis=read_only(-self.joint.axis + 0.0))


def _path(urdf: Urdf, base: str, tip: str) -> list[_Step]:
    """Return all joints from base to tip: up to the link where the branches part, and down from it."""
    to_base, to_tip = urdf.chain(base, tip)
    up = [_Step(urdf.joint(name), up=True) for name in reversed(to_base)]
    return up + [_Step(urdf.joint(name), up=False) for name in to_tip]


def _product(steps: Sequence[_Step]) -> Array:
    """Return the product of the origins of steps of a path, shape (4, 4) [m]."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """Motion of a chain's n joints with the m joints that move freely: q_chain = A theta + b."""

    #: The m joints that move freely, one for each column of q; the driver of a mimic joint may lie beside the chain.
    inputs: tuple[UrdfJoint, ...]
    #: A, shape (n, m): 1 if a joint is its own column, the multiplier if it mimics another.
    matrix: Array
    #: b, shape (n,), offsets of mimic joints and held values [rad or m].
    offset: Array


def coupling_of(urdf: Urdf, joints: Sequence[UrdfJoint], held: Mapping[str, float]) -> Coupling:
    """Return the motion of a chain with the joints that move freely, q_chain = A theta + b.

    Args:
        urdf: The robot.
        joints: The n joints of the chain, base to tip.
        held: Values [rad or m] of joints that stay where they are, by name.

    Raises:
        UrdfError: No joint is left to move, or one mimics what cannot drive it.
    """
    # A joint of the chain may have its axis reversed.
    by_name = {joint.name: joint for joint in (*urdf.joints, *joints)}
    followed = [driver_of(urdf.source, by_name, joint.name, held) for joint in joints]
    drivers = list(dict.fromkeys(driver for driver, _, _ in followed if driver is not None))
    if not drivers:
        raise UrdfError(
            f"{urdf.source}: the joints of the chain are {choices(joint.name for joint in joints)}, and none of "
            "them is left to move: each is held at a value or mimics one that is. Hold fewer joints."
        )
    matrix = np.zeros((len(joints), len(drivers)))
    for row, (driver, factor, _) in zip(matrix, followed, strict=True):
        if driver is not None:
            row[drivers.index(driver)] = factor
    return Coupling(
        inputs=tuple(by_name[name] for name in drivers),
        matrix=read_only(matrix),
        offset=read_only([offset for _, _, offset in followed]),
    )


def checked_held(urdf: Urdf, held: Mapping[str, float] | None) -> tuple[tuple[str, float], ...]:
    """Return the held joints and their values [rad or m], sorted by name.

    Args:
        urdf: The robot.
        held: Values by the joint's name; None for none.

    Raises:
        UrdfError: A joint does not exist or does not move, or its value is not finite or has the wrong unit.
    """
    given = dict(held or {})
    moving = {joint.name: joint for joint in urdf.joints if joint.type in MOVING}
    for name, value in given.items():
        if name not in moving:
            raise UrdfError(
                f"{urdf.source}: the joint '{name}', to be held at {value:g}, is not a joint that moves"
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
        Values by the joint's name, each of shape (N,), [rad] or [m]. A joint that is not a column, is not held and
        mimics no such joint is at zero, or at its mimic offset.
    """
    by_name = {joint.name: joint for joint in urdf.joints}
    result = {}
    for joint in urdf.joints:
        if joint.type in MOVING:
            try:
                driver, factor, offset = driver_of(urdf.source, by_name, joint.name, held)
            except UrdfError:  # it mimics what cannot drive it; the chain's own joints were checked
                driver, factor, offset = None, 0.0, 0.0
            driver_values = np.zeros(count)
            if driver is not None:
                driver_values = columns.get(driver, driver_values)
            result[joint.name] = factor * driver_values + offset
    return result


def driver_of(
    source: str,
    by_name: Mapping[str, UrdfJoint],
    name: str,
    held: Mapping[str, float],
) -> tuple[str | None, float, float]:
    """Return what moves a joint: the driver, factor and offset of its value, factor * driver + offset.

    Args:
        source: Name of the URDF, for messages.
        by_name: Its joints.
        name: The joint.
        held: Values [rad or m] of joints that stay where they are, by name.

    Returns:
        The joint at the end of its chain of mimics, itself if it moves freely, None if it does not move; the factor;
        the offset [rad or m].

    Raises:
        UrdfError: It mimics itself, a joint that does not exist, or one that cannot drive it.
    """
    factor = 1.0
    offset = 0.0
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
