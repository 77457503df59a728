"""evaluate: how far a robot is off, without changing it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.identify.fitting import nominal_setup, predict
from calib.identify.setup import Setup
from calib.identify.setup_check import better_setup
from calib.identify.statistics import Errors
from calib.identify.table_rows import rows_of
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
        setup: Frames and targets as given or registered.
        registered: What was registered to the rows: some of ``"target"`` and ``"frame"``.
        residual: shape (N, D), measured minus predicted: lengths [m] in the first columns, angles [rad] in three more.
        used: shape (N, D), which scalars were measured.
    """

    robot: Robot
    measurements: Measurements
    setup: Setup
    registered: tuple[str, ...]
    residual: Array
    used: NDArray[np.bool_]

    @property
    def T_frame_base(self) -> Array:
        """Pose of the base in the (first) measurement frame, shape (4, 4), [m]."""
        return np.asarray(self.setup.T_frame_base[0])

    @property
    def target(self) -> Array:
        """The (first) target in the tip, shape (3,), [m]."""
        return np.asarray(self.setup.T_tip_target[0, :3, 3])

    @property
    def errors(self) -> dict[str, Errors]:
        """``errors["estimation" | "validation" | "all"]``."""
        m = self.measurements
        return {
            "estimation": Errors.of(self.residual[m.estimation], self.used[m.estimation]),
            "validation": Errors.of(self.residual[m.validation], self.used[m.validation]),
            "all": Errors.of(self.residual, self.used),
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
    every, setup = rows_of(robot, measurements, cell)
    chosen = measurements.estimation
    placed = nominal_setup(robot, setup, every.select(chosen) if np.any(chosen) else every)
    frame_is_open = any(
        directions and not given
        for directions, given in zip(setup.unknown, setup.frame_given, strict=True)
    )
    unknown = (
        ("target", bool(np.any(setup.target_unknown & ~setup.target_given))),
        ("frame", frame_is_open),
    )
    return Evaluation(
        robot=robot,
        measurements=measurements,
        setup=placed,
        registered=tuple(name for name, missing in unknown if missing),
        residual=read_only(predict(robot, placed, every)),
        used=every.used,
    )


def hint(evaluation: Evaluation, cell: Cell) -> str:
    """A sentence that names a set-up which explains the rows far better, or nothing.

    Args:
        evaluation: Of a robot.
        cell: The cell that it was evaluated with.
    """
    m = evaluation.measurements
    every, setup = rows_of(evaluation.robot, m, cell)
    rows = every.select(m.estimation) if np.any(m.estimation) else every
    return better_setup(evaluation.robot, cell, setup, rows)
