"""The shares of a scalar's variance that the targets of a stop have in common, estimated from a fit's residuals.

See `calib.fit.estimate.special_cases.stops` for stops and their covariance V = noise^2 K, with K = kappa I + G G^T and
the shares rho_t of translations, rho_r of rotations and rho_q of the joints.

The shares are estimated from the residual r of generalised least squares, E[r r^T] = V - A C A^T, by equations that
end where the restricted likelihood is highest (T. W. Anderson, 1973; S. R. Searle, G. Casella, C. E. McCulloch,
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

#: Columns of a body's displacement whose directions have the same variance.
BODY_PARTS = (TRANSLATION, ROTATION)

#: Columns of the displacement by the errors of the joints.
JOINTS = slice(6, None)

#: Columns whose directions have the same variance.
PARTS = (TRANSLATION, ROTATION, JOINTS)

#: The least kappa: no channel's own noise is less than a thousandth of what the targets of a stop share.
_LEAST_UNSHARED = 1e-6

#: With fewer degrees of freedom, of the bodies or of the targets within them, the shares are zero.
_FEWEST_FREEDOM = 12

#: The most iterations for the shares.
_STEPS = 20

#: Shares that change by less than this, relative to kappa, have settled.
_SETTLED = 1e-4

#: Shares are extrapolated by at most so many times what a round changed them by: where each change is 0.91 of the last,
#: that is all that is left. Of slower rounds two changes do not tell the limit; several extrapolations get there.
_FARTHEST = 10.0

#: Rounds that overshoot go back by at most this part of a change: the limit is there if each undoes the last one, and
#: nearer to the latest round if they converge.
_BACK = 0.5

#: An extrapolation leaves at least this part of the share that the targets do not have in common: without it their
#: covariance is singular. A choice: a smaller part takes fewer rounds to shares near 1, and overshoots more easily.
_LEFT = 0.5

#: Divisor in place of zero.
TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class _InverseCovariance:
    """K^-1 of S stops by matrices of d rows: K^-1 = (I - J H J^T) / kappa, and K^-1 J = J T.

    J is the Jacobian of a stop's scalars by its body's displacement in d directions. With M = J^T J and D, the
    covariance of the displacement by all shares (`covariances`), G G^T is J D J^T.
    """

    #: The share of a scalar's variance that is independent of the other targets of its stop
    kappa: float
    #: (S, d, d), (kappa I + D M)^-1
    T: Array
    #: (S, d, d), T D
    H: Array

    @classmethod
    def of(cls, M: Array, rho: Array, by_joints: Array) -> _InverseCovariance:
        """Invert K at the shares rho, (3,).

        Of each stop M is J^T J and ``by_joints`` the covariance of the displacement by joints, (S, d, d) each.
        """
        kappa = unshared(rho)
        D = covariances(rho, by_joints)
        T: Array = np.asarray(np.linalg.inv(kappa * np.eye(M.shape[1]) + D @ M))
        return cls(kappa, T, T @ D)


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """The moments of one channel's residual r at S stops, from which its shares are estimated, in any unit.

    J is the Jacobian of a stop's scalars by its body's displacement in d directions, translation (3), rotation (3) and
    any others, A that by the parameters of the fit, and C the covariance of these.
    """

    #: (S, d, d), J^T J of each stop
    M: Array
    #: (S, d, d), J^T [r r^T + A C A^T] J of each stop
    R: Array
    #: (S, d, d), covariance of the displacement of each stop by errors of the joints of unit variance
    by_joints: Array
    #: The trace of r r^T + A C A^T, of all stops
    total: float
    #: The number of scalars of all stops
    count: float

    @classmethod
    def joined(cls, parts: Sequence[Moments]) -> Moments:
        """Join the moments of a fit's residual over several parts of the stops, in their order."""
        total = 0.0
        count = 0.0
        for part in parts:
            total += part.total
            count += part.count
        M = np.concatenate([part.M for part in parts])
        R = np.concatenate([part.R for part in parts])
        by_joints = np.concatenate([part.by_joints for part in parts])
        return cls(M, R, by_joints, total, count)

    def shares(self, rho: Array) -> Array:
        """Estimate the shares of translations, rotations and joints in a scalar's variance, by iteration.

        Args:
            rho: shape (3,), the shares to begin with.

        Returns:
            shape (3,), each from 0 to 1; all 0 if the degrees of freedom of the bodies, or the others, are too few.
        """
        of_bodies = self.M[:, BODY, BODY]  # errors of joints move the bodies in no other direction
        bodies = int(np.sum(np.linalg.matrix_rank(of_bodies, hermitian=True)))
        if min(bodies, self.count - bodies) < _FEWEST_FREEDOM:
            return np.zeros(len(PARTS))
        last = None
        for _ in range(_STEPS):
            found = _shares_of(self._components(rho))
            if np.max(np.abs(found - rho)) < _SETTLED * unshared(found):
                return found
            latest = (rho[None, None], found[None, None])
            rho = found if last is None else extrapolated(last, latest)[0, 0]
            last = latest
        return rho

    def _components(self, rho: Array) -> Array:
        """Solve the equations for theta, (4,), once, at the shares rho, (3,): the last three are >= 0.

        A variance that comes out negative is 0, and the others are solved for again; that of a part is 0 too if it
        moves no scalar.
        """
        inverse = _InverseCovariance.of(self.M, rho, self.by_joints)
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
        """The matrix tr(K^-1 K_i K^-1 K_j), (4, 4), of the equations for theta, summed over the stops.

        K_0 is the identity, and K_i = J_i J_i^T of translations, rotations and joints.
        """
        HM = inverse.H @ self.M
        MT = self.M @ inverse.T
        TMT = transposed(inverse.T) @ self.M @ inverse.T
        result = np.zeros((1 + len(PARTS), 1 + len(PARTS)))
        of_independent = self.count - 2.0 * _trace(HM) + _trace(HM @ HM)
        result[0, 0] = of_independent / inverse.kappa**2
        MTE = MT @ self.by_joints
        METM = MTE @ MT  # M T is symmetric
        result[0, 1:] = self._of_parts(TMT)
        result[1:, 0] = result[0, 1:]
        for k, i in enumerate(BODY_PARTS, 1):
            result[k, 1:-1] = [np.sum(MT[:, i, j] ** 2) for j in BODY_PARTS]
            result[k, -1] = _trace(METM[:, i, i])
            result[-1, k] = result[k, -1]
        result[-1, -1] = np.sum(MTE * transposed(MTE))
        return result

    def _right_side(self, inverse: _InverseCovariance) -> Array:
        """The right side tr(K^-1 K_i K^-1 [r r^T + A C A^T]), (4,), of these equations, summed over the stops."""
        HM = inverse.H @ self.M
        HR = inverse.H @ self.R
        TRT = transposed(inverse.T) @ self.R @ inverse.T
        result = np.zeros(1 + len(PARTS))
        of_independent = self.total - 2.0 * _trace(HR) + _trace(HM @ HR)
        result[0] = of_independent / inverse.kappa**2
        result[1:] = self._of_parts(TRT)
        return result

    def _of_parts(self, X: Array) -> Array:
        """The traces tr(X E_i), (3,), of X (S, d, d) with E of translations, rotations and joints, over the stops."""
        of_body = [_trace(X[:, part, part]) for part in BODY_PARTS]
        return np.array([*of_body, np.sum(X * self.by_joints)])


def _shares_of(theta: Array) -> Array:
    """Return rho, (3,), the shares of the last three of the variances theta, (4,), which leave some to the first."""
    shares = theta[1:] / max(float(np.sum(theta)), TINY)
    excess = float(np.sum(shares)) / (1.0 - _LEAST_UNSHARED)
    return np.asarray(shares / max(excess, 1.0))


def extrapolated(last: tuple[Array, Array], latest: tuple[Array, Array]) -> Array:
    """Extrapolate the shares of B fits from two rounds of an estimation that turns shares x into F(x).

    Rounds near their limit like a geometric series. With the change f = F(x) - x of either (D. G. Anderson, 1965),

        x_next = F - theta (F - F_last),        theta = f^T (f - f_last) / |f - f_last|^2

    Args:
        last: What the last round began with and what it came to, shape (B, C, 3) each.
        latest: The same of the latest round.

    Returns:
        shape (B, C, 3), >= 0; as the latest round has them where this would leave too little to the targets alone.
    """
    change = latest[1] - latest[0]
    difference = change - (last[1] - last[0])
    square = np.sum(difference**2, axis=(1, 2))
    theta = np.sum(change * difference, axis=(1, 2)) / np.maximum(square, TINY)
    step = np.clip(theta, -_FARTHEST, _BACK)[:, None, None] * (latest[1] - last[1])
    ahead = np.maximum(latest[1] - step, 0.0)
    left = 1.0 - np.sum(ahead, axis=2, keepdims=True)
    least = _LEFT * (1.0 - np.sum(latest[1], axis=2, keepdims=True))
    return np.where(left > least, ahead, latest[1])


def unshared(rho: Array) -> float:
    """Return the share kappa = 1 - rho_t - rho_r - rho_q, but never below `_LEAST_UNSHARED`; ``rho`` has shape (3,)."""
    return float(max(1.0 - np.sum(rho), _LEAST_UNSHARED))


def covariances(rho: Array, by_joints: Array) -> Array:
    """Return the covariances D of the displacements of S bodies by what their targets share, (S, d, d).

    The shares rho, (3,), are those of translations, rotations and joints; ``by_joints``, (S, d, d), is the covariance
    by errors of the joints of unit variance.
    """
    D: Array = rho[2] * by_joints
    for part, share in zip(BODY_PARTS, rho, strict=False):
        numbers = np.arange(part.start, part.stop)
        D[:, numbers, numbers] += share
    return D


def transposed(M: NDArray[np.floating]) -> Array:
    """Return the transposes, (..., n, m), of a stack of matrices, (..., m, n)."""
    return np.asarray(M.swapaxes(-1, -2))


def _trace(M: Array) -> float:
    """Return the sum of the traces of a stack of matrices, shape (S, n, n)."""
    return float(np.einsum("sii->", M))
