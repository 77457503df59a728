"""The map of U over the joint limits: its poses, places, sizes and scale of colours."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.ranges import spread_poses
from calib.show.uncertainty_map import UncertaintyMap, predicted_places, uncertainty_map


def test_it_is_the_uncertainty_at_poses_over_the_joint_limits(default_result):
    c = default_result
    found = uncertainty_map(c, 50)
    np.testing.assert_array_equal(found.q, spread_poses(c.nominal, 50))
    U = c.uncertainty(found.q, non_geometric=False)
    np.testing.assert_allclose(found.position, U.position)
    # The paper's table is in the base.
    np.testing.assert_allclose(found.places, U.poses[:, :3, 3], atol=1e-12)


def test_places_are_those_of_the_target(default_result):
    c = default_result
    q = c.fit.measurements.joints_for(c.nominal.joint_names)
    homogeneous = c.robot.poses(q) @ np.append(c.target, 1.0)
    np.testing.assert_allclose(predicted_places(c, q), homogeneous[:, :3], atol=1e-12)


def test_few_uncertain_poses_do_not_make_all_others_alike():
    position = np.append(np.linspace(1e-4, 2e-4, 99), 1.0)
    found = UncertaintyMap(np.zeros((100, 6)), np.zeros((100, 3)), position)
    low, high = found.scale
    assert (low, high) == (1e-4, pytest.approx(2e-4, rel=0.02))
    assert found.shares[0] == 0.0
    assert found.shares[49] == pytest.approx(0.5, abs=0.02)
    assert found.shares[99] == 1.0


def test_equal_uncertainties_have_the_first_colour():
    found = UncertaintyMap(np.zeros((3, 6)), np.zeros((3, 3)), np.full(3, 1e-4))
    np.testing.assert_array_equal(found.shares, 0.0)
