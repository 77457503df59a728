"""Covariances that are of something else than the poses' errors, and covariances that are right."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.diagnosis.reasons import Why
from calib.diagnosis.stated_covariances import idle_covariances
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from tests.covariances import random_covariances
from tests.fit.estimate.special_cases.test_pose_covariances import table_with

#: The orientation before the position.
TURNS_FIRST = [3, 4, 5, 0, 1, 2]


def reasons(scene, stated, true, rng):
    cell = Cell(estimate_frame=True)
    table = table_with(scene, len(true), stated, true, rng)
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return list(idle_covariances(fit(Task(scene.robot, cell, setup, "zeros"), rows)))


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_covariances_in_another_order_are_named(make_scene, scale):
    rng = np.random.default_rng(1)
    true = random_covariances(rng, 40)
    other = scale**2 * true[:, TURNS_FIRST][:, :, TURNS_FIRST]
    (reason,) = reasons(make_scene(1, model="zeros"), other, true, rng)
    assert reason.why is Why.COVARIANCES_IDLE
    assert reason.values["scale"] < 1.0


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_right_covariances_are_not(make_scene, scale):
    rng = np.random.default_rng(2)
    true = random_covariances(rng, 40)
    assert reasons(make_scene(2, model="zeros"), scale**2 * true, true, rng) == []


def test_equal_covariances_tell_nothing_and_need_not(make_scene):
    rng = np.random.default_rng(3)
    equal = np.tile(np.diag(np.repeat([1e-4, 1e-3], 3) ** 2), (40, 1, 1))
    assert reasons(make_scene(3, model="zeros"), equal, equal, rng) == []


def test_poses_without_covariances_are_not_judged(make_scene):
    rng = np.random.default_rng(4)
    true = random_covariances(rng, 20)
    assert reasons(make_scene(4, model="zeros"), None, true, rng) == []
