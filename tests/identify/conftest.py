"""The paper's UR3 and its table, and virtual measurements of a UR3 with known errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from calib.data import PAPER_TARGET, paper_measurements, paper_urdf
from calib.identify.calibration import Calibration, calibrate
from calib.identify.fitting import Rows
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.model.readback import random_joint_values
from calib.model.robot import Robot, read_only


@pytest.fixture(scope="session")
def ur3() -> Robot:
    return Robot.load(paper_urdf(), base="base", tip="tool0")


@pytest.fixture(scope="session")
def table(ur3: Robot) -> Measurements:
    return Measurements.read(paper_measurements(), ur3.joint_names, ur3.joint_types)


@pytest.fixture(scope="session")
def paper_cell() -> Cell:
    return Cell(target=read_only(PAPER_TARGET), model="paper")


@pytest.fixture(scope="session")
def default_result(ur3: Robot, table: Measurements, paper_cell: Cell) -> Calibration:
    return calibrate(ur3, table, cell=paper_cell)


@dataclass(frozen=True)
class VirtualUr3:
    """A UR3 that is wrong in a known way, and a tracker that sees its target."""

    kinematics: Kinematics
    is_length: np.ndarray

    def offsets(self, rng: np.random.Generator, length: float, angle: float) -> np.ndarray:
        return rng.normal(size=len(self.is_length)) * np.where(self.is_length, length, angle)

    def rows(self, rng: np.random.Generator, x: np.ndarray, count: int, noise: float) -> Rows:
        q = random_joint_values(self.kinematics.robot, count, int(rng.integers(2**31)))
        points = self.kinematics.points(x, q) + noise * rng.normal(size=(count, 3))
        return Rows(q, points, np.full(count, 1e-4))

    def unseen(self) -> np.ndarray:
        return random_joint_values(self.kinematics.robot, 200, 99)


@pytest.fixture(scope="session")
def virtual(ur3: Robot) -> VirtualUr3:
    model = error_model(ur3, "paper")
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = PAPER_TARGET
    is_length = np.array([p.unit == "m" for p in model.parameters])
    return VirtualUr3(Kinematics(ur3, model, np.eye(4), T_tip_target), is_length)
