"""Errors that change with the joints' state: gear gain, eccentricity, compliance.

Each moves a joint about (along) its own axis by a parameter times a known number of the state:

    gain          dq = g q
    eccentricity  dq = s sin q + c cos q       the encoder's once-per-turn error
    compliance    dq = c tau                   tau: the load on the joint, by gravity and payload, or measured

No URDF can hold them. Sources: J. Hollerbach, W. Khalil, M. Gautier, Handbook of Robotics, ch. 6 (gain, compliance);
the once-per-turn error is what an encoder disc that is off its axis shows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError, choices
from calib.model.parameters import COMPLIANCE, ECCENTRICITY, GAIN, JOINT_FAMILIES, Parameter
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

VALUE, SIN, COS, LOAD = "value", "sin", "cos", "load"


def joint_parameters(robot: Robot, family: str) -> list[Parameter]:
    """The parameters of one family of `JOINT_FAMILIES`, named ``<joint>.gain`` and so on.

    Gain and eccentricity belong to a measured joint, and move all joints that follow it; compliance belongs to every
    joint of the chain. Prismatic joints have no eccentricity.

    Raises:
        ModelError: No such family.
    """
    if family not in JOINT_FAMILIES:
        message = f"There is no family '{family}' to add to a model. Choose among {choices(JOINT_FAMILIES)}."
        raise ModelError(message)
    parameters = []
    for joint in robot.joints if family == COMPLIANCE else robot.inputs:
        slides = joint.type == "prismatic"
        twist = _axis_twist(joint.axis, slides=slides)
        if family == GAIN:
            parameters.append(
                Parameter(
                    f"{joint.name}.gain",
                    "m/m" if slides else "1",
                    joint.name,
                    twist,
                    GAIN,
                    factor=VALUE,
                )
            )
        elif family == COMPLIANCE:
            unit = "m/N" if slides else "rad/Nm"
            name = f"{joint.name}.compliance"
            parameters.append(Parameter(name, unit, joint.name, twist, COMPLIANCE, factor=LOAD))
        elif not slides:
            parameters += [
                Parameter(
                    f"{joint.name}.{part}", "rad", joint.name, twist, ECCENTRICITY, factor=part
                )
                for part in (SIN, COS)
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
        load: shape (N, n), torque or force on each joint [Nm, N]; needed for compliance only.

    Raises:
        ModelError: A compliance, and no load.
    """
    moved = np.zeros((len(q), len(robot.joints), len(terms)))
    chain = [joint.name for joint in robot.joints]
    for k, term in enumerate(terms):
        number = factor_of(robot, term, q, load)
        if term.factor == LOAD:
            moved[:, chain.index(term.place), k] = number
        else:
            column = robot.joint_names.index(term.place)
            moved[:, :, k] = number[:, None] * robot.coupling[:, column]
    return moved


def factor_of(robot: Robot, term: Parameter, q: Array, load: Array | None) -> Array:
    """The known number of the joints' state that multiplies a term, shape (N,); see `joint_displacements`.

    Raises:
        ModelError: A compliance, and no load.
    """
    if term.factor == LOAD:
        if load is None:
            message = f"'{term.name}' needs the load on the joints. Give it with the joint values."
            raise ModelError(message)
        return load[:, [joint.name for joint in robot.joints].index(term.place)]
    own = q[:, robot.joint_names.index(term.place)]
    return own if term.factor == VALUE else np.sin(own) if term.factor == SIN else np.cos(own)


def axis_twists(robot: Robot) -> Array:
    """The twist of a unit of each joint of the chain, in its own frame, shape (n, 6)."""
    return read_only(
        [_axis_twist(joint.axis, slides=joint.type == "prismatic") for joint in robot.joints]
    )


def _axis_twist(axis: Array, *, slides: bool) -> Array:
    """The twist of a unit of a joint."""
    nothing = np.zeros(3)
    return read_only(np.concatenate([axis, nothing] if slides else [nothing, axis]))
