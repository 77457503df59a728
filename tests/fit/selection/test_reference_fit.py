"""Weights of a reference fit are taken where they predict held-out rows better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.reference_fit import (
    explains_more_rows,
    fit_with_all_families,
    with_better_weights,
)
from tests.fit.selection.models import fitted_to, scene_of, with_outliers, with_outlying_points


def test_a_reference_fit_that_explains_more_rows_keeps_its_weights(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    rows, setup = rows_and_setup(scene.robot, scene.points(40), Cell())
    large, small = (fit(Task(scene.robot, Cell(), setup, m), rows) for m in ("dh", "zeros"))
    assert explains_more_rows(with_outliers(large), with_outliers(small, 3, 5))
    assert explains_more_rows(with_outliers(large, 3), with_outliers(small, 3, 5))
    # Each has an outlier of its own, or they agree, or the reference predicts worse.
    assert not explains_more_rows(with_outliers(large, 7), with_outliers(small, 3, 5))
    assert not explains_more_rows(with_outliers(large, 3, 5), with_outliers(small, 3, 5))
    assert not explains_more_rows(with_outliers(small), with_outliers(large, 3, 5))


@pytest.fixture(scope="module")
def robust_and_plain(make_scene):
    """Fits to 30 points, two of them off by millimetres: with these set aside, and with all rows in full."""
    scene = scene_of(make_scene, 91, "dh")
    rows, setup = rows_and_setup(scene.robot, with_outlying_points(scene.points(30)), Cell())
    task = Task(scene.robot, Cell(), setup, "dh")
    robust, plain = fit(task, rows), fit(replace(task, robust=False), rows)
    assert np.flatnonzero(robust.estimate.outliers).tolist() == [4, 17]
    return rows, robust, with_outliers(plain, 4, 17)


def test_weights_of_the_reference_are_taken_where_they_predict_better(robust_and_plain):
    rows, robust, plain = robust_and_plain
    found = with_better_weights(plain, rows, robust)
    weights = found.estimate.problem.weights
    np.testing.assert_array_equal(weights, robust.estimate.problem.weights)
    assert weights[[4, 17]].tolist() == [0.0, 0.0]
    # The reference predicts better, so rows are flagged only where it flags them too.
    np.testing.assert_allclose(found.estimate.scores, robust.estimate.scores, rtol=1e-12)


def test_weights_of_the_reference_are_not_taken_where_they_predict_worse(robust_and_plain):
    rows, robust, plain = robust_and_plain
    found = with_better_weights(robust, rows, plain)
    np.testing.assert_array_equal(found.estimate.x, robust.estimate.x)
    np.testing.assert_array_equal(found.estimate.problem.weights, robust.estimate.problem.weights)
    np.testing.assert_array_equal(found.estimate.scores, robust.estimate.scores)


def test_all_families_are_fitted_beside_the_geometry(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    fitted = fitted_to(scene, scene.points(40), Cell())
    rows = fitted.estimate.problem.rows
    largest = fit_with_all_families(fitted, rows)
    assert largest.task.model == "dh+gain+eccentricity+compliance+gravity"
    np.testing.assert_array_equal(largest.setup.T_tip_target, fitted.setup.T_tip_target)
