"""The corrected URDF, read back and compared with the model in memory.

A corrected URDF must say what the model in memory says, to two readers that share no code with the writer: Pinocchio,
which the model itself stands on, and yourdfpy.
"""

from __future__ import annotations

import io
import logging

import numpy as np

from calib.errors import UrdfError
from calib.robot.robot import Robot, rigid_inverse
from calib.robot.urdf import Urdf
from calib.units import Array

TOLERANCE = 1e-9  #: A pose read back may differ from the model's by this [m and rad].


def check_written(robot: Robot, expected: Array, q: Array) -> None:
    """Compare a robot's URDF, read by Pinocchio and by yourdfpy, with poses T_base_tip (N, 4, 4) [m] at q (N, m).

    Raises:
        UrdfError: A reader disagrees by more than `TOLERANCE`, or cannot read the URDF at all.
    """
    again = robot.rebuilt(Urdf.from_bytes(robot.urdf.data, "the corrected URDF"))
    for reader, poses in (
        ("Pinocchio", again.poses(q)),
        ("yourdfpy", _poses_by_yourdfpy(robot, q)),
    ):
        off = np.abs(poses - expected)
        if not off.max() <= TOLERANCE:
            raise UrdfError(
                f"The corrected URDF, read back by {reader}, puts the tip {off[:, :3, 3].max():.2e} m and "
                f"{off[:, :3, :3].max():.2e} rad away from the model in memory; {TOLERANCE:g} is allowed. It is not "
                "written. Please report this with the URDF."
            )


def _poses_by_yourdfpy(robot: Robot, q: Array) -> Array:
    """T_base_tip as yourdfpy computes it from the URDF's text, shape (N, 4, 4), [m]."""
    import yourdfpy

    logger = logging.getLogger("yourdfpy.urdf")
    logger.disabled = True  # its warnings about the rest of the robot, mimic joints for one
    try:
        parsed = yourdfpy.URDF.load(
            io.BytesIO(robot.urdf.data),
            build_scene_graph=False,
            load_meshes=False,
            load_collision_meshes=False,
        ).robot
        # Every joint of the chain is given its value, and yourdfpy takes none for one that mimics another.
        for joint in parsed.joints:
            joint.mimic = None
        model = yourdfpy.URDF(parsed, load_meshes=False, load_collision_meshes=False)
    except (
        Exception
    ) as error:  # whatever a foreign reader raises, the file is not fit to be given out
        raise UrdfError(
            f"yourdfpy cannot read the corrected URDF of '{robot.name}', so it is not written: {error}"
        ) from error
    finally:
        logger.disabled = False
    # yourdfpy slides by q times the axis as it is written; the axis is a direction, of any length.
    values = robot.chain_values(q) / [
        np.linalg.norm(model.joint_map[joint.name].axis) if joint.type == "prismatic" else 1.0
        for joint in robot.joints
    ]
    poses = np.empty((len(values), 4, 4))
    for i, row in enumerate(values):
        model.update_cfg(
            {joint.name: value for joint, value in zip(robot.joints, row, strict=True)}
        )
        poses[i] = rigid_inverse(model.get_transform(robot.base)) @ model.get_transform(robot.tip)
    return poses
