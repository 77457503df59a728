"""Scenes, fits and candidates that the tests of `calib.fit.selection` share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import known_distances
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.candidates import Candidate
from calib.model.families import FAMILIES
from calib.numerics.errors import CrossValidation, Errors


def scene_of(make_scene: Callable[..., Any], seed: int, model: str, **given: Any) -> Any:
    """A virtual cell whose robot has errors of this model, measured in the base frame."""
    usual = {"frames": [np.eye(4)], "length": 3e-4, "angle": 3e-3, "noise": 3e-5}
    return make_scene(seed, model=model, **(usual | given))


def task_of(scene: Any, table: Measurements, cell: Cell, model: str = "dh") -> tuple[Task, Rows]:
    """A fit of a scene's table, and the rows that are fitted."""
    every, setup = rows_and_setup(scene.robot, table, cell)
    task = Task(scene.robot, cell, setup, model, known_distances(cell, setup), allow_absent=True)
    return task, every.select(table.estimation)


def task_of_case(case: tuple[Any, Any]) -> tuple[Task, Rows]:
    """The fit of a calibrated scene, and its rows."""
    scene, c = case
    return task_of(scene, c.fit.measurements, c.fit.cell, c.model.name)


def fitted_to(scene: Any, table: Measurements, cell: Cell, model: str = "dh") -> Fitted:
    """A model fitted to a scene's table."""
    task, rows = task_of(scene, table, cell, model)
    return fit(task, rows)


def with_outlying_points(table: Measurements) -> Measurements:
    """The table with its rows 4 and 17 off by millimetres."""
    points = table.points.copy()
    points[[4, 17]] += [[2e-3, 0.0, 1e-3], [0.0, -3e-3, 0.0]]
    return replace(table, points=points)


def with_outliers(fitted: Fitted, *rows: int) -> Fitted:
    """A fit that flags these rows."""
    scores = np.zeros(len(fitted.estimate.scores))
    scores[list(rows)] = 10.0 * fitted.estimate.flag_limit
    return replace(fitted, estimate=replace(fitted.estimate, scores=scores))


def a_candidate(
    name: str, evidence: float, held_out: float = 1e-4, prior_std: Mapping[str, float] | None = None
) -> Candidate:
    """A candidate with one error at each of three held-out rows [m]; families have their usual prior std."""
    residual = np.full((3, 3), held_out / np.sqrt(3.0))
    errors = Errors.of(residual)
    validation = CrossValidation("leave-one-out", 3, np.arange(3), residual, errors, errors)
    usual = {family: FAMILIES[family].prior for family in name.split("+")[1:]}
    return Candidate(name, 10, evidence, validation, usual | dict(prior_std or {}), evidence)
