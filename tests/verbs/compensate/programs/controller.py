"""A controller with the nominal robot that runs a program on the true one: Pinocchio's kinematics, Newton's steps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pinocchio as pin

from calib.robot.robot import Robot
from calib.verbs.compensate.programs.program_file import Move, ProgramFile, Target


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
        self.low, self.high = (
            np.array([limits[joint.idx_q] for joint in joints])
            for limits in (self.model.lowerPositionLimit, self.model.upperPositionLimit)
        )

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

    def configured(
        self, T: np.ndarray, q: np.ndarray, move: Move, target: Target, *, is_given: bool
    ) -> np.ndarray:
        """Joint values at which the tip is at a pose, as the configuration data of a motion by joints ask for."""
        if is_given or move.motion != "joint" or target.configuration is None:
            return self.inverse(T, q)
        random = np.random.default_rng(0)
        for _ in range(400):
            try:
                found = self.inverse(T, q)
            except AssertionError:
                found = None
            if found is not None:
                turns = np.array([-2.0, 0.0, 2.0]) * np.pi
                for first, last in product(turns, turns):
                    turned = (found + np.pi) % (2.0 * np.pi) - np.pi + [0, 0, 0, first, 0, last]
                    inside = (turned >= self.low) & (turned <= self.high)
                    if inside.all() and target.configuration(turned[None])[0]:
                        return turned
            q = random.uniform(self.low, self.high)
        raise AssertionError(f"{target.name}: no joint values of its configuration")


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
    arm: Arm,
    program: ProgramFile,
    near: dict[int, np.ndarray] | None = None,
    rows: Sequence[int] | None = None,
    start: np.ndarray | None = None,
) -> dict[int, np.ndarray]:
    """Joint values of the controller at motions; poses from those before, or from those given.

    The configuration of a target chooses among solutions from many starts.
    """
    result: dict[int, np.ndarray] = {}
    before = start
    for i in range(len(program.moves)) if rows is None else rows:
        move = program.moves[i]
        target = program.targets[move.target]
        numbers = np.array([number.value for number in target.numbers])
        if target.convention is None:
            result[i] = before = numbers * target.scales
            continue
        T = np.eye(4)
        T[:3, 3] = numbers[:3] * target.scales[:3]
        T[:3, :3] = rotation(target.convention.name, numbers[3:])
        tool = np.eye(4) if move.T_tip_tool is None else move.T_tip_tool
        T_base_tip = move.T_base_frame @ T @ np.linalg.inv(tool)
        begin = before if near is None else near[i]
        result[i] = before = arm.configured(
            T_base_tip, begin, move, target, is_given=near is not None
        )
    return result


def arrival(
    nominal: Robot,
    true: Robot,
    original: ProgramFile,
    program: ProgramFile,
    rows: Sequence[int] | None = None,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """How far [m] the true robot's tool ends, at each motion, from where the nominal one's would by the original."""
    controller, real = Arm(nominal), Arm(true)
    meant = joints(controller, original, None, rows, start)
    sent = joints(controller, program, meant, rows)
    away = []
    for i, q_meant in meant.items():
        move = original.moves[i]
        tool = np.eye(4) if move.T_tip_tool is None else move.T_tip_tool
        apart = (controller.pose(q_meant) @ tool - real.pose(sent[i]) @ tool)[:3, 3]
        away.append(float(np.linalg.norm(apart)))
    return np.array(away)
