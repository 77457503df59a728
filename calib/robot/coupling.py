"""What the joints of a chain are moved by: measured columns, joints that they mimic, values that are held.

    q_chain = A q + b

with one column of q for each joint that moves freely: a joint of the chain, or the driver of one that mimics it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
