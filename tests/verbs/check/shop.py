"""The paper's UR3 calibrated, and fresh points of the calibrated arm by Pinocchio, after something has moved."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import paper_measurements, paper_urdf
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot

#: Joint values of three poses that tell the causes apart [deg].
POSES = np.deg2rad(
    [
        [-14.577, -69.629, 84.584, -58.698, 26.602, 144.902],
        [-17.075, -37.721, -67.799, -162.234, 9.288, -12.646],
        [-45.715, -60.970, -83.473, -96.851, 17.525, 278.111],
    ]
)

#: Names of the joints of the UR3.
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


@cache
def paper_result() -> Calibration:
    """The paper's table, by its DH parameters."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names)
    return calibrate(robot, table, cell=Cell(), model="dh")


def tip_poses(robot: Robot, q: Array) -> Array:
    """T_base_tool0 by Pinocchio, (N, 4, 4)."""
    model = pin.buildModelFromXML(robot.urdf.data.decode())
    data = model.createData()
    base, tip = model.getFrameId("base"), model.getFrameId("tool0")
    poses = []
    for values in q:
        configuration = pin.neutral(model)
        for name, value in zip(JOINTS, values, strict=True):
            joint = model.joints[model.getJointId(name)]
            if joint.nq == 2:  # a joint that turns without end
                configuration[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
            else:
                configuration[joint.idx_q] = value
        pin.framesForwardKinematics(model, data, configuration)
        poses.append((data.oMf[base].actInv(data.oMf[tip])).homogeneous)
    return np.array(poses)


def points(
    q: Array = POSES,
    *,
    frame: Array | None = None,
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    zeros: tuple[float, ...] = (0.0,) * 6,
    noise: float = 0.0,
    seed: int = 0,
) -> Measurements:
    """Points of the calibrated arm: base displaced by a pose, target by a shift [m], joints by zeros [rad]."""
    result = paper_result()
    T = tip_poses(result.robot, q + np.array(zeros))
    place = np.append(result.target + np.array(target), 1.0)
    seen = (np.eye(4) if frame is None else frame) @ T @ place
    xyz = seen[:, :3] + noise * np.random.default_rng(seed).standard_normal((len(q), 3))
    return Measurements(joint_names=JOINTS, joints=np.array(q), points=xyz)


def write_rows(table: Measurements, path: Path) -> Path:
    """Write points as a table in degrees and millimetres."""
    lines = [",".join([*(f"{name} [deg]" for name in JOINTS), "x [mm]", "y [mm]", "z [mm]"])]
    for q, xyz in zip(table.joints, table.points, strict=True):
        lines.append(",".join(repr(float(value)) for value in [*np.rad2deg(q), *(1e3 * xyz)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
