"""The cloud of a calibration: points of the workspace, and how well the calibrated robot knows them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.model.readback import column_ranges, spread_between
from calib.show.view import Cloud

Array = NDArray[np.float64]

#: Points over the joint limits, and within the measured joint values.
EVERYWHERE, MEASURED = 4000, 2000


def cloud_of(calibration: Calibration) -> Cloud:
    """Predicted positions and their standard deviation, sqrt(trace(J C J^T)), over the workspace.

    Half as many points again lie within the range of the joint values that were fitted as over the joint limits. The
    standard deviations are those of `calib.workspace_uncertainty`: they know nothing of errors that the model lacks.

    Args:
        calibration: The calibration.
    """
    robot = calibration.robot
    seen = calibration.measurements.joints_for(robot.joint_names)[calibration.weights > 0.0]
    limits = column_ranges(robot)
    inner = np.stack([seen.min(axis=0), seen.max(axis=0)], axis=1) if len(seen) else limits
    q = np.concatenate([spread_between(limits, EVERYWHERE), spread_between(inner, MEASURED)])
    std = calibration.position_std(q, larger=False)
    T = robot.poses(q)
    points = T[:, :3, :3] @ calibration.target + T[:, :3, 3]
    return Cloud(points, std, np.all((q >= inner[:, 0]) & (q <= inner[:, 1]), axis=1))
