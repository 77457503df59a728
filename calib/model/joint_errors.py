"""The parameters of the joints' state, and how far they move the joints; `calib.families` has the rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError
from calib.families import JointState, family_of
from calib.model.parameters import Parameter
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]


def joint_parameters(robot: Robot, family: str) -> list[Parameter]:
    """The parameters of one family of the joints' state, named ``<joint>.gain`` and so on.

    Raises:
        ModelError: No such family, or one of the geometry.
    """
    row = family_of(family)
    if row.geometric:
        raise ModelError(
            f"'{family}' is a family of the geometry: it belongs to a parameter set, and cannot be added to one."
        )
    parameters = []
    for joint in robot.joints if row.every_joint else robot.inputs:
        slides = joint.type == "prismatic"
        unit = row.sliding if slides else row.unit
        if unit is None:
            continue
        twist = _axis_twist(joint.axis, slides=slides)
        parameters += [
            Parameter(
                f"{joint.name}.{factor.name}",
                unit.symbol,
                joint.name,
                twist,
                family,
                factor=factor,
            )
            for factor in row.factors
        ]
    return parameters


def joint_displacements(
    robot: Robot, terms: Sequence[Parameter], q: Array, load: Array | None
) -> Array:
    """How far a unit of each term moves each joint of the chain, shape (N, n, len(terms)).

    Args:
        robot: The robot, n joints in its chain.
        terms: With a ``factor``.
        q: shape (N, m), values of the measured joints, [rad] or [m].
        load: shape (N, n), torque or force on each joint [Nm, N]; None if no term needs it.

    Raises:
        ModelError: A term needs the load, and there is none.
    """
    moved = np.zeros((len(q), len(robot.joints), len(terms)))
    driven = driven_joints(robot, terms)
    for k, term in enumerate(terms):
        moved[:, :, k] = factor_of(robot, term, q, load)[:, None] * driven[k]
    return moved


def driven_joints(robot: Robot, terms: Sequence[Parameter]) -> Array:
    """How far each joint of the chain moves where a term moves its own joint by one, shape (len(terms), n)."""
    names = [joint.name for joint in robot.joints]
    rows = [
        np.eye(len(names))[names.index(term.place)]
        if family_of(term.family).every_joint
        else robot.coupling[:, robot.joint_names.index(term.place)]
        for term in terms
    ]
    return np.array(rows).reshape(-1, len(names))


def factor_of(robot: Robot, term: Parameter, q: Array, load: Array | None) -> Array:
    """The known number of the joints' state that multiplies a term, shape (N,); see `joint_displacements`.

    Raises:
        ModelError: It needs the load, and there is none; or the term has no factor.
    """
    if term.factor is None:
        raise ModelError(
            f"'{term.name}' is an error of the geometry; no number of the joints' state multiplies it."
        )
    return term.factor.value(_state(robot, term, q, load))


def slope_of(robot: Robot, term: Parameter, q: Array, load: Array | None) -> Array:
    """The derivative of `factor_of` by the joint's own value, shape (N,).

    Raises:
        ModelError: It needs the load, and there is none; or the term has no factor.
    """
    if term.factor is None:
        raise ModelError(
            f"'{term.name}' is an error of the geometry; no number of the joints' state multiplies it."
        )
    if term.factor.slope is None:
        return np.zeros(len(q))
    return term.factor.slope(_state(robot, term, q, load))


def _state(robot: Robot, term: Parameter, q: Array, load: Array | None) -> JointState:
    """The joints' state as the factor of a term sees it."""
    chain = tuple(joint.name for joint in robot.joints)
    return JointState(term.place, robot.joint_names, q, chain, load)


def axis_twists(robot: Robot) -> Array:
    """The twist of a unit of each joint of the chain, in its own frame, shape (n, 6)."""
    return read_only(
        [_axis_twist(joint.axis, slides=joint.type == "prismatic") for joint in robot.joints]
    )


def _axis_twist(axis: Array, *, slides: bool) -> Array:
    """The twist of a unit of a joint."""
    nothing = np.zeros(3)
    return read_only(np.concatenate([axis, nothing] if slides else [nothing, axis]))
