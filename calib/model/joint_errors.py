"""Errors of the joints' state: the parameters of their families, and how far they move the joints.

A unit of such a parameter moves its joint by the factor of its family, a function of the joints' values and loads;
joints that mimic it follow (`calib.model.families`). If readings are coupled, the joint's value counts, not its
reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array, read_only
from calib.model.error_model import Parameter, twist_of
from calib.model.families import ENDS, JointState, factor_of, family_of
from calib.robot.gravity import GRAVITY, gravity_loads
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.robot.urdf_tree import UrdfJoint

#: Lever arms that differ by no more than this in all poses count as the same [m].
_SAME_LEVER = 1e-6

#: Number of poses at which lever arms are compared.
_LEVER_POSES = 20


def joint_parameters(robot: Robot, family: str, gravity: ArrayLike = GRAVITY) -> list[Parameter]:
    """Return the parameters of one family of the joints' state, named ``<joint>.gain`` and so on.

    The measured joints have them, or all joints of the chain if the family says so; joints that slide have none if the
    family has no unit for them.

    Args:
        robot: The nominal robot.
        family: Name of the family, such as ``"gain"``.
        gravity: Shape (3,), acceleration in the URDF's root [m/s^2]. If a family has one parameter for each point of
            the chain (``gravity``), points whose masses load the joint alike under it share one.

    Raises:
        ModelError: There is no such family.
    """
    row = family_of(family)
    joints = robot.all_joints if row.every_joint else robot.inputs
    points: dict[str, list[str]] = {}
    if any(factor.later for factor in row.factors):
        acceleration = np.asarray(gravity, dtype=np.float64)
        points = _distinct_points(robot, tuple(acceleration.tolist()))
    parameters = []
    for joint in joints:
        unit = row.sliding if joint.type == "prismatic" else row.unit
        if unit is None:
            continue
        factors = list(row.factors)
        if points:
            at_points = points[joint.name]
            names = [f"{factor.name}[{point}]" for factor in factors for point in at_points]
            factors = [factor_of(name) for name in names]
        twist = _joint_twist(joint)
        for factor in factors:
            name = f"{joint.name}.{factor.name}"
            parameter = Parameter(name, unit.symbol, joint.name, twist, family, factor=factor)
            parameters.append(parameter)
    return parameters


@lru_cache(maxsize=16)
def _distinct_points(robot: Robot, gravity: tuple[float, ...]) -> dict[str, list[str]]:
    """Return, by the joint's name, the points of the chain where masses load each joint with different lever arms.

    Points are names of joints (for their origins) or of `ENDS`, in the order of the chain. Of points with equal lever
    arms in all trial poses there is the first; points without a lever arm about the joint are left out. Gravity is in
    the URDF's root [m/s^2].
    """
    q = spread_poses(robot, _LEVER_POSES)
    levers = gravity_loads(robot, q, None, gravity)[:, :, 1:]
    names = load_points(robot)
    points: dict[str, list[str]] = {}
    for i, joint in enumerate(robot.all_joints):
        distinct = [np.zeros(len(levers))]
        points[joint.name] = []
        for name, lever in zip(names, levers[:, i].T, strict=True):
            if all(np.abs(lever - known).max() > _SAME_LEVER for known in distinct):
                distinct.append(lever)
                points[joint.name].append(name)
    return points


def load_points(robot: Robot) -> tuple[str, ...]:
    """Return the names of the points whose lever arms `calib.robot.gravity.gravity_loads` gives, in its order.

    Args:
        robot: The robot, n joints in its chains.

    Returns:
        The n joints, for their origins, `ENDS`, and the links at the ends of the robot's branches.
    """
    joints = [joint.name for joint in robot.all_joints]
    return (*joints, *ENDS, *robot.ends[len(ENDS) :])


def axis_twists(robot: Robot) -> Array:
    """Return the twist of a unit, 1 m or 1 rad, of each joint in its own frame, shape (n, 6), linear then angular."""
    return read_only([_joint_twist(joint) for joint in robot.joints])


def _joint_twist(joint: UrdfJoint) -> Array:
    """Return the twist of a unit, 1 m or 1 rad, of a joint in its own frame, shape (6,): linear, then angular."""
    zeros = np.zeros(3)
    if joint.type == "prismatic":
        return twist_of(joint.axis, zeros)
    return twist_of(zeros, joint.axis)


def joint_displacements(
    robot: Robot,
    terms: Sequence[Parameter],
    q: Array,
    load: Array | None,
    moves: Array | None = None,
    loaded: Robot | None = None,
) -> Array:
    """Return how far a unit of each term moves each joint of the chain.

    Args:
        robot: The nominal robot, n joints in its chain.
        terms: Terms of an error model that have a ``factor``; those of joints beside the chain move nothing.
        q: Shape (N, m), readings of the measured joints, [rad] or [m].
        load: Loads of ``loaded``, see `calib.robot.gravity.gravity_loads`; None if not known.
        moves: Shape (N, m), last move of each measured joint's reading, [rad] or [m], 0 where it is not known; None:
            known nowhere.
        loaded: The robot of which ``robot`` is a chain, to whose joints the loads belong; None: ``robot`` itself.

    Returns:
        Shape (N, n, len(terms)), [rad or m] per unit of the term.

    Raises:
        ModelError: A term needs the loads, and they are not known.
    """
    chain = [joint.name for joint in robot.joints]
    whole = loaded or robot
    loaded_joints = tuple(joint.name for joint in whole.all_joints)
    points = load_points(whole)
    values = robot.input_values(q)
    moves_of_values = None if moves is None else values - robot.input_values(q - moves)
    moved = np.zeros((len(q), len(chain), len(terms)))
    for k, term in enumerate(terms):
        assert term.factor is not None
        if family_of(term.family).every_joint:
            driven = np.array([float(name == term.place) for name in chain])
        else:
            driven = robot.mimic_matrix[:, robot.joint_names.index(term.place)]
        state = JointState(
            joint=term.place,
            joint_names=robot.joint_names,
            values=values,
            chain=loaded_joints,
            points=points,
            loads=load,
            point=term.factor.point,
            moves=moves_of_values if term.factor.moved else None,
        )
        of_joint = term.factor.value(state)
        moved[:, :, k] = of_joint[:, None] * driven
    return moved
