"""How well positions are known over the workspace."""

from __future__ import annotations

import numpy as np

from calib.identify.uncertainty import workspace_uncertainty
from calib.show.cloud import EVERYWHERE, MEASURED, cloud_of
from tests.show.calibrations import made


def test_the_cloud_is_the_uncertainty_over_the_workspace():
    result = made("paper")
    cloud = cloud_of(result)
    assert cloud.points.shape == (EVERYWHERE + MEASURED, 3)
    same = workspace_uncertainty(result, EVERYWHERE)
    np.testing.assert_allclose(cloud.std[:EVERYWHERE], same.std, rtol=1e-12)
    at = result.predict(same.q)
    np.testing.assert_allclose(cloud.points[:EVERYWHERE], at, atol=1e-12)


def test_where_joints_were_measured_positions_are_known_better():
    cloud = cloud_of(made("paper"))
    assert cloud.measured[EVERYWHERE:].all()
    assert not cloud.measured[:EVERYWHERE].all()
    assert np.median(cloud.std[cloud.measured]) < np.median(cloud.std[~cloud.measured])
