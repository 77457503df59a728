"""Steps of a page: rows, or images with all their corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.show.row_values import flagged_rows
from calib.verbs.evaluate.evaluation import Evaluation
from calib.verbs.view.steps import steps_of, typical_step
from tests.hard_cases import made
from tests.verbs.view.image_tables import CORNERS, evaluation, without_images


def test_each_image_is_a_step_with_the_rms_of_its_corners():
    first, last = evaluation(size=2.0), evaluation(size=0.5)
    flagged = np.arange(4 * CORNERS) == CORNERS + 3  # a corner of the second image
    steps = steps_of(first, last, flagged)
    assert steps.of_images
    assert steps.labels == ("0.png", "1.png", "2.png", "3.png")
    assert [len(rows) for rows in steps.rows] == [CORNERS] * 4
    np.testing.assert_allclose(steps.errors["px"], [[2.0, 4.0, 6.0, 8.0], [0.5, 1.0, 1.5, 2.0]])
    assert steps.flagged.tolist() == [False, True, False, False]
    assert steps.kinds == ("estimation", "flagged", "estimation", "estimation")
    assert steps.start == 2  # the middle one of those that are not flagged
    np.testing.assert_array_equal(steps.m.joints, first.measurements.joints[::CORNERS])


def test_the_errors_of_an_image_are_its_root_mean_square():
    e = evaluation(1)
    residual = np.zeros((CORNERS, 2))
    residual[0] = [3.0, 4.0]
    steps = steps_of(replace(e, residual=residual), e, np.zeros(CORNERS, bool))
    assert steps.errors["px"][0, 0] == np.sqrt(25.0 / CORNERS)


def test_images_without_names_are_told_by_their_poses():
    e = without_images(evaluation())
    steps = steps_of(e, e, np.zeros(4 * CORNERS, bool))
    assert steps.labels == ("row 1", f"row {CORNERS + 1}", f"row {2 * CORNERS + 1}", "row 61")


def test_rows_of_other_kinds_are_steps_of_their_own():
    c = made("paper")
    m = c.fit.measurements
    e = Evaluation(c.nominal, m, c.nominal_setup, (), c.rows.residual_nominal, c.rows.channels)
    steps = steps_of(e, e, flagged_rows(c))
    assert not steps.of_images
    assert steps.labels == tuple(f"row {row}" for row in m.rows)
    np.testing.assert_allclose(
        steps.errors["m"][0], np.linalg.norm(c.rows.residual_nominal, axis=1), rtol=1e-12
    )


def test_errors_that_no_row_has_or_one_row_has_choose_the_first_row_or_that_one():
    nan = np.nan
    fitted = np.array([True, True, True, False])
    assert typical_step(np.full((2, 4), nan), fitted) == 0
    assert typical_step(np.array([[nan, nan, nan, 1.0]] * 2), fitted) == 3
    assert typical_step(np.array([[3.0, 1.0, 2.0, 2.0]] * 2), fitted) == 2
    # The median of the one is the extreme of the other: neither is typical.
    assert (
        typical_step(
            np.array([[1.0, 2.0, 3.0, 4.0, 5.0], [4.0, 1.0, 3.0, 5.0, 2.0]]), np.ones(5, bool)
        )
        == 2
    )
