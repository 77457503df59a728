"""Measurements that a controller computed: residuals of the rounding of coordinates and of joint values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.diagnosis.computed import (
    _DECIMALS,
    _ON_GRID,
    _by_joints,
    computed_measurements,
    largest_step,
)
from calib.diagnosis.reasons import Why
from calib.fit.estimate.fitting import Fitted
from calib.robot.ranges import random_joint_values
from tests.judged import arm, fit_to, table_of

#: A hundredth of a degree [rad].
STEP = float(np.radians(0.01))


def rounded(values, step):
    return step * np.round(values / step) if step else values


def fit_of(make_scene, noise, step, joint_step=0.0, still=()) -> Fitted:
    """A fit to forty points with noise [m], rounded to steps [m] and [rad]; some joints stand still, at 30 deg."""
    scene = arm(make_scene, 7)
    q = random_joint_values(scene.robot, 40, 7)
    q[:, list(still)] = np.radians(30.0)
    rng = np.random.default_rng(7)
    table = table_of(scene, q, rng)
    exact = scene.kinematics.points(scene.x, scene.samples(len(q), q=q))
    points = rounded(exact + noise * rng.normal(size=exact.shape), step)
    table = replace(table, joints=rounded(q, joint_step), points=points)
    return fit_to(scene, table, Cell(model="dh"))


@pytest.mark.parametrize(
    ("noise", "step", "joint_step", "said"),
    [
        (0.0, 1e-5, 0.0, True),  # hundredths of a millimetre
        (0.0, 1e-5, STEP, True),  # and of a degree
        (0.0, 0.0, 0.0, True),  # all digits: no instrument is so good
        (2e-5, 1e-5, 0.0, False),  # a good tracker
        (5e-5, 1e-5, STEP, False),
        (5e-5, 0.0, 0.0, False),
        (0.0, 1e-3, 0.0, False),  # whole millimetres, which hide any good instrument's noise
    ],
)
def test_residuals_that_are_rounding_were_not_measured(make_scene, noise, step, joint_step, said):
    found = list(computed_measurements(fit_of(make_scene, noise, step, joint_step)))
    assert [reason.why for reason in found] == [Why.MEASUREMENTS_COMPUTED] * said
    if said and not joint_step:
        values = found[0].values
        assert values["rounding_m"] == pytest.approx(step / np.sqrt(12.0))
        assert values["noise_m"] < max(1.3 * values["rounding_m"], 1e-6)


def test_a_joint_that_stood_still_has_no_rounding_that_differs(make_scene):
    """Its only value is a multiple of ten degrees."""
    (reason,) = computed_measurements(fit_of(make_scene, 0.0, 1e-5, STEP, still=[3]))
    values = reason.values
    assert values["noise_m"] == pytest.approx(values["rounding_m"], rel=0.3)
    assert values["rounding_m"] < 3e-5


def test_rounded_joint_values_move_a_coordinate_by_their_lever(make_scene):
    """The variance is that of points at joint values rounded anew, in the steps of the table."""
    scene = arm(make_scene, 7)
    fitted = fit_of(make_scene, 0.0, 1e-5, STEP)
    q = np.repeat(fitted.estimate.problem.rows.joints, 50, axis=0)
    off = STEP * np.random.default_rng(1).uniform(-0.5, 0.5, size=q.shape)
    points, moved = (
        scene.kinematics.points(scene.x, scene.samples(len(q), q=v)) for v in (q, q + off)
    )
    assert _by_joints(fitted) == pytest.approx(np.mean((moved - points) ** 2), rel=0.05)


@pytest.mark.parametrize(
    ("values", "step"),
    [
        ([0.123, 4.0, -0.5], 1e-3),
        ([1e-3, 0.7], 1e-3),
        ([2e-5, 0.7], 1e-5),
        ([np.pi, np.e], 0.0),
        ([2.0, 3.0], 1.0),
    ],
)
def test_the_last_decimal_of_values(values, step):
    assert largest_step(np.array(values), _DECIMALS, _ON_GRID) == pytest.approx(step)


def test_the_last_decimal_in_the_unit_that_has_the_largest_step():
    q = np.radians([30.2, -10.5])
    steps = np.concatenate([_DECIMALS, np.radians(_DECIMALS)])
    assert largest_step(q, steps, _ON_GRID) == pytest.approx(10 * STEP)


def test_values_may_miss_a_step_by_a_share_of_it():
    assert largest_step(np.array([1.004, 2.0]), np.array([0.01, 1.0, 0.1]), 0.005) == 1.0
    assert largest_step(np.array([1.006, 2.0]), np.array([0.01, 1.0]), 0.005) == 0.0
