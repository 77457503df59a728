"""Problem: robot, error model and measurements as one weighted least-squares problem.

    minimise  1/2 sum_i w_i |m_i - f_i(x)|^2 / sigma_i^2  +  1/2 sum_k x_k^2 / tau_k^2

with the measured points m_i, the predicted ones f_i, and normal priors of size tau_k on the offsets. The residual
is measured minus predicted, whitened by sigma.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.model.kinematics import Kinematics

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A calibration as numbers.

    Attributes:
        kinematics: The nominal robot under its error model.
        joints: shape (N, n), joint values in the robot's order, [rad] or [m].
        points: shape (N, 3), measured target points in the measurement frame [m].
        sigma: shape (N,), standard deviation of one coordinate of each row [m].
        weights: shape (N,), robust weights between 0 and 1.
        precision: shape (p,), 1 / tau_k^2; 0 for a parameter without prior.
    """

    kinematics: Kinematics
    joints: Array
    points: Array
    sigma: Array
    weights: Array
    precision: Array
    _last: _LastPrediction = field(default_factory=lambda: _LastPrediction(), repr=False)

    @property
    def size(self) -> int:
        """The number of parameters p."""
        return len(self.kinematics.model)

    def reweighted(self, weights: Array, sigma: Array, precision: Array) -> Problem:
        """The same problem with other weights, noise and priors."""
        return replace(self, weights=weights, sigma=sigma, precision=precision)

    def residual(self, x: Array) -> Array:
        """Measured minus predicted, shape (N, 3), [m]."""
        result: Array = self.points - self.kinematics.points(x, self.joints)
        return result

    def residual_and_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Measured minus predicted, shape (N, 3), and the derivative of the *prediction*, shape (N, 3, p)."""
        predicted, jacobian = self._last.at(x, self.kinematics, self.joints)
        return self.points - predicted, jacobian

    def system(self, x: Array) -> tuple[Array, Array]:
        """The whitened residual and its own derivative, with a row for each prior.

        Returns:
            shape (3 N + priors,) and shape (3 N + priors, p); see the module's equation.
        """
        residual, jacobian = self.residual_and_jacobian(x)
        whiten = np.sqrt(self.weights) / self.sigma
        held = np.flatnonzero(self.precision)
        root = np.sqrt(self.precision[held])
        r = np.concatenate([(residual * whiten[:, None]).ravel(), -root * x[held]])
        J = np.zeros((len(r), self.size))
        J[: residual.size] = (jacobian * -whiten[:, None, None]).reshape(residual.size, -1)
        J[residual.size + np.arange(len(held)), held] = -root
        return r, J

    def paper_system(self, nominal: Array, unit: Array, X: Array) -> tuple[Array, Array]:
        """The paper's error e_i = |dP_i|^2 [mm^2] and its derivative, at its absolute parameters X.

        Args:
            nominal: shape (p,), the nominal values [m, rad].
            unit: shape (p,), 1e3 for a length and 1 for an angle: the paper's mm and rad.
            X: shape (p,), [mm] and [rad].

        Returns:
            shape (N,), [mm^2], and shape (N, p).
        """
        residual, jacobian = self.residual_and_jacobian(X / unit - nominal)
        residual_mm = 1e3 * residual
        jacobian_mm = 1e3 * jacobian / unit
        e = np.einsum("ij,ij->i", residual_mm, residual_mm)
        return e, -2.0 * np.einsum("ij,ijk->ik", residual_mm, jacobian_mm)


class _LastPrediction:
    """The last prediction, because solvers and the stages between them often ask twice at the same x.

    Weights, noise and priors do not enter it, so that a problem and its reweighted copies share one.
    """

    __slots__ = ("value", "x")

    def __init__(self) -> None:
        """Nothing is known yet."""
        self.x: Array | None = None
        self.value: tuple[Array, Array] | None = None

    def at(self, x: Array, kinematics: Kinematics, joints: Array) -> tuple[Array, Array]:
        """The target's positions and their derivative at x."""
        if self.value is None or self.x is None or not np.array_equal(x, self.x):
            self.x, self.value = x.copy(), kinematics.points_jacobian(x, joints)
        return self.value
