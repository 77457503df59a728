"""MuJoCo's own kinematics of an MJCF, for tests of what calib makes of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.robot.robot import Robot

MODELS = Path(__file__).parent / "mjcf"


class Truth:
    """A model as MuJoCo compiles it."""

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)

    @property
    def turning_and_sliding(self) -> list[int]:
        """The joints with one value."""
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        return [i for i in range(self.model.njnt) if self.model.jnt_type[i] in kinds]

    def move(self, values: Mapping[int, float]) -> None:
        """Move joints by number."""
        for joint, value in values.items():
            self.data.qpos[self.model.jnt_qposadr[joint]] = value
        mujoco.mj_kinematics(self.model, self.data)

    def pose(self, name: str) -> NDArray[np.float64]:
        """T_world_link (4, 4) of a body, or of a site if no body has the name."""
        T = np.eye(4)
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if number >= 0:
            T[:3, :3] = self.data.xmat[number].reshape(3, 3)
            T[:3, 3] = self.data.xpos[number]
            return T
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name)
        assert number >= 0, name
        T[:3, :3] = self.data.site_xmat[number].reshape(3, 3)
        T[:3, 3] = self.data.site_xpos[number]
        return T

    def poses(
        self, names: list[str], q: NDArray[np.float64], base: str, tip: str
    ) -> NDArray[np.float64]:
        """T_base_tip (N, 4, 4) at values q (N, m) of named joints."""
        numbers = [mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in names]
        result = []
        for row in q:
            self.move(dict(zip(numbers, row, strict=True)))
            result.append(np.linalg.inv(self.pose(base)) @ self.pose(tip))
        return np.array(result)


def perturbed(robot: Robot, seed: int) -> Robot:
    """The robot with every placement that a body can hold moved by millimetres and hundredths of a radian."""
    rng = np.random.default_rng(seed)
    placements = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            placements[i] = placements[i] @ displacement(rng)
    return robot.with_placements(placements)


def displacement(rng: np.random.Generator) -> NDArray[np.float64]:
    """A small pose (4, 4)."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.02, 3)).as_matrix()
    T[:3, 3] = rng.normal(0.0, 0.004, 3)
    return T


def product(robot: Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_base_tip (N, 4, 4) as the product of placements and motions, written out."""
    result = []
    for values in robot.chain_values(q):
        T = np.linalg.inv(robot.T_root_base)
        for joint, P, value in zip(robot.joints, robot.placements, values, strict=False):
            J = np.eye(4)
            if joint.type == "prismatic":
                J[:3, 3] = value * joint.axis
            else:
                J[:3, :3] = Rotation.from_rotvec(value * joint.axis).as_matrix()
            T = T @ P @ J
        result.append(T @ robot.placements[-1])
    return np.array(result)
