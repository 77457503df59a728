"""Problem: robot, error model and measurements as one weighted least-squares problem.

    minimise  1/2 sum_i w_i |r_i(x) / sigma_i|^2 + 1/2 sum_k (x_k - m_k)^2 / tau_k^2
              + 1/2 sum_c (d_c - d_c(x))^2 / s_c^2

with the residuals r_i, measured minus predicted, of `calib.identify.rows`, normal priors of size tau_k on the offsets
(their mean m_k is 0, but for a parameter that is held at a bound), and known distances d_c between what two set-ups
hold the target in.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.passes import Passes
from calib.identify.rows import Rows
from calib.model.batch import MANY
from calib.model.kinematics import Kinematics

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class KnownDistance:
    """A known distance between the origins of two frames, such as two sockets on one bar.

    Attributes:
        first: Number of a frame.
        second: Number of the other.
        length: Their distance [m].
        sigma: Its standard deviation [m].
    """

    first: int
    second: int
    length: float
    sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A calibration as numbers.

    Attributes:
        kinematics: The nominal robot under its error model.
        rows: The measurements.
        scales: shape (N, D), standard deviation of each scalar, [m] and [rad].
        weights: shape (N,), of the rows, between 0 and 1.
        precision: shape (p,), 1 / tau_k^2; 0 for a parameter without prior.
        centre: shape (p,), the priors' means.
        distances: Known distances between frames.
        passes: What goes through the rows where they are many; None where they are few.
    """

    kinematics: Kinematics
    rows: Rows
    scales: Array
    weights: Array
    precision: Array
    centre: Array
    distances: tuple[KnownDistance, ...] = ()
    passes: Passes | None = None
    _last: _LastPrediction = field(default_factory=lambda: _LastPrediction(), repr=False)

    @classmethod
    def first(
        cls, kinematics: Kinematics, rows: Rows, distances: tuple[KnownDistance, ...] = ()
    ) -> Problem:
        """All rows in full, the noise as given, no priors."""
        ones, nothing = np.ones(len(rows)), np.zeros(len(kinematics.model))
        passes = Passes.of(kinematics, rows) if len(rows) >= MANY else None
        return cls(kinematics, rows, rows.scales, ones, nothing, nothing, distances, passes)

    @property
    def size(self) -> int:
        """The number of parameters p."""
        return len(self.kinematics.model)

    def reweighted(self, weights: Array, scales: Array, precision: Array, centre: Array) -> Problem:
        """The same problem with other weights, noise and priors."""
        return replace(self, weights=weights, scales=scales, precision=precision, centre=centre)

    def residual(self, x: Array) -> Array:
        """Measured minus predicted, shape (N, D), [m] and [rad]."""
        if self.passes is not None:
            return self.passes.residual(x)
        return self.rows.residual(self.kinematics.poses(x, self.rows.samples))

    def residual_and_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Measured minus predicted, shape (N, D), and the derivative of the *prediction*, shape (N, D, p)."""
        return self._last.at(x, self.kinematics, self.rows)

    def constraints(self, x: Array) -> tuple[Array, Array]:
        """Known minus predicted distances, over their sigma, shape (K,), and the derivative of the prediction, (K, p).

        A point held at the origin of frame f stands at c_f = -R^T t in the base, with T_frame_base = (R, t).
        """
        if not self.distances:
            return np.zeros(0), np.zeros((0, self.size))
        displacement, directions = self.kinematics.model.displacements(x)
        frames = len(self.kinematics.T_frame_base)
        T = self.kinematics.T_frame_base @ displacement[:frames]
        c = -np.einsum("fji,fj->fi", T[:, :3, :3], T[:, :3, 3])
        S = directions[: 6 * frames].reshape(frames, 6, -1)
        dc = -(S[:, :3] + np.cross(S[:, 3:], c[:, :, None], axis=1))
        r, J = np.empty(len(self.distances)), np.empty((len(self.distances), self.size))
        for k, known in enumerate(self.distances):
            between = c[known.first] - c[known.second]
            length = float(np.linalg.norm(between))
            along = between / max(length, 1e-12)
            r[k] = (known.length - length) / known.sigma
            J[k] = along @ (dc[known.first] - dc[known.second]) / known.sigma
        return r, J

    def system(self, x: Array) -> tuple[Array, Array]:
        """The whitened residual and its own derivative, with a row for each prior and each known distance.

        Many rows are told by p + 1 numbers that have the same squares and products, see `Passes.system`.

        Returns:
            shape (M + priors + distances,) and shape (M + priors + distances, p); see the module's equation.
        """
        held = np.flatnonzero(self.precision)
        root = np.sqrt(self.precision[held])
        between, slope = self.constraints(x)
        if self.passes is None:
            residual, jacobian = self.residual_and_jacobian(x)
            used = self.rows.used
            whiten = np.sqrt(self.weights)[:, None] / self.scales
            measured = (residual * whiten)[used]
            derivative = (jacobian * -whiten[:, :, None])[used]
        else:
            measured, derivative = self.passes.system(x, self.weights, self.scales, self.precision)
        first, last = len(measured), len(measured) + len(held)
        r = np.concatenate([measured, -root * (x - self.centre)[held], between])
        J = np.zeros((len(r), self.size))
        J[:first] = derivative
        J[first + np.arange(len(held)), held] = -root
        J[last:] = -slope
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

    def at(self, x: Array, kinematics: Kinematics, rows: Rows) -> tuple[Array, Array]:
        """The residual and the derivative of the prediction at x."""
        if self.value is None or self.x is None or not np.array_equal(x, self.x):
            poses, twists = kinematics.twists(x, rows.samples)
            self.x, self.value = x.copy(), (rows.residual(poses), rows.derivative(poses, twists))
        return self.value
