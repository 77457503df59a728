"""Tables of random poses of a wrong UR3, calibrated, and the reasons of the verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Why
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values


def table_of(scene: Any, q: np.ndarray, rng: np.random.Generator, bias: Any = 0.0) -> Measurements:
    """Points of the true robot at these joint values, seen in the base frame."""
    points = scene.kinematics.points(scene.x, scene.samples(len(q), q=q))
    points = points + 3e-5 * rng.normal(size=points.shape) + bias
    return Measurements(joint_names=scene.robot.joint_names, joints=q, points=points)


def arm(make_scene: Callable[..., Any], seed: int, **given: Any) -> Any:
    usual = {"frames": [np.eye(4)], "length": 3e-4, "angle": 3e-3}
    return make_scene(seed, **(usual | given))


def reasons(result: Calibration) -> dict[Why, dict[str, Any]]:
    """The numbers and names of each reason."""
    assert result.verdict is not None
    return {reason.why: reason.values for reason in result.verdict.reasons}


def judged(make_scene, seed, changed=None, *, rows=70, bias=0.0, given=None, **how) -> Calibration:
    """A fit to a table of random poses that was changed."""
    scene, rng = arm(make_scene, seed, **(given or {})), np.random.default_rng(seed - 60)
    m = table_of(scene, random_joint_values(scene.robot, rows, seed - 60), rng, bias)
    return calibrate(scene.robot, changed(m) if changed else m, **{"model": "dh", **how})


def fit_to(scene: Any, table: Measurements, cell: Cell | None = None) -> Fitted:
    """A fit of the cell's model, DH if it names none."""
    cell = Cell(model="dh") if cell is None else cell
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return fit(Task(scene.robot, cell, setup, cell.model), rows)


def moved(
    table: Measurements, by: Any = (0.0, 0.0, 0.0), about: Any = (0.0, 0.0, 0.0)
) -> Measurements:
    """The points in a frame in which the base stands elsewhere [m], turned [rad]."""
    R = Rotation.from_rotvec(about).as_matrix()
    return replace(table, points=table.points @ R.T + np.array(by))
