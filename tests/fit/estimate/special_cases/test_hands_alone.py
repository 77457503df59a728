"""Errors that no contact between hands sees are as uncertain as those of a robot that nobody has measured."""

from __future__ import annotations

import numpy as np
import pytest

import calib.data.kinds as registry
from calib.data.cell import Cell, FurtherRobot
from calib.data.cell_chains import robot_of_cell
from calib.fit.estimate.special_cases.hands_alone import (
    added_covariance,
    hands_alone,
    missing_variance,
)
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf


def test_the_covariance_is_that_of_the_estimate_under_the_wider_prior():
    """E (x^ - x)(x^ - x)^T of x^ = C A^T y with y = A x + noise, from the definition; one column is not seen."""
    rng = np.random.default_rng(1)
    A = 30.0 * rng.normal(size=(20, 4))
    A[:, 3] = 0.0
    narrow, wide = np.array([0.1, 0.2, 0.3, 0.1]), np.array([0.5, 0.2, 0.4, 0.5])
    P = np.diag(1.0 / narrow**2)
    C = np.linalg.inv(A.T @ A + P)
    left_out = C @ A.T @ A - np.eye(4)  # x^ - x without noise, by x
    expected = left_out @ np.diag(wide**2) @ left_out.T + C @ A.T @ A @ C
    found = C + added_covariance(C, np.diagonal(P), wide**2 - narrow**2)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert found[3, 3] == pytest.approx(0.5**2)
    # What the rows determine is hardly less certain.
    assert found[0, 0] < 1.3 * C[0, 0]


def test_a_prior_is_widened_to_the_typical_size_and_never_narrowed():
    families = np.array([[True, False, True, False], [False, True, False, False]])
    missing = missing_variance(families, np.array([1.0, 5.0]), np.array([3.0, 4.0]))
    assert missing.tolist() == [8.0, 0.0, 8.0, 0.0]


@pytest.mark.parametrize(
    ("kinds", "alone"),
    [
        (["clasp"], True),
        (["fixed", "stop"], True),
        (["face"], True),
        (["clasp", "point"], False),
        (["clasp", "distance"], False),
    ],
)
def test_they_are_alone_without_any_other_measurement(kinds, alone):
    cell = Cell(
        bases={"grip": "panda_link8"},
        tips={"right": "right/panda_link8"},
        robots={"right": FurtherRobot("panda")},
    )
    rows = [registry.get(kind) for kind in kinds]
    assert hands_alone(rows, robot_of_cell(read_urdf("panda"), cell)) == alone
    # A hand that touches what stands still is no pair.
    assert not hands_alone(rows, Robot.load("panda", tip="panda_link8"))
