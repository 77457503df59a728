"""A controller with the nominal robot that runs a program on the true one: Pinocchio's kinematics, Newton's steps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib.robot.robot import Robot
from calib.verbs.compensate.programs.program_file import ProgramFile


class Arm:
    """A robot in Pinocchio: its URDF, as calib wrote it, from base to tip."""

    def __init__(self, robot: Robot):
        self.model = pin.buildModelFromXML(robot.urdf.data.decode())
        self.data = self.model.createData()
        self.base = self.model.getFrameId(robot.base)
        self.tip = self.model.getFrameId(robot.tip)
        joints = [self.model.joints[self.model.getJointId(name)] for name in robot.joint_names]
        self.index = [joint.idx_q for joint in joints]
        self.nq = [joint.nq for joint in joints]
        self.columns = [joint.idx_v for joint in joints]

    def full(self, q: np.ndarray) -> np.ndarray:
        values = pin.neutral(self.model)
        for i, n, value in zip(self.index, self.nq, q, strict=True):
            values[i : i + n] = value if n == 1 else [np.cos(value), np.sin(value)]
        return values

    def pose(self, q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(self.model, self.data, self.full(q))
        return (self.data.oMf[self.base].inverse() * self.data.oMf[self.tip]).homogeneous

    def inverse(self, T: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Joint values at which the tip is at a pose in the base, from those given."""
        for _ in range(60):
            error = pin.log6(pin.SE3(np.linalg.inv(self.pose(q)) @ T)).vector
            J = pin.computeFrameJacobian(
                self.model, self.data, self.full(q), self.tip, pin.ReferenceFrame.LOCAL
            )[:, self.columns]
            step = np.linalg.lstsq(J, error, rcond=1e-10)[0]
            q = q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-12))
            if np.abs(step).max() < 1e-12:
                break
        assert np.linalg.norm(error) < 1e-8
        return q


def rotation(convention: str, numbers: np.ndarray) -> np.ndarray:
    """The rotation of numbers in degrees, of quaternions as they are, as the makers' manuals define it."""
    if convention == "abb":
        w, qx, qy, qz = numbers / np.linalg.norm(numbers)
        return pin.Quaternion(w, qx, qy, qz).matrix()
    if convention == "rotation-vector":
        return pin.exp3(numbers)
    a, b, c = np.radians(numbers)
    if convention == "kuka":
        c, b, a = a, b, c
    return pin.utils.rotate("z", c) @ pin.utils.rotate("y", b) @ pin.utils.rotate("x", a)


def joints(
    arm: Arm, program: ProgramFile, near: list[np.ndarray] | None = None
) -> list[np.ndarray]:
    """Joint values of the controller at each motion; poses from those before, or from those given."""
    result: list[np.ndarray] = []
    for i, move in enumerate(program.moves):
        target = program.targets[move.target]
        numbers = np.array([number.value for number in target.numbers])
        if target.convention is None:
            result.append(numbers * target.scales)
            continue
        T = np.eye(4)
        T[:3, 3] = numbers[:3] * target.scales[:3]
        T[:3, :3] = rotation(target.convention.name, numbers[3:])
        tool = np.eye(4) if move.T_tip_tool is None else move.T_tip_tool
        T_base_tip = move.T_base_frame @ T @ np.linalg.inv(tool)
        result.append(arm.inverse(T_base_tip, near[i] if near else result[-1]))
    return result


def arrival(nominal: Robot, true: Robot, original: ProgramFile, program: ProgramFile) -> np.ndarray:
    """How far [m] the true robot's tool ends, at each motion, from where the nominal one's would by the original."""
    controller, real = Arm(nominal), Arm(true)
    meant = joints(controller, original)
    sent = joints(controller, program, meant)
    away = []
    for move, q_meant, q_sent in zip(program.moves, meant, sent, strict=True):
        tool = np.eye(4) if move.T_tip_tool is None else move.T_tip_tool
        apart = (controller.pose(q_meant) @ tool - real.pose(q_sent) @ tool)[:3, 3]
        away.append(float(np.linalg.norm(apart)))
    return np.array(away)
