"""The corrected URDF, read back and compared with the model in memory.

Two readers that share no code with the writer must find in a corrected URDF what the model in memory has: Pinocchio,
which the model itself is built on, and yourdfpy.
"""

from __future__ import annotations

import io
import logging
from typing import Any

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

TOLERANCE = 1e-9  #: A pose read back may differ from the model's by this [m and rad].


def check_written(robot: Robot, expected: Array, q: Array) -> None:
    """Compare a robot's URDF, as Pinocchio and yourdfpy read it, with poses of the model in memory.

    Args:
        robot: The robot with the URDF that is to be written.
        expected: Shape (N, 4, 4), [m], T_base_tip by the model in memory.
        q: Shape (N, m), the joint readings of these poses, [rad] or [m], in the order of ``robot.joint_names``.

    Raises:
        UrdfError: A reader disagrees by more than `TOLERANCE`, or cannot read the URDF at all.
    """
    read_again = robot.rebuilt(Urdf.from_bytes(robot.urdf.data, "the corrected URDF"))
    by_pinocchio = read_again.poses(q)
    by_yourdfpy = _poses_by_yourdfpy(robot, q)
    for reader, poses in (("Pinocchio", by_pinocchio), ("yourdfpy", by_yourdfpy)):
        off = np.abs(poses - expected)
        if not off.max() <= TOLERANCE:
            raise UrdfError(
                f"The corrected URDF, read back by {reader}, puts the tip {off[:, :3, 3].max():.2e} m and "
                f"{off[:, :3, :3].max():.2e} rad away from the model in memory; {TOLERANCE:g} is allowed. It is not "
                "written. Please report this with the URDF."
            )


def _poses_by_yourdfpy(robot: Robot, q: Array) -> Array:
    """Return T_base_tip at readings q (N, m) [rad or m] as yourdfpy computes it from the URDF's text, (N, 4, 4) [m].

    UrdfError if yourdfpy cannot read the URDF.
    """
    model = yourdfpy_model(robot.urdf)
    # yourdfpy slides by q times the axis as it is written, which may have any length.
    lengths = np.ones(len(robot.joints))
    for i, joint in enumerate(robot.joints):
        if joint.type == "prismatic":
            lengths[i] = np.linalg.norm(model.joint_map[joint.name].axis)
    values = robot.chain_values(q) / lengths
    poses = np.empty((len(values), 4, 4))
    for i, row in enumerate(values):
        by_name = {joint.name: value for joint, value in zip(robot.joints, row, strict=True)}
        model.update_cfg(by_name)
        T_root_base = model.get_transform(robot.base)
        T_root_tip = model.get_transform(robot.tip)
        poses[i] = rigid_inverse(T_root_base) @ T_root_tip
    return poses


def yourdfpy_model(urdf: Urdf) -> Any:  # noqa: ANN401  yourdfpy has no types
    """Return yourdfpy's model of a URDF, in which no joint mimics another.

    Raises:
        UrdfError: yourdfpy cannot read it.
    """
    import yourdfpy

    logger = logging.getLogger("yourdfpy.urdf")
    logger.disabled = True  # because it warns about other parts of the robot, such as mimic joints
    try:
        parsed = yourdfpy.URDF.load(
            io.BytesIO(urdf.data),
            build_scene_graph=False,
            load_meshes=False,
            load_collision_meshes=False,
        ).robot
        # Every joint of the chain is given its value, which yourdfpy does not accept for one that mimics another.
        for joint in parsed.joints:
            joint.mimic = None
        return yourdfpy.URDF(parsed, load_meshes=False, load_collision_meshes=False)
    # Whatever a foreign reader raises: a file that it cannot read must not be written.
    except Exception as error:
        raise UrdfError(
            f"yourdfpy cannot read the corrected URDF of '{urdf.name}', so it is not written: {error}"
        ) from error
    finally:
        logger.disabled = False
