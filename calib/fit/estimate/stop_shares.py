"""The shares of a scalar's variance that the targets of a stop have in common, estimated from a fit's residuals.

See `calib.fit.estimate.stop_errors` for stops and their covariance V = noise^2 K, with K = kappa I + G G^T and the
shares rho_t of translations, rho_r of rotations and rho_q of the joints.

The shares are estimated from the residual r of generalised least squares, E[r r^T] = V - A C A^T, by equations that
end where the restricted likelihood is highest (R. D. Anderson, 1973; S. R. Searle, G. Casella, C. E. McCulloch,
Variance Components, 1992): with the derivatives V_i of V by theta, which are noise^2 times kappa, rho_t, rho_r and
rho_q,

    sum_j tr(V^-1 V_i V^-1 V_j) theta_j = tr(V^-1 V_i V^-1 [r r^T + A C A^T])
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array

#: Columns of a body's translation.
TRANSLATION = slice(0, 3)

#: Columns of a body's rotation.
ROTATION = slice(3, 6)

#: Columns of a body's displacement, by translation and rotation.
BODY = slice(0, 6)

#: Columns of the displacement by the errors of the joints.
JOINTS = slice(6, None)

#: Columns whose directions have the same variance.
PARTS = (TRANSLATION, ROTATION, JOINTS)

#: The least kappa: no instrument's noise is less than a thousandth of what the targets of a stop share.
_LEAST_UNSHARED = 1e-6

#: With fewer degrees of freedom, of the bodies or of the targets within them, the shares are zero.
_FEWEST_FREEDOM = 12

#: The most iterations for the shares.
_STEPS = 20

#: Shares that change by less than this, relative to kappa, have settled.
_SETTLED = 1e-4

#: Divisor in place of zero.
TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class _InverseCovariance:
    """K^-1 of S stops by matrices of d rows: K^-1 = (I - J H J^T) / kappa, and K^-1 J = J T.

    J has the Jacobian of a stop's scalars by its body's displacement in d directions: translation (3), rotation (3),
    the errors of the joints. With M = J^T J and D, the diagonal matrix of each direction's share, G G^T is J D J^T.
    """

    #: The share of a scalar's variance that is independent of the other targets of its stop
    kappa: float
    #: (S, d, d), (kappa I + D M)^-1
    T: Array
    #: (S, d, d), T D
    H: Array

    @classmethod
    def of(cls, M: Array, rho: Array) -> _InverseCovariance:
        """Invert the covariance K = kappa I + J D J^T of the scalars of each stop, over the noise squared.

        J has the derivatives of a stop's scalars by the displacement of its body in d directions: three translations,
        three rotations, and the errors of d - 6 joints. D is the diagonal matrix of each direction's share, rho_t,
        rho_r or rho_q, and kappa = 1 - rho_t - rho_r - rho_q, at least 1e-6.

        Args:
            M: shape (S, d, d), J^T J of each of S stops.
            rho: shape (3,), the shares of translations, rotations and joints in the variance of a scalar.

        Returns:
            kappa; T = (kappa I + D M)^-1 and H = T D, both of shape (S, d, d), with K^-1 = (I - J H J^T) / kappa and
            K^-1 J = J T.
        """
        kappa = unshared(rho)
        directions = M.shape[1]
        shares = root_shares(rho, directions) ** 2
        T: Array = np.asarray(np.linalg.inv(kappa * np.eye(directions) + shares[:, None] * M))
        return cls(kappa, T, T * shares)


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """The moments of one instrument's residual r at S stops, from which its shares are estimated, in any unit.

    J is the Jacobian of a stop's scalars by its body's displacement in d directions, translation (3), rotation (3) and
    the errors of the joints, A that by the parameters of the fit, and C the covariance of these.
    """

    #: (S, d, d), J^T J of each stop
    M: Array
    #: (S, d, d), J^T [r r^T + A C A^T] J of each stop
    R: Array
    #: The trace of r r^T + A C A^T, of all stops
    total: float
    #: The number of scalars of all stops
    count: float

    @classmethod
    def joined(cls, parts: Sequence[Moments]) -> Moments:
        """Join the moments of a fit's residual over several parts of the stops.

        With the residual r of the scalars of a stop, the covariance A C A^T of their prediction, and their derivatives
        J by the displacement of the stop's body, moments are ``M`` = J^T J and ``R`` = J^T [r r^T + A C A^T] J of each
        of S stops, both of shape (S, d, d); ``total``, the trace of r r^T + A C A^T over all stops; and ``count``, the
        number of scalars.

        Args:
            parts: Moments of the parts, in the order of the stops, of the residual r of one instrument in one fit; at
                least one. With J, the Jacobian of a stop's scalars by the displacement in d directions of the body
                that carries its targets, and A C A^T, the covariance of the prediction: ``M``, J^T J, and ``R``,
                J^T [r r^T + A C A^T] J, shape (S, d, d), of each of the part's S stops; ``total``, the trace of
                r r^T + A C A^T, and ``count``, the number of scalars, summed over them.

        Returns:
            The moments of all stops: ``M`` and ``R`` stacked in this order, the sums of ``total`` and of ``count``.
        """
        total = 0.0
        count = 0.0
        for part in parts:
            total += part.total
            count += part.count
        M = np.concatenate([part.M for part in parts])
        R = np.concatenate([part.R for part in parts])
        return cls(M, R, total, count)

    def shares(self, rho: Array) -> Array:
        """Estimate the shares of translations, rotations and joints in a scalar's variance, by iteration.

        All targets that are measured at one standstill of the robot (a stop) move with this body. With the derivatives
        J of a stop's scalars by its displacement, and the moments of the fit's residual r: ``M`` = J^T J and ``R`` =
        J^T [r r^T + A C A^T] J, both of shape (S, d, d); ``total``, the trace of r r^T + A C A^T over all S stops,
        where A C A^T is the covariance of the prediction; and ``count``, the number of scalars.

        Args:
            rho: shape (3,), the shares of translations, rotations and joints to begin with.

        Returns:
            shape (3,), each from 0 to 1; all 0 where the degrees of freedom of the bodies (the ranks of the first six
            rows and columns of ``M``), or the others, are fewer than 12. After 20 iterations as they are.
        """
        of_bodies = self.M[:, BODY, BODY]  # errors of joints move the bodies in no other direction
        bodies = int(np.sum(np.linalg.matrix_rank(of_bodies, hermitian=True)))
        if min(bodies, self.count - bodies) < _FEWEST_FREEDOM:
            return np.zeros(len(PARTS))
        for _ in range(_STEPS):
            before = rho
            rho = _shares_of(self._components(rho))
            if np.max(np.abs(rho - before)) < _SETTLED * unshared(rho):
                break
        return rho

    def _components(self, rho: Array) -> Array:
        """Estimate the variances theta of independent errors, translations, rotations and joints, the last three >= 0.

        Solves the four linear equations for theta once; a variance that comes out negative is 0, and the others are
        solved for again.

        Args:
            rho: shape (3,), the shares of translations, rotations and joints in the variance of a scalar, at which
                the equations are set up.

        Returns:
            theta, shape (4,), in the square of the residual's unit; that of a part is 0 too where it moves no scalar.
        """
        inverse = _InverseCovariance.of(self.M, rho)
        left = self._left_side(inverse)
        right = self._right_side(inverse)
        free = np.diagonal(left) > 0.0  # no translation moves angles
        while True:
            theta = np.zeros(1 + len(PARTS))
            theta[free] = np.linalg.solve(left[np.ix_(free, free)], right[free])
            if not np.any(theta[1:] < 0.0):
                return theta
            free[1 + int(np.argmin(theta[1:]))] = False

    def _left_side(self, inverse: _InverseCovariance) -> Array:
        """The matrix of the equations for theta: variances of independent errors, translations, rotations, joints.

        The scalars of a stop have the covariance V = theta_0 I + theta_1 J_t J_t^T + theta_2 J_r J_r^T + theta_3 J_q
        J_q^T, where J = [J_t, J_r, J_q] are their derivatives by d directions: translation and rotation of the body
        that all its targets are on, and the errors of the joints. Uses ``M``, shape (S, d, d), J^T J of each of S
        stops, and the ``count`` of scalars of all.

        Args:
            inverse: K^-1 of each stop, where K is V over the noise squared, at the shares as they are so far, as
                ``kappa``, and ``T`` and ``H``, shape (S, d, d): K^-1 = (I - J H J^T) / kappa and K^-1 J = J T.

        Returns:
            tr(K^-1 K_i K^-1 K_j), shape (4, 4), summed over the stops, where K_i is the derivative of the covariance V
            by theta_i.
        """
        HM = inverse.H @ self.M
        MT = self.M @ inverse.T
        TMT = transposed(inverse.T) @ self.M @ inverse.T
        result = np.zeros((1 + len(PARTS), 1 + len(PARTS)))
        of_independent = self.count - 2.0 * _trace(HM) + _trace(HM @ HM)
        result[0, 0] = of_independent / inverse.kappa**2
        for k, i in enumerate(PARTS, 1):
            of_part = _trace(TMT[:, i, i])
            result[0, k] = of_part
            result[k, 0] = of_part
            result[k, 1:] = [np.sum(MT[:, i, j] ** 2) for j in PARTS]
        return result

    def _right_side(self, inverse: _InverseCovariance) -> Array:
        """The right side of the equations for theta: variances of independent errors, translations, rotations, joints.

        The scalars of a stop have the covariance V = theta_0 I + theta_1 J_t J_t^T + theta_2 J_r J_r^T + theta_3 J_q
        J_q^T, where J = [J_t, J_r, J_q] are their derivatives by d directions: translation and rotation of the body
        that all its targets are on, and the errors of the joints. Uses the moments of the fit's residual r, whose
        prediction has the covariance A C A^T: ``M`` and ``R``, shape (S, d, d), of each of S stops, and ``total``, over
        all stops,

            M = J^T J,    R = J^T [r r^T + A C A^T] J,    total = tr(r r^T + A C A^T)

        Args:
            inverse: K^-1 of each stop, where K is V over the noise squared, at the shares as they are so far, as
                ``kappa``, and ``T`` and ``H``, shape (S, d, d): K^-1 = (I - J H J^T) / kappa and K^-1 J = J T.

        Returns:
            tr(K^-1 K_i K^-1 [r r^T + A C A^T]), shape (4,), summed over the stops, in the square of the residual's
            unit, where K_i is the derivative of the covariance V by theta_i.
        """
        HM = inverse.H @ self.M
        HR = inverse.H @ self.R
        TRT = transposed(inverse.T) @ self.R @ inverse.T
        result = np.zeros(1 + len(PARTS))
        of_independent = self.total - 2.0 * _trace(HR) + _trace(HM @ HR)
        result[0] = of_independent / inverse.kappa**2
        for k, part in enumerate(PARTS, 1):
            result[k] = _trace(TRT[:, part, part])
        return result


def _shares_of(theta: Array) -> Array:
    """Return the shares of translations, rotations and joints in a scalar's variance, from the variances of its parts.

    Args:
        theta: shape (4,), variances of independent errors, of translations and rotations of the body that carries the
            targets of a stop, and of the errors of the joints; the last three >= 0.

    Returns:
        rho, shape (3,), theta of translations, rotations and joints over the sum of all four; scaled down where their
        sum would be above 1 - 1e-6 (`_LEAST_UNSHARED`).
    """
    shares = theta[1:] / max(float(np.sum(theta)), TINY)
    excess = float(np.sum(shares)) / (1.0 - _LEAST_UNSHARED)
    return np.asarray(shares / max(excess, 1.0))


def unshared(rho: Array) -> float:
    """Return the share kappa of a scalar's variance that is independent of the other targets of its stop.

    A stop is a standstill of the robot at which several targets of one body are measured.

    Args:
        rho: shape (3,), the shares of its variance that translation and rotation of the stop's body, and the errors of
            the joints have.

    Returns:
        kappa = 1 - rho_t - rho_r - rho_q, but never below 1e-6 (`_LEAST_UNSHARED`).
    """
    return float(max(1.0 - np.sum(rho), _LEAST_UNSHARED))


def root_shares(rho: Array, directions: int) -> Array:
    """Return the square root of the share of each direction of a body's displacement in the variance of a scalar.

    Args:
        rho: shape (3,), the shares of translations, rotations and joints, >= 0; each direction of a part has the same.
        directions: Number d of directions, six and that of the joints.

    Returns:
        shape (d,): of the three translations, the three rotations, the joints.
    """
    shares = np.zeros(directions)
    for part, share in zip(PARTS, rho, strict=True):
        shares[part] = share
    return np.sqrt(shares)


def transposed(M: NDArray[np.floating]) -> Array:
    """Return the transpose of each matrix of a stack.

    Args:
        M: shape (..., m, n).

    Returns:
        shape (..., n, m).
    """
    return np.asarray(M.swapaxes(-1, -2))


def _trace(M: Array) -> float:
    """Return the sum of the traces of a stack of matrices, shape (S, n, n)."""
    return float(np.einsum("sii->", M))
