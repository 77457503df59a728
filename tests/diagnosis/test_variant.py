"""Lengths that no arm is off by: which change, by how much, and the type of arm whose lengths are found."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.diagnosis.reasons import Why
from calib.diagnosis.stated_values import instrument_scale
from calib.diagnosis.variant import length_intervals, other_variant
from calib.model.dh_table import dh_table
from calib.numerics.errors import interval_factor
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.robot.ur_models import UrModel, ur_model, ur_urdf
from tests.judged import arm, fit_to, table_of


@pytest.fixture
def arm_with(tmp_path):
    """A function that makes a UR arm of whose DH lengths (row, column: 1 for a, 2 for d) some are changed [m]."""

    def make(name, changes=()):
        rows = ur_model(name).rows.copy()
        for row, column, change in changes:
            rows[row, column] += change
        path = tmp_path / "arm.urdf"
        path.write_bytes(ur_urdf(UrModel(name, rows)))
        return Robot.load(path, base="base", tip="tool0")

    return make


@pytest.mark.parametrize(("nominal", "true"), [("ur3e", "UR3"), ("ur10", "UR10e"), ("ur5", "UR5e")])
def test_another_variant_of_the_arm_is_named(arm_with, nominal, true):
    true_arm = arm_with(true, [(2, 1, 4e-4), (4, 2, -3e-4)])
    [reason] = other_variant(arm_with(nominal), true_arm, lambda: np.full((4, 2), 1e-4))
    assert (reason.why, reason.values["arm"]) == (Why.OTHER_VARIANT, true)
    assert (reason.values["joint"], reason.values["length"]) == ("wrist_1_joint", "d")
    moved = ur_model(true).rows[3, 2] - ur_model(nominal).rows[3, 2]
    assert reason.values["moved_m"] == pytest.approx(abs(moved), abs=1e-6)


@pytest.mark.parametrize(
    ("moved", "other", "said"),
    [
        (4.9e-3, 0.8e-3, False),  # below 5 mm, and not far beyond the others
        (5.1e-3, 0.8e-3, True),
        (2.0e-3, 0.2e-3, True),  # more than twenty times the rms of the seven others
        (2.0e-3, 0.3e-3, False),
        (0.9e-3, 0.0, False),  # so small no variant is
    ],
)
def test_a_length_must_be_off_by_more_than_an_arms_errors(arm_with, moved, other, said):
    changes = [(4, 2, moved), (1, 1, other)]
    exact = partial(np.zeros, (4, 2))
    found = list(other_variant(arm_with("ur3"), arm_with("ur3", changes), exact))
    assert bool(found) == said
    for reason in found:
        assert (reason.values["joint"], reason.values["length"]) == ("wrist_2_joint", "d")
        assert reason.values["moved_m"] == pytest.approx(moved, abs=1e-6)
        assert reason.values["others_m"] == pytest.approx(other / np.sqrt(7.0), abs=1e-6)
        assert reason.values["arm"] == ""


def test_where_base_and_target_are_tells_nothing_of_the_arm(arm_with):
    """The lengths of the first and of the last row."""
    moved = arm_with("ur3", [(0, 2, 0.02), (5, 2, 0.02)])
    assert not list(other_variant(arm_with("ur3"), moved, partial(np.zeros, (4, 2))))


@pytest.mark.parametrize(("half_width", "said"), [(1.9e-3, True), (2.1e-3, False)])
def test_a_length_that_the_rows_leave_open_tells_nothing(arm_with, half_width, said):
    """Between 7 mm and the 5 mm that an arm may be off by."""
    half_widths = np.zeros((4, 2))
    half_widths[3, 1] = half_width
    moved = arm_with("ur3", [(4, 2, 7e-3), (1, 1, 1e-3)])
    found = list(other_variant(arm_with("ur3"), moved, lambda: half_widths))
    assert [reason.values["interval_m"] for reason in found] == [half_width] * said


def test_a_smaller_change_that_is_sure_counts_before_a_larger_one_that_is_not(arm_with):
    half_widths = np.zeros((4, 2))
    half_widths[3, 1] = 0.1
    moved = arm_with("ur3", [(4, 2, 0.03), (1, 1, 0.02)])
    [reason] = other_variant(arm_with("ur3"), moved, lambda: half_widths)
    assert (reason.values["joint"], reason.values["length"]) == ("shoulder_lift_joint", "a")


@pytest.fixture
def fitted_as(make_scene):
    """A function that fits a model to points of a wrong UR3."""

    def make(model):
        scene = arm(make_scene, 63)
        table = table_of(scene, random_joint_values(scene.robot, 40, 3), np.random.default_rng(3))
        return fit_to(scene, table, Cell(model=model))

    return make


def test_intervals_of_lengths_are_those_of_the_dh_parameters(fitted_as):
    fitted = fitted_as("dh")
    estimate, names = fitted.estimate, fitted.kinematics.model.names
    std = dict(zip(names, np.sqrt(np.diag(estimate.covariance)), strict=True))
    factor = interval_factor(estimate.freedom)
    half_widths = length_intervals(fitted, None)
    found = {"a4": half_widths[2, 0], "a5": half_widths[3, 0], "d5": half_widths[3, 1]}
    assert found == pytest.approx({name: factor * std[name] for name in found}, rel=1e-3)
    # A scale error of the instrument widens those of long lengths.
    wide = replace(instrument_scale(fitted), share=0.0, std=0.05, prior=0.05)
    upper_arm = abs(dh_table(fitted.task.robot).rows[1].a)
    of_scale = length_intervals(fitted, wide)[0, 0]
    assert of_scale == pytest.approx(factor * wide.size * upper_arm, rel=0.2)


@pytest.mark.slow
def test_intervals_of_lengths_are_those_of_robots_drawn_at_random(fitted_as):
    fitted = fitted_as("placement")
    estimate, model, robot = fitted.estimate, fitted.kinematics.model, fitted.task.robot
    rng = np.random.default_rng(1)
    lengths = []
    for x in rng.multivariate_normal(estimate.x, 1e-2 * estimate.covariance, size=300):
        rows = dh_table(model.apply(robot, x), like=robot).rows[1:-1]
        lengths.append([(row.a, row.d) for row in rows])
    expected = 10.0 * interval_factor(estimate.freedom) * np.std(lengths, axis=0)
    np.testing.assert_allclose(length_intervals(fitted, None), expected, rtol=0.2, atol=1e-9)
