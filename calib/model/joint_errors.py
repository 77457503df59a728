"""Errors of the joints' state: the parameters of their families, and how far they move the joints."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from calib.model.families import ENDS, JointState, factor_of, family_of
from calib.model.parameters import Parameter, twist_of
from calib.robot.gravity import GRAVITY, gravity_loads
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot, read_only
from calib.robot.urdf import UrdfJoint
from calib.units import Array

#: Lever arms that differ by less at so many poses are one [m].
_NO_LEVER, _POSES = 1e-6, 20


def joint_parameters(robot: Robot, family: str, gravity: ArrayLike = GRAVITY) -> list[Parameter]:
    """The parameters of one family of the joints' state, named ``<joint>.gain`` and so on; ModelError without such."""
    row = family_of(family)
    joints = robot.joints if row.every_joint else robot.inputs
    units = [(j, row.sliding if j.type == "prismatic" else row.unit) for j in joints]
    factors = [(j, u, f) for j, u in units for f in row.factors if u is not None]
    if any(f.later for f in row.factors):
        points = _later_points(robot, tuple(np.asarray(gravity, dtype=np.float64).tolist()))
        factors = [
            (j, u, factor_of(f"{f.name}[{point}]"))
            for j, u, f in factors
            for point in points[j.name]
        ]
    return [
        Parameter(f"{j.name}.{f.name}", u.symbol, j.name, _joint_twist(j), family, factor=f)
        for j, u, f in factors
    ]


@lru_cache(maxsize=16)
def _later_points(robot: Robot, gravity: tuple[float, ...]) -> dict[str, list[str]]:
    """The points at which a mass loads each joint: of those that it cannot tell apart the first."""
    levers = gravity_loads(robot, spread_poses(robot, _POSES), None, gravity)[:, :, 1:]
    names = (*(joint.name for joint in robot.joints), *ENDS)
    points: dict[str, list[str]] = {}
    for i, joint in enumerate(robot.joints):
        told = [np.zeros(len(levers))]
        points[joint.name] = own = []
        for name, column in zip(names, levers[:, i].T, strict=True):
            if all(np.abs(column - other).max() > _NO_LEVER for other in told):
                told.append(column)
                own.append(name)
    return points


def axis_twists(robot: Robot) -> Array:
    """The twist of a unit of each joint of the chain, in its own frame, shape (n, 6)."""
    return read_only([_joint_twist(joint) for joint in robot.joints])


def _joint_twist(joint: UrdfJoint) -> Array:
    """The twist of a unit of a joint."""
    zeros = np.zeros(3)
    return twist_of(joint.axis, zeros) if joint.type == "prismatic" else twist_of(zeros, joint.axis)


def joint_displacements(
    robot: Robot, terms: Sequence[Parameter], q: Array, load: Array | None
) -> Array:
    """How far a unit of each term, with a ``factor``, moves each joint of the chain, shape (N, n, len(terms))."""
    joints, names = tuple(joint.name for joint in robot.joints), robot.joint_names
    moved = np.zeros((len(q), len(joints), len(terms)))
    for k, term in enumerate(terms):
        assert term.factor is not None
        if family_of(term.family).every_joint:
            driven: Array = np.eye(len(joints))[joints.index(term.place)]
        else:
            driven = robot.coupling[:, names.index(term.place)]
        state = JointState(term.place, names, q, joints, load, term.factor.point)
        moved[:, :, k] = term.factor.value(state)[:, None] * driven
    return moved
