"""What calibrations, evaluations and their solvers refuse, by the kind of error and the words that tell the fix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import CalibError, ModelError, SolverError
from calib.estimate.solvers import levenberg_marquardt, paper_levenberg_marquardt
from calib.result.acceptance import assess
from calib.result.calibrate import calibrate
from calib.result.support import compare


def of_paper(robot: Any, table: Any) -> object:
    return compare(calibrate(robot, table, solver="paper", validate=False).fitted)


def without_damping(_robot: Any, _table: Any) -> object:
    J = np.array([[1.0, 0.0], [1.0, 0.0]])
    return paper_levenberg_marquardt(lambda x: (J @ x - 1.0, J), np.zeros(2), mu=0.0)


@pytest.mark.parametrize(
    ("call", "kind", "fix"),
    [
        (lambda _, table: calibrate("ur3.urdf", table), ModelError, "calib.Robot.load"),
        (lambda robot, _: calibrate(robot, "data.csv"), ModelError, "calib.Measurements.read"),
        (lambda r, t: calibrate(r, t, solver="newton"), ModelError, "Choose one of 'lm', "),
        (of_paper, ModelError, "Choose --solver lm"),
        (without_damping, SolverError, "Start with a damping above 0"),
        (lambda r, t: assess(r, t, Cell(), judge="larger"), CalibError, "choose one of"),
    ],
)
def test_what_is_refused_names_the_fix(ur3, table, call: Callable[..., object], kind: type, fix):
    with pytest.raises(kind) as error:
        call(ur3, table)
    assert fix in str(error.value)


def test_a_minimum_between_two_numbers():
    """The residual falls below 1, and jumps back up: steps are shortened until none is left."""

    def system(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        left = 1.0 - 1e-3 * x[0] if x[0] <= 0.0 else 2.0
        return np.array([left]), np.array([[-1e-3]])

    found = levenberg_marquardt(system, np.zeros(1), step_size=np.ones(1))
    assert (found.status, found.x) == ("converged", 0.0)
