"""What the studies of scripts/ share: tables, jobs, and arms that are described there."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from arms import load_arm, without_masses
from studies import draw_errors, joint_values_around, run_cases, run_jobs, table_lines

from calib.model.parameter_sets import error_model
from calib.robot.gravity import gravity_loads


def test_a_table_is_markdown_with_padded_columns():
    lines = list(table_lines(["case", "value"], [["one", 1], ["", "x"]], widths=[5]))
    assert lines == ["| case  | value |", "|---|---|", "| one   | 1 |", "|       | x |"]


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_results_come_in_the_order_of_the_jobs(workers):
    jobs = [(number, 2) for number in range(5)]
    assert list(run_jobs(pow, jobs, workers=workers)) == [0, 1, 4, 9, 16]
    assert list(run_cases(pow, [2, 3], [1, 2], workers=workers)) == [(2, [2, 4]), (3, [3, 9])]


def test_no_jobs_have_no_results():
    assert list(run_jobs(pow, [])) == []


def test_errors_have_the_standard_deviations_of_their_units():
    model = error_model(load_arm("ur3"), "placement")
    errors = np.array([draw_errors(model, 2.0, 5.0, np.random.default_rng(k)) for k in range(400)])
    std = np.where(np.array(model.units) == "m", 2.0, 5.0)
    assert errors.std(axis=0) == pytest.approx(std, rel=0.2)


def test_joint_values_are_in_a_part_of_the_ranges():
    robot = load_arm("ur3")
    centre = np.full((1, 6), 0.5)
    everywhere = joint_values_around(centre, 1.0, robot, 50, 1)
    near = joint_values_around(centre, 0.1, robot, 50, 1)
    np.testing.assert_allclose(near - 0.5, 0.1 * (everywhere - 0.5))


@pytest.mark.parametrize(("name", "joints"), [("iiwa", 7), ("irb120", 6)])
def test_a_described_arm_has_masses_that_can_be_left_out(name, joints):
    robot = load_arm(name)
    assert len(robot.joints) == joints
    q = np.full((1, joints), 0.3)
    bare = without_masses(robot)
    np.testing.assert_allclose(bare.poses(q), robot.poses(q))
    assert np.abs(gravity_loads(robot, q)[..., 0]).max() > 1.0
    assert np.abs(gravity_loads(bare, q)[..., 0]).max() == 0.0
