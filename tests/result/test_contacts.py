"""Robots calibrated by contact alone: a flange that lies flat on a plane."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def flat_touches(ur3):
    """Joint values of a true arm, whose zeros are off, at which its flange lies flat on a plane, turned anyhow."""
    rng = np.random.default_rng(8)
    model = error_model(ur3, "zeros", target=False)
    true = model.apply(ur3, 0.01 * rng.standard_normal(len(model)))
    T_frame_base = np.eye(4)
    T_frame_base[:3, :3] = Rotation.from_euler("xy", [0.15, -0.1]).as_matrix()
    T_frame_base[2, 3] = -0.1

    def miss(q):
        T = T_frame_base @ true.poses(q[None])[0]
        return np.array([T[2, 3], T[0, 2], T[1, 2]])

    result = []
    while len(result) < 24:
        solution = least_squares(miss, rng.uniform(-2.0, 2.0, 6), xtol=1e-14, ftol=1e-14, gtol=None)
        is_up = true.poses(solution.x[None])[0] @ [0.0, 0.0, 1.0, 0.0] @ T_frame_base[2] > 0.0
        if solution.cost < 1e-20 and is_up:
            result.append(solution.x)
    return np.array(result)


def touched(ur3, joints, kind, **known):
    """A calibration by touches of one kind, by joint values with noise."""
    noise = 5e-4 * np.random.default_rng(9).standard_normal(joints.shape)
    table = Measurements(
        ur3.joint_names,
        joints + noise,
        np.full((len(joints), 3), np.nan),
        kinds=(kind,) * len(joints),
    )
    return calibrate(ur3, table, cell=Cell(model="zeros", **known), validate=False)


def test_a_flat_hand_determines_tilts_and_no_height(ur3, flat_touches):
    result = touched(ur3, flat_touches, "face")
    names = [name for name in result.model.names if name.startswith("target")]
    assert names == ["target_rx", "target_ry"]
    z = result.setup.T_tip_target[0, :3, 2]
    assert np.arccos(abs(z[2])) < 2e-3
    np.testing.assert_array_equal(result.setup.T_tip_target[0, :3, 3], 0.0)
    errors = [of_robot["estimation"]["rad"].rms for of_robot in result.errors.values()]
    assert errors[1] < 0.3 * errors[0]


def test_contacts_that_hardly_see_a_target_leave_it_where_it_was_stated(ur3, flat_touches):
    """A hand that always lies flat on a plane shows its own height by errors of the second order alone."""
    stated = np.array([0.0, 0.0, 0.02])
    loose = {f"target_{axis}": 1.0 for axis in "xyz"}

    def moved(**known):
        result = touched(ur3, flat_touches, "plane", target=stated, **known)
        return np.linalg.norm(result.setup.T_tip_target[0, :3, 3] - stated)

    assert moved() < 2e-3
    assert moved(parameter_priors=loose) > 20e-3
