"""What the verdict looks at besides errors."""

from __future__ import annotations

import numpy as np
import pytest

from calib.identify.evidence import largest_change, still_joints, validation_errors
from calib.model.error_model import error_model


def test_one_wild_validation_row_is_set_aside():
    validation = np.arange(10) >= 4
    nominal, calibrated = np.full((10, 3), 1e-3), np.full((10, 3), 1e-4)
    nominal[7] = calibrated[7] = 0.05
    before, after, aside = validation_errors(validation, np.arange(10) == 7, nominal, calibrated)
    assert (before.n, after.n, aside) == (5, 5, 1)
    assert after.rms == pytest.approx(1e-4 * np.sqrt(3))


def test_many_rows_that_do_not_fit_are_no_accidents():
    validation = np.arange(10) >= 4
    residual = np.full((10, 3), 1e-3)
    before, _, aside = validation_errors(validation, np.arange(10) >= 7, residual, residual)
    assert (before.n, aside) == (6, 0)


def test_a_single_validation_row_is_never_set_aside():
    validation = np.arange(3) == 2
    residual = np.full((3, 3), 1e-3)
    assert validation_errors(validation, validation, residual, residual)[2] == 0


def test_without_validation_rows_there_are_no_errors():
    nothing = np.zeros(4, dtype=bool)
    before, after, aside = validation_errors(nothing, nothing, np.ones((4, 3)), np.ones((4, 3)))
    assert (before.n, after.n, aside) == (0, 0, 0)


def test_joints_that_stand_still_are_named_with_their_range(ur3):
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (20, 6))
    assert still_joints(ur3, q) == ()
    q[:, 2] = 0.3
    q[:, 4] = np.linspace(0, np.radians(10), 20)
    assert still_joints(ur3, q) == ("'elbow_joint' (0 deg)", "'wrist_2_joint' (10 deg)")


def test_the_largest_change_is_of_the_robot_itself(ur3):
    model = error_model(ur3, "dh", frame=True)
    x = np.zeros(len(model))
    x[model.index("frame_x")] = 5.0
    x[model.index("target_z")] = 0.4
    x[model.index("d2")] = -0.03
    assert largest_change(model, x) == 0.03
    assert largest_change(error_model(ur3, "frames"), np.ones(3)) == 0.0
