"""evaluate: how far a robot is off, without changing it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.identify.fitting import Rows, check_one_setup, nominal_cell, predict
from calib.identify.setup_check import better_setup
from calib.identify.statistics import Errors
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Errors of a robot as it is.

    Attributes:
        robot: The robot.
        measurements: All rows.
        T_frame_base: shape (4, 4), as given or registered [m].
        target: shape (3,), in the tip, as given or registered [m].
        registered: What was registered to the rows: some of ``"target"`` and ``"frame"``.
        residual: shape (N, 3), measured minus predicted [m].
    """

    robot: Robot
    measurements: Measurements
    T_frame_base: Array
    target: Array
    registered: tuple[str, ...]
    residual: Array

    @property
    def errors(self) -> dict[str, Errors]:
        """``errors["estimation" | "validation" | "all"]``."""
        m = self.measurements
        return {
            "estimation": Errors.of(self.residual[m.estimation]),
            "validation": Errors.of(self.residual[m.validation]),
            "all": Errors.of(self.residual),
        }


def evaluate(robot: Robot, measurements: Measurements, cell: Cell | None = None) -> Evaluation:
    """Compare a robot with measurements.

    Target and measurement frame are used as the cell gives them; what it does not give is registered to the
    estimation rows (to all rows where there are none), so that the errors say what the robot is worth and not where
    the tracker stands.

    Args:
        robot: The robot, nominal or corrected.
        measurements: The rows.
        cell: Target and frame, where they are known.

    Raises:
        MeasurementError: Too few rows to register what was not given, or a joint's column is missing.
    """
    cell = Cell() if cell is None else cell
    joints = measurements.joints_for(robot.joint_names)
    placed = nominal_cell(robot, cell, _rows(robot, measurements))
    assert placed.T_frame_base is not None  # registration leaves neither out
    assert placed.target is not None
    frame_is_open = cell.estimate_frame and cell.T_frame_base is None
    unknown = (("target", cell.target is None), ("frame", frame_is_open))
    return Evaluation(
        robot=robot,
        measurements=measurements,
        T_frame_base=placed.T_frame_base,
        target=placed.target,
        registered=tuple(name for name, missing in unknown if missing),
        residual=read_only(measurements.points - predict(robot, placed, joints)),
    )


def hint(evaluation: Evaluation, cell: Cell) -> str:
    """A sentence that names a set-up which explains the rows far better, or nothing.

    Args:
        evaluation: Of a robot.
        cell: The cell that it was evaluated with.
    """
    return better_setup(evaluation.robot, cell, _rows(evaluation.robot, evaluation.measurements))


def _rows(robot: Robot, measurements: Measurements) -> Rows:
    """The rows that what is unknown is registered to: the estimation rows, or all where there are none."""
    check_one_setup(measurements)
    joints = measurements.joints_for(robot.joint_names)
    every = Rows(joints, measurements.points, np.ones(len(measurements)))
    chosen = measurements.estimation
    return every.select(chosen) if np.any(chosen) else every
