"""The Pinocchio model of a whole URDF: every joint, also those beside a chain; mimic joints move freely.

Pinocchio is given what states joints and masses (`calib.robot.kinematic_text`). Moments of inertia are zero.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import lru_cache

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.errors import UrdfError, choices
from calib.robot.kinematic_text import kinematic_text
from calib.robot.urdf import Urdf

#: Prefix of the links' names in the Pinocchio model.
_LINK = "link:"

#: Poses of links by Pinocchio and by the URDF's text may differ by this, absolutely and relatively [m; rotations: 1].
_SAME_POSE = 1e-9


def full_model(urdf: Urdf) -> pin.Model:
    """Return the Pinocchio model of a whole URDF, a copy that may be changed; links are found by `link_frame`.

    Raises:
        UrdfError: Pinocchio cannot read the URDF, or reads it differently from what is written.
    """
    return _built_model(urdf).copy()


@lru_cache(maxsize=8)
def _built_model(urdf: Urdf) -> pin.Model:
    """Return the model that `full_model` copies, or raise its UrdfError: reading the XML takes ten times a copy."""
    try:
        model = pin.buildModelFromXML(kinematic_text(urdf))
    except (ValueError, RuntimeError) as error:
        raise UrdfError(
            f"{urdf.source}: Pinocchio cannot build a model of this URDF: {error}"
        ) from error
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    links = [i for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    T_root_link = {model.frames[i].name: data.oMf[i].homogeneous for i in links}
    misread = []
    for joint in urdf.joints:
        if not {joint.parent, joint.child} <= T_root_link.keys():
            misread.append(joint.name)
            continue
        T_root_child = T_root_link[joint.parent] @ joint.T_parent_joint
        if not np.allclose(T_root_child, T_root_link[joint.child], _SAME_POSE, _SAME_POSE):
            misread.append(joint.name)
    if misread:
        raise UrdfError(
            f"{urdf.source}: Pinocchio reads the joints {choices(misread)} in another way than they are written. Look "
            "for unusual characters in numbers and names."
        )
    # Pinocchio cannot lock a joint that shares its name with a link, as ANYmal's do: links get names of their own.
    for i in links:
        model.frames[i].name = _LINK + model.frames[i].name
    return model


def full_configurations(model: pin.Model, values: Mapping[str, Array]) -> Array:
    """Return Pinocchio's configurations of N samples, shape (N, nq).

    Args:
        model: A `full_model`.
        values: Joint values by name, each of shape (N,), [rad] or [m], as of `Robot.urdf_values`; other joints are
            neutral.
    """
    count = _sample_count(values)
    result = np.tile(pin.neutral(model), (count, 1))
    for name, value in values.items():
        joint = model.getJointId(name)
        first = model.idx_qs[joint]
        if model.nqs[joint] == 1:
            result[:, first] = value
        else:  # a continuous joint's configuration is (cos q, sin q)
            result[:, first] = np.cos(value)
            result[:, first + 1] = np.sin(value)
    return result


def joint_frames(
    model: pin.Model,
    urdf: Urdf,
    values: Mapping[str, Array],
    numbers: Collection[int],
) -> dict[int, Array]:
    """Return the poses of joints, after they moved, in the URDF's root.

    Args:
        model: A `full_model` of the URDF.
        urdf: The URDF.
        values: Joint values by name, each of shape (N,), [rad] or [m], as of `Robot.urdf_values`; other joints are
            neutral.
        numbers: Pinocchio's numbers of joints of the model.

    Returns:
        T_root_joint (N, 4, 4) [m] by number, for these joints, all joints that carry them, and 0, the root.
    """
    frames: dict[int, Array] = {0: np.tile(np.eye(4), (_sample_count(values), 1, 1))}
    # A joint's supports begin with the root and end with the joint itself.
    supports = {k for number in numbers for k in model.supports[number]}
    for number in sorted(supports - {0}):
        T = frames[model.parents[number]] @ model.jointPlacements[number].homogeneous
        name = model.names[number]
        if name in values:
            axis = urdf.joint(name).axis
            value = values[name][:, None]
            if urdf.joint(name).type == "prismatic":
                T[:, :3, 3] += (T[:, :3, :3] @ axis) * value
            else:
                T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(value * axis).as_matrix()
        frames[number] = T
    return frames


def link_frame(model: pin.Model, link: str) -> int:
    """Return the index of a link's frame in a `full_model`, or in one that was reduced from it."""
    return int(model.getFrameId(_LINK + link, pin.FrameType.BODY))


def _sample_count(values: Mapping[str, Array]) -> int:
    """Return the number N of joint values (N,) by name; 0 without any."""
    return max((len(value) for value in values.values()), default=0)
