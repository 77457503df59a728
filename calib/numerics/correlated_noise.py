"""Correlated errors of measured poses: their covariance, and transformations by which they become independent.

The error e of a measured pose has six components: of the target's position, and the rotation vector of its orientation,
measured minus predicted, along the axes of the measurement frame; errors of two rows are independent. With the
measurement comes their covariance C, shape (6, 6) [m^2, m rad, rad^2]. It may be wrong by a scale s^2, and does not
include the robot, which adds errors of standard deviations t along each of these axes and a about each. And joints that
turn miss their readings by g (the steps of encoders and servos, play), which moves the target by the Jacobian J_q:

    V = s^2 C + diag(t^2, t^2, t^2, a^2, a^2, a^2) + g^2 J_q J_q^T

With its blocks V_tt of the position, V_rr of the orientation and V_tr between them, and factors L L^T of a Cholesky
decomposition, the part of the position's error that follows from the orientation's is subtracted:

    e_r' = L_r^-1 e_r                                V_rr                         = L_r L_r^T
    e_t' = L_t^-1 (e_t - V_tr V_rr^-1 e_r)           V_tt - V_tr V_rr^-1 V_tr^T   = L_t L_t^T

so that e' = W e has W V W^T = 1. The three entries of e_t' still belong to the position, those of e_r' to the
orientation: each has a noise factor of its own, as positions and orientations of other measurements have.

From residuals r of a fit, with the Jacobians J and the covariance P of its parameters, s, t, a and g are those of the
highest restricted likelihood, with a weak prior of s about 1, by expectation and maximisation (N. Laird, N. Lange, D.
Stram, 1987): in turn with the fit, they minimise, with the rows' weights w and S = r r^T + J P J^T,

    sum over rows of w [log det V + tr(V^-1 S)] + (log s / log 10)^2
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array

#: Units of the scalars of a pose: of its position, then of the rotation vector of its orientation; and their number.
POSE_UNITS = ("m", "m", "m", "rad", "rad", "rad")
POSE = len(POSE_UNITS)

#: The six scalars with those of the orientation first.
_ORDER = [3, 4, 5, 0, 1, 2]

#: Lowest and highest s, t, a and g of any instrument and robot.
_BOUNDS = ((1e-4, 1e4), (1e-9, 10.0), (1e-9, 10.0), (1e-9, 10.0))

#: Standard deviation of the prior of log s: a factor of ten either way, as for the noise of other measurements.
_SCALE_SPREAD = float(np.log(10.0))


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Scale of the stated covariances C of measured poses, and what the robot adds: V at the head of this module."""

    #: s, by which the instrument's standard deviations are multiplied
    scale: float
    #: t, standard deviation along each axis [m]
    position: float
    #: a, standard deviation about each axis [rad]
    orientation: float
    #: g, standard deviation of the errors of joints that turn [rad]; 0 without such joints
    joint: float

    def covariances(self, stated: Array, by_joints: Array) -> Array:
        """Return V of n poses.

        Args:
            stated: C, shape (n, 6, 6) [m^2, m rad, rad^2].
            by_joints: J_q J_q^T, shape (n, 6, 6) [m^2, m, 1].

        Returns:
            V, shape (n, 6, 6) [m^2, m rad, rad^2].
        """
        std = np.repeat([self.position, self.orientation], POSE // 2)
        return np.asarray(self.scale**2 * stated + np.diag(std**2) + self.joint**2 * by_joints)


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
    # Applied twice, the permutation gives the original order.
    return np.asarray(factors[:, _ORDER][:, :, _ORDER])


def likeliest_noise(
    stated: Array, by_joints: Array, squares: Array, weights: Array, start: PoseNoise
) -> PoseNoise:
    """Return the likeliest noise of poses, with a weak prior of s about 1, given the expected squares of their errors.

    Args:
        stated: C, shape (n, 6, 6) [m^2, m rad, rad^2].
        by_joints: J_q J_q^T, shape (n, 6, 6) [m^2, m, 1].
        squares: S, shape (n, 6, 6), expected products of the errors' components [m^2, m rad, rad^2].
        weights: shape (n,), how much each row counts.
        start: Where the search begins. None of its numbers may be so small that V hardly depends on it: the search is
            by logarithms, and would stay there.

    Returns:
        The scale s, and the standard deviations t, a and g; the last is 0 if no joint turns.
    """
    noise, _ = _likeliest(stated, by_joints, squares, weights, start)
    return noise


def compare_with_equal(
    stated: Array, by_joints: Array, squares: Array, weights: Array, start: PoseNoise
) -> float:
    """Compare the likelihood of stated covariances with that of equal ones, each at its likeliest noise.

    Args:
        stated: C, shape (n, 6, 6) [m^2, m rad, rad^2].
        by_joints: J_q J_q^T, shape (n, 6, 6) [m^2, m, 1].
        squares: S, shape (n, 6, 6), expected products of the errors' components [m^2, m rad, rad^2].
        weights: shape (n,), how much each row counts.
        start: Where the searches for the likeliest noise begin.

    Returns:
        Log-likelihood with C less that with uncorrelated errors of equal variances in all rows. It is positive if C
        describes the errors of a row, and clearly negative if it contradicts them, such as in another order or frame.
    """
    variances = np.mean(np.diagonal(stated, axis1=1, axis2=2), axis=0)
    by_unit = np.repeat(variances.reshape(2, -1).mean(axis=1), POSE // 2)
    equal = np.broadcast_to(np.diag(by_unit), stated.shape)
    _, cost = _likeliest(stated, by_joints, squares, weights, start)
    _, cost_of_equal = _likeliest(equal, by_joints, squares, weights, start)
    return 0.5 * (cost_of_equal - cost)


def _likeliest(
    stated: Array, by_joints: Array, squares: Array, weights: Array, start: PoseNoise
) -> tuple[PoseNoise, float]:
    """Return the noise by what `likeliest_noise` takes, as it does, and the least value of the module's sum."""
    # Imported late: only poses with covariances need it.
    from scipy.optimize import minimize

    begin = [start.scale, start.position, start.orientation, start.joint]
    of_position = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    of_orientation = np.eye(POSE) - of_position

    def cost(logarithms: Array) -> tuple[float, Array]:
        """Return sum w [log det V + tr(V^-1 S)] + (log s / log 10)^2, and its derivative (4,) by log s, t, a and g."""
        s, t, a, g = np.exp(logarithms)
        V = PoseNoise(s, t, a, g).covariances(stated, by_joints)
        inverse = np.linalg.inv(V)
        explained = inverse @ squares
        misfits = np.linalg.slogdet(V)[1] + np.trace(explained, axis1=1, axis2=2)
        by_V = inverse - explained @ inverse
        slopes = []
        parts = (s**2 * stated, t**2 * of_position, a**2 * of_orientation, g**2 * by_joints)
        for part in parts:
            of_rows = 2.0 * np.sum(by_V * part, axis=(1, 2))
            slopes.append(float(weights @ of_rows))
        prior = logarithms[0] / _SCALE_SPREAD
        slopes[0] += 2.0 * prior / _SCALE_SPREAD
        return float(weights @ misfits + prior**2), np.array(slopes)

    found = minimize(cost, np.log(begin), jac=True, method="L-BFGS-B", bounds=np.log(_BOUNDS))
    scale, position, orientation, joint = np.exp(found.x).tolist()
    noise = PoseNoise(scale, position, orientation, joint if np.any(by_joints) else 0.0)
    return noise, float(found.fun)
