"""Parameters that stay nominal, named one by one or by a joint or a link of the URDF.

a parameter    itself
a joint        what moves its ``<origin>``, and its errors that depend on its state (gain, compliance ...)
a link         its shape: lengths and angles of the ``<origin>`` of each joint that is mounted on it; the zeros of
these joints are theirs, and stay free
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from calib.model.error_model import SETUP, TIP, Parameter
from calib.model.families import ANGLE, LENGTH
from calib.robot.robot import Robot


def frozen_parameters(
    robot: Robot, parameters: Sequence[Parameter], names: Iterable[str]
) -> tuple[str, ...]:
    """Return the names of the parameters that are kept nominal.

    Args:
        robot: The nominal robot.
        parameters: Those that a model has.
        names: Names of parameters, joints and links; of a name that several have the parameter's counts, then the
            joint's.

    Returns:
        Each once, in the order of ``names``; a name that is neither that of a parameter nor of a joint or link is
        returned as it is.
    """
    known = {parameter.name for parameter in parameters}
    joints = {joint.name for joint in robot.urdf.joints}
    of_robot = [parameter for parameter in parameters if parameter.family not in SETUP]
    result: list[str] = []
    for name in names:
        if name in known or not (name in joints or name in robot.urdf.links):
            result.append(name)
        elif name in joints:
            places = _places(robot, {name})
            result += [p.name for p in of_robot if p.place in places and p.factor is None]
            result += [p.name for p in of_robot if p.place == name and p.factor is not None]
        else:
            mounted = {joint.name for joint in robot.urdf.joints if joint.parent == name}
            places = _places(robot, mounted)
            shape = [p for p in of_robot if p.place in places and p.family in (LENGTH, ANGLE)]
            result += [p.name for p in shape]
    return tuple(dict.fromkeys(result))


def _places(robot: Robot, joints: set[str]) -> set[str]:
    """Return the places of parameters whose placement the ``<origin>`` of one of these URDF joints carries."""
    found = set()
    for limb in robot.limbs:
        names = [*(joint.name for joint in limb.joints), TIP]
        found |= {
            place
            for place, carrier in zip(names, limb.carriers, strict=True)
            if carrier is not None and carrier in joints
        }
    return found
