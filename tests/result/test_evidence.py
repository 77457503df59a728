"""All figures of a result that its verdict is based on."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.channels import Channels
from calib.result.evidence import (
    _full_model_parameters,
    _mean_variance,
    _over_joint_limits,
    validation_errors,
)
from calib.robot.ranges import spread_poses
from tests.parts import with_part

ALL = Channels.of_unit(np.ones((10, 3), dtype=bool))


def test_one_wild_validation_row_is_set_aside():
    validation = np.arange(10) >= 4
    nominal, calibrated = np.full((10, 3), 1e-3), np.full((10, 3), 1e-4)
    nominal[7] = calibrated[7] = 0.05
    before, after, aside = validation_errors(
        validation, np.arange(10) == 7, nominal, calibrated, ALL
    )
    assert (before["m"].n, after["m"].n, aside) == (5, 5, 1)
    assert after["m"].rms == pytest.approx(1e-4 * np.sqrt(3))


def test_many_rows_that_do_not_fit_are_no_accidents():
    validation = np.arange(10) >= 4
    residual = np.full((10, 3), 1e-3)
    before, _, aside = validation_errors(validation, np.arange(10) >= 7, residual, residual, ALL)
    assert (before["m"].n, aside) == (6, 0)


def test_the_variance_of_a_position_is_the_sum_over_its_axes_and_the_mean_over_positions():
    J = np.zeros((2, 3, 2))
    J[0, 0, 0], J[0, 2, 1] = 2.0, 3.0
    covariance = np.array([[1.0, 0.5], [0.5, 4.0]])
    assert _mean_variance(J, covariance) == pytest.approx((4.0 + 36.0) / 2.0)


@pytest.mark.parametrize(("name", "places"), [("points", 3), ("set-ups", 3 * 6 + 3), ("poses", 12)])
def test_a_full_geometry_has_four_parameters_a_joint_besides_frames_and_targets(
    calibrated, name: str, places: int
):
    _, c = calibrated(name)
    assert _full_model_parameters(c, c.fit.geometry) == 6 * 4 + places
    # None is asked for where the model was named.
    assert _full_model_parameters(with_part(c, "method", candidates=()), c.fit.geometry) == 0


def test_the_nominal_robot_is_off_over_the_joint_limits_by_what_was_corrected(calibrated):
    """Without uncertainty of the parameters: the distance of both predictions, rms."""
    _, c = calibrated("known set-ups")
    certain = with_part(
        c, "geometry", covariance=np.zeros_like(c.covariance), expected_measured=0.0
    )
    of_part, of_nominal = _over_joint_limits(certain, certain.geometry)
    q = spread_poses(c.nominal)
    points = c.predict(q, target=c.setup.targets[0], group=c.setup.groups[0])
    setup = c.nominal_setup
    T = setup.T_frame_base[0] @ c.nominal.poses(q) @ setup.T_tip_target[0]
    away = np.linalg.norm(points - T[:, :3, 3], axis=1)
    assert of_part == 0.0
    assert of_nominal == pytest.approx(np.sqrt(np.mean(away**2)))
