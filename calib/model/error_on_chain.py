"""Errors of a robot's limbs, carried over to a chain that passes them in another way.

An error moves the <origin> O of a URDF joint, O' = O exp(xi x). A chain has O as a factor of one of its placements, as
it stands or, where the chain passes the joint from child to parent, inverted (`calib.robot.chain.OnPath`):

    P = before O after       P' = P exp(Ad(after^-1) xi x)
    P = before O^-1 after    P' = P exp(-Ad(after^-1 O) xi x)

An error of a joint that the chain does not pass has no effect on it.
"""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.model.error_model import TIP, ErrorModel, Parameter
from calib.robot.chain import OnPath
from calib.robot.robot import Robot


def model_on_chain(model: ErrorModel, robot: Robot, chain: Robot) -> ErrorModel:
    """Return the model with the same p parameters, whose terms are those that act on one chain of a robot.

    Args:
        model: Errors of the limbs of ``robot``, see `calib.model.parameter_sets.error_model`.
        robot: The robot; if it is no tree, the model stays as it is.
        chain: One of its ``chains``.

    Returns:
        The model, its places those of ``chain``, its terms in the order in which they act there.
    """
    if not robot.is_tree:
        return model
    of_limbs = {*(joint.name for joint in robot.all_joints), *robot.mounts}
    at_origin: dict[str, list[int]] = {}
    kept = []
    for t, term in enumerate(model.terms):
        moves_a_placement = term.factor is None and term.internal is None
        if moves_a_placement and term.place in of_limbs:
            at_origin.setdefault(term.place, []).append(t)
        else:
            kept.append((t, term))
    for name, on_path in chain.path.items():
        T_parent_joint = robot.urdf.joint(name).T_parent_joint
        numbers = at_origin.get(name, [])
        # The inverse of a product has the factors in the opposite order.
        if on_path.factors.inverted:
            numbers = numbers[::-1]
        kept += [
            (t, _carried_over(model.terms[t], chain, on_path, T_parent_joint)) for t in numbers
        ]

    of_frames_or_targets = [place for place in model.places if place not in of_limbs]
    first_target = next(
        (k for k, place in enumerate(of_frames_or_targets) if place == TIP),
        len(of_frames_or_targets),
    )
    return replace(
        model,
        places=(
            *of_frames_or_targets[:first_target],
            *(joint.name for joint in chain.joints),
            *of_frames_or_targets[first_target:],
        ),
        terms=tuple(term for _, term in kept),
        mixing=read_only(model.mixing[[t for t, _ in kept]]),
    )


def _carried_over(
    term: Parameter, chain: Robot, on_path: OnPath, T_parent_joint: Array
) -> Parameter:
    """Return a term of the <origin> of a joint, (4, 4) [m], at the placement of a chain that has it as a factor."""
    T_joint_place = on_path.factors.after
    sign = 1.0
    if on_path.factors.inverted:
        T_joint_place = rigid_inverse(T_parent_joint) @ T_joint_place
        sign = -1.0
    twist = sign * pin.SE3(T_joint_place).toActionMatrixInverse() @ term.direction
    k = on_path.placement
    place = chain.joints[k].name if k < len(chain.joints) else TIP
    return replace(term, place=place, direction=read_only(twist))
