"""What the joints of a chain are moved by: measured columns, joints that they mimic, values that are held.

    q_chain = A q + b

with one column of q for each joint that moves freely: a joint of the chain, or the driver of one that mimics it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import UrdfError, choices, did_you_mean
from calib.robot.chain import MOVING, read_only
from calib.robot.urdf import Urdf, UrdfJoint
from calib.units import unit_fault

Array = NDArray[np.float64]


def coupling(
    urdf: Urdf, joints: Sequence[UrdfJoint], held: Mapping[str, float]
) -> tuple[tuple[UrdfJoint, ...], Array, Array]:
    """How the n joints of a chain follow m columns.

    Args:
        urdf: The URDF that they are of.
        joints: Base to tip.
        held: Values of joints that do not move, see `checked_held`.

    Returns:
        The joint of each column, in the order in which the joints first need them; A, shape (n, m), 1 where a joint is
        its own column and the multiplier where it mimics another; b, shape (n,), [rad] or [m]: offsets of mimic
        joints, and held values.

    Raises:
        UrdfError: A joint mimics one that does not exist, that moves by more than one coordinate or that
            mimics it in turn; or every joint is held.
    """
    by_name = {joint.name: joint for joint in urdf.joints}
    # A joint of the chain may have its axis turned round.
    by_name |= {joint.name: joint for joint in joints}
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
    columns = tuple(by_name[name] for name in drivers)
    return columns, read_only(matrix), read_only([rule.offset for rule in rules])


def checked_held(urdf: Urdf, held: Mapping[str, float] | None) -> tuple[tuple[str, float], ...]:
    """The held joints and their values [rad or m], by name.

    Raises:
        UrdfError: No such joint, one that has not exactly one coordinate, or a value that is not finite or in a
            unit that is not the joint's.
    """
    given = dict(held or {})
    by_name = {joint.name: joint for joint in urdf.joints}
    moving = [joint.name for joint in urdf.joints if joint.type in MOVING]
    for name, value in given.items():
        if name not in moving:
            is_what = f"is of type '{by_name[name].type}'" if name in by_name else "does not exist"
            raise UrdfError(
                f"{urdf.source}: the joint '{name}', to be held at {value:g}, {is_what}"
                f"{did_you_mean(name, moving)}. Joints that can be held: {choices(moving, limit=60)}."
            )
        if not np.isfinite(value):
            raise UrdfError(
                f"{urdf.source}: the joint '{name}' is to be held at {value}; give a finite number."
            )
        fault = unit_fault(value, slides=by_name[name].type == "prismatic")
        if fault is not None:
            raise UrdfError(f"{urdf.source}: the value that the joint '{name}' is held at {fault}.")
    return tuple(sorted((name, float(value)) for name, value in given.items()))


def all_values(
    urdf: Urdf, columns: Mapping[str, Array], held: Mapping[str, float], count: int
) -> dict[str, Array]:
    """The value of every joint of a URDF that has one coordinate.

    A joint that is neither a column nor held nor follows one is at zero, or at its mimic offset.

    Args:
        urdf: The URDF.
        columns: The measured joints' values, shape (N,) each, [rad] or [m].
        held: Values of joints that do not move.
        count: N.

    Returns:
        By joint, shape (N,), [rad] or [m].
    """
    by_name = {joint.name: joint for joint in urdf.joints}
    result = {}
    for joint in urdf.joints:
        if joint.type not in MOVING:
            continue
        try:
            rule = _rule(urdf.source, by_name, joint.name, held)
        except UrdfError:  # it follows nothing that there is; the chain's own joints were checked
            rule = _Rule(None, 0.0, 0.0)
        moved = np.zeros(count) if rule.driver is None else columns.get(rule.driver, 0.0)
        result[joint.name] = np.asarray(rule.factor * moved + rule.offset + np.zeros(count))
    return result


@dataclass(frozen=True, slots=True)
class _Rule:
    """A joint's value: factor * value of the driver + offset, or the offset alone where there is no driver."""

    driver: str | None
    factor: float
    offset: float


def _rule(
    source: str, by_name: Mapping[str, UrdfJoint], name: str, held: Mapping[str, float]
) -> _Rule:
    """Follow a joint to the one that moves it, through joints that mimic others in turn."""
    factor, offset = 1.0, 0.0
    followed = [name]
    while True:
        if name in held:
            return _Rule(None, 0.0, factor * held[name] + offset)
        joint = by_name[name]
        if joint.type == "fixed":
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
            fault = (
                f"which does not exist{did_you_mean(joint.mimic, by_name)}"
                if joint.mimic not in by_name
                else "which follows it in turn"
            )
            raise UrdfError(
                f"{source}: joint '{name}' mimics '{joint.mimic}', {fault}. Correct the <mimic> in the URDF, or "
                f"hold '{name}' at a value."
            )
        name = joint.mimic
        followed.append(name)
        if factor == 0.0:
            return _Rule(None, 0.0, offset)
