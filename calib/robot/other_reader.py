"""A robot's URDF as yourdfpy reads it: another program, which takes the whole file and shares no code with calib."""

from __future__ import annotations

import io
import logging

import numpy as np

from calib.basics.arrays import Array, rigid_inverse
from calib.robot.robot import Robot

#: Poses by the two readers may differ by this [m and rad].
_TOLERANCE = 1e-9


def fault_by_yourdfpy(robot: Robot, q: Array) -> str:
    """Say what is wrong with a robot's URDF in the eyes of yourdfpy.

    It need not be a fault of the file: yourdfpy finds no joint in one with a default namespace.

    Args:
        robot: The robot.
        q: Shape (N, m), readings of its joints at N poses [rad or m].

    Returns:
        Why it cannot read the file, or how far a chain's tip is elsewhere; empty if it finds the robot that calib does.
    """
    import yourdfpy  # with trimesh, which takes longer than all else that an inspection needs

    logger = logging.getLogger("yourdfpy.urdf")
    was_disabled = logger.disabled
    logger.disabled = True  # because it warns about other parts of the robot, such as mimic joints
    without_meshes = {"load_meshes": False, "load_collision_meshes": False}
    try:
        parsed = yourdfpy.URDF.load(
            io.BytesIO(robot.urdf.data), build_scene_graph=False, **without_meshes
        ).robot
        for joint in parsed.joints:
            joint.mimic = None  # each joint of the chain is given its value
        model = yourdfpy.URDF(parsed, **without_meshes)
        for chain in robot.chains:
            # yourdfpy slides by q times the axis as it is written, which may have any length.
            lengths = np.ones(len(chain.joints))
            for i, joint in enumerate(chain.joints):
                if joint.type == "prismatic":
                    lengths[i] = np.linalg.norm(model.joint_map[joint.name].axis)
            for values, pose in zip(chain.chain_values(q) / lengths, chain.poses(q), strict=True):
                names = (joint.name for joint in chain.joints)
                model.update_cfg(dict(zip(names, values, strict=True)))
                T_root_base, T_root_tip = map(model.get_transform, (chain.base, chain.tip))
                off = np.abs(rigid_inverse(T_root_base) @ T_root_tip - pose)
                if not off.max() <= _TOLERANCE:
                    return (
                        f"it has '{chain.tip}' {1e3 * off[:3, 3].max():.3g} mm and "
                        f"{np.degrees(off[:3, :3].max()):.3g} deg elsewhere"
                    )
    except Exception as error:  # noqa: BLE001  whatever a foreign reader raises about what it did not find
        return f"{type(error).__name__}: {error}"
    finally:
        logger.disabled = was_disabled
    return ""
