"""Intrinsics and boards against what was stated: wrong ones are named with their size, right ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.images.stated import contradicted_statements
from calib.diagnosis.reasons import Why
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from tests.images import BOARD, VALUES, arm, camera, cell, poses, table

FOCAL = np.array([1.015, 1.015, 1, 1, 1, 1, 1, 1, 1])
CLOSE = np.array([1.0, 1.0, 2.0, 2.0, 5e-3, 5e-3, 5e-4, 5e-4, 5e-3])


def reasons(camera, board=BOARD, model="zeros", **made):
    robot = arm()
    c = cell(cameras={"": camera}, boards={"": board})
    rows, setup = rows_and_setup(robot, table(poses(20), noise=0.2, **made), c)
    return list(contradicted_statements(fit(Task(robot, c, setup, model), rows)))


@pytest.mark.parametrize("exact", [True, False])
def test_a_wrong_focal_length_is_named(exact):
    stated = camera(values=VALUES["pinhole"] * FOCAL, sigma=np.zeros(9) if exact else CLOSE)
    (reason,) = reasons(stated)
    assert reason.why is Why.FOCAL_LENGTH_OFF
    assert reason.values["share"] == pytest.approx(1.0 / 1.015 - 1.0, abs=4e-3)
    assert reason.values["exact"] is exact


def test_a_focal_length_of_another_resolution_is_named_with_its_share_of_the_stated_one():
    half = np.array([2.0, 2.0, 1, 1, 1, 1, 1, 1, 1])
    (reason,) = reasons(camera(values=VALUES["pinhole"] * half))
    assert reason.why is Why.FOCAL_LENGTH_OFF
    assert reason.values["share"] == pytest.approx(-0.5, abs=0.02)


@pytest.mark.parametrize("sigma", [0.0, 0.003])
def test_a_board_of_another_size_is_named(sigma):
    stated = replace(BOARD, sigma_scale=sigma)
    (reason,) = reasons(camera(sigma=CLOSE), stated, points=1.01 * BOARD.corners)
    assert reason.why is Why.BOARD_SCALE_OFF
    assert reason.values["share"] == pytest.approx(0.01, abs=5e-3)
    assert reason.values["exact"] is (sigma == 0.0)


@pytest.mark.parametrize("square", [0.96, 0.9])
def test_a_wrong_square_is_named_though_all_lengths_of_the_arm_make_up_for_it(square):
    """Lengths of the arm that have grown alike, by much more than arms are wrong, are no proof of a wide prior."""
    stated = replace(BOARD, sigma_scale=0.003)
    (reason,) = reasons(camera(sigma=CLOSE), stated, model="dh", points=square * BOARD.corners)
    assert reason.why is Why.BOARD_SCALE_OFF
    assert reason.values["share"] == pytest.approx(square - 1.0, abs=0.015)


@pytest.mark.parametrize("exact", [True, False])
def test_right_statements_are_not_contradicted(exact):
    stated = camera(sigma=np.zeros(9) if exact else CLOSE)
    assert reasons(stated, replace(BOARD, sigma_scale=0.0 if exact else 0.003)) == []
