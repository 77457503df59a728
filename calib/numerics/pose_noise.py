"""Correlated errors of measured poses: their covariance, and transformations by which they become independent.

The error e = (position, rotation vector) of a measured pose has six components. An instrument states their covariance
C, shape (6, 6) [m^2, m rad, rad^2]; it may be wrong by a scale s^2, and it knows nothing of what the robot does not
repeat, which adds errors of standard deviations t along each axis and a about each:

    V = s^2 C + diag(t^2, t^2, t^2, a^2, a^2, a^2)

With its blocks V_tt of the position, V_rr of the orientation and V_tr between them, and factors L L^T of a Cholesky
decomposition, what the orientation's error tells of the position's is taken off:

    e_r' = L_r^-1 e_r                                V_rr                         = L_r L_r^T
    e_t' = L_t^-1 (e_t - V_tr V_rr^-1 e_r)           V_tt - V_tr V_rr^-1 V_tr^T   = L_t L_t^T

so that e' = W e has W V W^T = 1. The three entries of e_t' are still of the position, those of e_r' of the orientation:
each has a noise factor of its own, as positions and orientations of other measurements have.

From residuals r of a fit, with the Jacobians J and the covariance P of its parameters, s, t and a are those of the
highest restricted likelihood, by expectation and maximisation (N. Laird, N. Lange, D. Stram, 1987): in turn with the
fit, they minimise the sum of w (log det V + tr(V^-1 S)) over the rows, with S = r r^T + J P J^T and their weights w.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from calib.units import Array

#: Units of the scalars of a pose: of its position, then of the rotation vector of its orientation; and their number.
POSE_UNITS = ("m", "m", "m", "rad", "rad", "rad")
POSE = len(POSE_UNITS)

#: The orientation first.
_ORDER = [3, 4, 5, 0, 1, 2]

#: Lowest and highest scale s, and share of the smallest stated standard deviation that t or a has at least.
_SCALES = (1e-3, 1e3)
_LEAST_SHARE = 1e-3

#: Standard deviation of the prior of log s: a factor of ten either way, as of the noise of other measurements.
_SCALE_SPREAD = float(np.log(10.0))


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """What is added to the stated covariances of measured poses."""

    #: s, by which the instrument's standard deviations are multiplied
    scale: float
    #: t, standard deviation along each axis [m]
    position: float
    #: a, standard deviation about each axis [rad]
    orientation: float

    def covariances(self, stated: Array) -> Array:
        """Return V of poses with stated covariances C, both of shape (n, 6, 6) [m^2, m rad, rad^2]."""
        std = np.repeat([self.position, self.orientation], POSE // 2)
        return np.asarray(self.scale**2 * stated + np.diag(std**2))


def standardisers(covariances: Array) -> Array:
    """Return the matrices W by which errors of poses become independent, of variance 1.

    Args:
        covariances: V, shape (n, 6, 6), positive definite [m^2, m rad, rad^2].

    Returns:
        W, shape (n, 6, 6), with W V W^T = 1 [1/m, 1/rad]; see the head of this module.

    Raises:
        numpy.linalg.LinAlgError: A matrix is not positive definite.
    """
    reordered = covariances[:, _ORDER][:, :, _ORDER]
    factors = np.linalg.inv(np.linalg.cholesky(reordered))
    # Taken twice, the order is the first one again.
    return np.asarray(factors[:, _ORDER][:, :, _ORDER])


def likeliest_noise(stated: Array, squares: Array, weights: Array, start: PoseNoise) -> PoseNoise:
    """Return the noise of poses of the highest likelihood, given the expected squares of their errors.

    Args:
        stated: C, shape (n, 6, 6) [m^2, m rad, rad^2].
        squares: S, shape (n, 6, 6), expected products of the errors' components, likewise.
        weights: shape (n,), how much each row counts.
        start: Where the search begins.

    Returns:
        The scale s, and the standard deviations t and a; see the head of this module.
    """
    variances = np.diagonal(stated, axis1=1, axis2=2)
    least_position = _LEAST_SHARE * float(np.sqrt(np.min(variances[:, :3])))
    least_orientation = _LEAST_SHARE * float(np.sqrt(np.min(variances[:, 3:])))
    low = np.array([_SCALES[0], least_position, least_orientation])
    begin = np.array([start.scale, start.position, start.orientation])
    of_position = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    of_orientation = np.eye(POSE) - of_position

    def cost(logarithms: Array) -> tuple[float, Array]:
        """Return minus twice the log-likelihood and its derivative by the logarithms of s, t and a."""
        s, t, a = np.exp(logarithms)
        V = PoseNoise(s, t, a).covariances(stated)
        inverse = np.linalg.inv(V)
        explained = inverse @ squares
        misfits = np.linalg.slogdet(V)[1] + np.trace(explained, axis1=1, axis2=2)
        by_V = inverse - explained @ inverse
        slopes = []
        for part in (s**2 * stated, t**2 * of_position, a**2 * of_orientation):
            of_rows = 2.0 * np.sum(by_V * part, axis=(1, 2))
            slopes.append(float(weights @ of_rows))
        prior = logarithms[0] / _SCALE_SPREAD
        slopes[0] += 2.0 * prior / _SCALE_SPREAD
        return float(weights @ misfits + prior**2), np.array(slopes)

    bounds = [(low_log, None) for low_log in np.log(low)]
    found = minimize(
        cost, np.log(np.maximum(begin, low)), jac=True, method="L-BFGS-B", bounds=bounds
    )
    scale, position, orientation = np.exp(found.x).tolist()
    return PoseNoise(scale, position, orientation)
