"""The Pinocchio model of all of a URDF: every joint, also those beside a chain."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import lru_cache

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from calib.errors import UrdfError, choices
from calib.robot.urdf import Urdf
from calib.units import Array

#: What stands before the links' names in the Pinocchio model.
_LINK = "link:"


def full_model(urdf: Urdf) -> pin.Model:
    """The Pinocchio model of all of a URDF, mimic joints free; links are found by `link_frame`."""
    return _built_model(urdf).copy()


@lru_cache(maxsize=8)
def _built_model(urdf: Urdf) -> pin.Model:
    """What `full_model` hands out copies of: reading the XML takes ten times as long as a copy."""
    try:
        model = pin.buildModelFromXML(urdf.data.decode(urdf.encoding))
    except (ValueError, RuntimeError) as error:
        raise UrdfError(
            f"{urdf.source}: Pinocchio cannot build a model of this URDF: {error}"
        ) from error
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    bodies = [i for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    T = {model.frames[i].name: data.oMf[i].homogeneous for i in bodies}
    # It reads some numbers and names otherwise than they are written.
    wrong = [
        joint.name
        for joint in urdf.joints
        if not {joint.parent, joint.child} <= T.keys()
        or not np.allclose(T[joint.parent] @ joint.T_parent_joint, T[joint.child], 1e-9, 1e-9)
    ]
    if wrong:
        raise UrdfError(
            f"{urdf.source}: Pinocchio reads the joints {choices(wrong)} in another way than they are written. Look "
            "for unusual characters in numbers and names, and for comments inside of tags."
        )
    # Pinocchio cannot lock a joint that shares its name with a link, as ANYmal's do: let links be told apart.
    for i in bodies:
        model.frames[i].name = _LINK + model.frames[i].name
    return model


def full_configurations(model: pin.Model, values: Mapping[str, Array]) -> Array:
    """Pinocchio's configurations of a `full_model`, shape (N, nq), from `Robot.urdf_values`; other joints neutral."""
    count = max((len(value) for value in values.values()), default=0)
    result = np.tile(pin.neutral(model), (count, 1))
    for name, value in values.items():
        joint = model.getJointId(name)
        first = model.idx_qs[joint]
        if model.nqs[joint] == 1:
            result[:, first] = value
        else:  # a continuous joint's configuration is (cos q, sin q)
            result[:, first], result[:, first + 1] = np.cos(value), np.sin(value)
    return result


def joint_frames(
    model: pin.Model, urdf: Urdf, values: Mapping[str, Array], wanted: Collection[int]
) -> dict[int, Array]:
    """The poses of joints after they moved in the URDF's root, T_root_joint (N, 4, 4) [m], by their numbers.

    Args:
        model: A `full_model` of the URDF.
        urdf: The URDF.
        values: What `Robot.urdf_values` says of N samples, each of shape (N,), [rad] or [m]; other joints are neutral.
        wanted: Numbers of joints of the model.

    Returns:
        The poses of these joints, of all joints that carry them, and of 0, the root itself.
    """
    count = max((len(value) for value in values.values()), default=0)
    frames: dict[int, Array] = {0: np.tile(np.eye(4), (count, 1, 1))}
    # A joint's supports begin with the root and end with the joint itself.
    for number in sorted({k for joint in wanted for k in model.supports[joint]} - {0}):
        T = frames[model.parents[number]] @ model.jointPlacements[number].homogeneous
        name = model.names[number]
        if name in values:
            joint, value = urdf.joint(name), values[name][:, None]
            if joint.type == "prismatic":
                T[:, :3, 3] += (T[:, :3, :3] @ joint.axis) * value
            else:
                T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(value * joint.axis).as_matrix()
        frames[number] = T
    return frames


def link_frame(model: pin.Model, link: str) -> int:
    """The index of a link's frame in a `full_model`, or in one that was reduced from it."""
    return int(model.getFrameId(_LINK + link, pin.FrameType.BODY))
