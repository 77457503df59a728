"""Extrapolated errors: those of noise are as the covariance says, those that a model lacks are larger."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.extrapolation import extrapolation
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup


def extrapolated(scene: Any, table: Measurements) -> float:
    cell = Cell(model="dh")
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return extrapolation(fit(Task(scene.robot, cell, setup, "dh"), rows))


def test_noise_is_extrapolated_as_the_covariance_says(make_scene):
    """Of one table by chance within a few tenths; on the mean of several it is 1, but for being no less than that."""
    factors = []
    for seed in range(8):
        scene = make_scene(seed, length=3e-4, angle=3e-3, noise=1e-4, frames=[np.eye(4)])
        factors.append(extrapolated(scene, scene.points(40)))
    assert min(factors) >= 1.0
    assert np.mean(factors) < 1.35


def test_what_a_model_lacks_does_not_average_out(make_scene):
    """Errors of gears that the geometry cannot have: of many rows the covariance knows next to nothing of them."""
    scene = make_scene(
        1,
        model="dh+gain",
        length=3e-4,
        angle=3e-3,
        noise=2e-5,
        frames=[np.eye(4)],
        other={"gain": 1e-3},
    )
    table = scene.points(400)
    few, many = (extrapolated(scene, table.select(np.arange(400) < n)) for n in (40, 400))
    assert many > max(2.0 * few, 5.0)
