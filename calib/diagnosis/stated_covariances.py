"""Covariances of poses that tell nothing of the poses' errors: they are of something else."""

from __future__ import annotations

from collections.abc import Iterator

from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.special_cases.pose_covariances import covariance_support

#: Log-likelihood over that of equal covariances up to which stated ones tell nothing.
_NOTHING = 2.0

#: That which they have at least if they are right, to tell anything of so many poses.
_TELLING = 10.0


def idle_covariances(fitted: Fitted) -> Iterator[Reason]:
    """Say if the stated covariances of poses explain their residuals no better than equal ones, as they should.

    They are then in another order, unit or frame, or of other rows; or the robot misses its stops by far more than they
    tell. The fit does not rely on them: their scale is small.

    Args:
        fitted: A fit.

    Yields:
        One reason, with the scale of the covariances; none without covariances, or where these are nearly alike.
    """
    found = covariance_support(fitted.estimate)
    if found is None:
        return
    support, expected = found
    if support < _NOTHING and expected > _TELLING:
        scale = fitted.estimate.problem.rows.pose_noise.scale
        yield Reason.of(Why.COVARIANCES_IDLE, scale=scale)
