"""The corrected URDF, read back and compared with the model in memory.

Pinocchio shares no code with the writer: its parser (urdfdom) must find the joints where they are written
(`calib.robot.full_model`), and its kinematics the poses that the model in memory has. So must calib's own reader, which
takes the file from here on.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.errors import UrdfError
from calib.robot.full_model import full_configurations, full_model, link_frame
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

TOLERANCE = 1e-9  #: A pose read back may differ from the model's by this [m and rad].


def check_written(robot: Robot, expected: Array, q: Array) -> None:
    """Compare a robot's URDF, as Pinocchio and calib read it, with poses of the model in memory.

    Args:
        robot: The robot with the URDF that is to be written.
        expected: Shape (N, 4, 4), [m], T_base_tip by the model in memory; of several chains one after the other, all
            poses of the first one first.
        q: Shape (N, m), the joint readings of these poses, [rad] or [m], in the order of ``robot.joint_names``.

    Raises:
        UrdfError: A reader disagrees by more than `TOLERANCE`, or cannot read the URDF.
    """
    read_again = robot.rebuilt(Urdf.from_bytes(robot.urdf.data, "the corrected URDF"))
    expected_of_chains = expected.reshape(-1, len(q), 4, 4)
    for again, poses in zip(read_again.chains, expected_of_chains, strict=True):
        check_close("Pinocchio", again.tip, _poses_by_pinocchio(again, q), poses)
        check_close("calib", again.tip, again.poses(q), poses)


def check_close(reader: str, link: str, poses: Array, expected: Array) -> None:
    """Refuse a URDF in which a reader finds a link elsewhere than expected by more than `TOLERANCE`.

    Args:
        reader: Name of the reader, for the message.
        link: Name of the link, for the message.
        poses: Shape (N, 4, 4), [m], poses of the link by the reader.
        expected: Shape (N, 4, 4), [m], poses by the model in memory.

    Raises:
        UrdfError: They differ by more.
    """
    off = np.abs(poses - expected)
    if not off.max() <= TOLERANCE:
        raise UrdfError(
            f"The corrected URDF, read back by {reader}, has '{link}' {off[:, :3, 3].max():.2e} m and "
            f"{off[:, :3, :3].max():.2e} rad away from the model in memory; {TOLERANCE:g} is allowed. It is not "
            "written. Please report this with the URDF."
        )


def _poses_by_pinocchio(robot: Robot, q: Array) -> Array:
    """Return T_base_tip (N, 4, 4) [m] at readings q (N, m) [rad or m] as Pinocchio reads and moves a robot's URDF."""
    model = full_model(robot.urdf)
    data = model.createData()
    links = [link_frame(model, link) for link in (robot.base, robot.tip)]
    poses = np.empty((len(q), 4, 4))
    for pose, configuration in zip(
        poses, full_configurations(model, robot.urdf_values(q)), strict=True
    ):
        pin.forwardKinematics(model, data, configuration)
        T_root_base, T_root_tip = (pin.updateFramePlacement(model, data, link) for link in links)
        pose[:] = T_root_base.actInv(T_root_tip).homogeneous
    return poses
