"""Least-squares solvers, which see callables and start values, never a robot.

Each minimises E(x) = 1/2 r(x)^T r(x), keeps a history of its steps, and raises `SolverError` where the start is not
finite.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgeqrf, dtrtrs

from calib.errors import SolverError
from calib.units import Array

#: Message of a solver that converged.
_CONVERGED = "Relative change of cost and parameters below tolerance."

#: Message of a solver that did not.
_LIMIT = "The limit of {} iterations was reached before the steps became negligible."

#: Gain ratio from which on the damping falls ten times.
_GOOD_GAIN = 0.9

#: The least damping.
_LOWEST_DAMPING = 1e-15

#: With more damping no step is long enough to change x.
_HIGHEST_DAMPING = 1e12

#: x, shape (p,) -> residual r, shape (m,), and its Jacobian dr/dx, shape (m, p).
System = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Iteration:
    """One trial step."""

    #: E before the step
    cost: float
    #: Its damping; 0 for SciPy, which has a trust region instead
    mu: float
    #: Actual over predicted decrease of E; None where the solver does not state it
    gain: float | None
    #: Length of the step, in the solver's units
    step: float
    #: Whether x moved
    accepted: bool


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of a solver."""

    #: Shape (p,)
    x: Array
    #: E(x)
    cost: float
    #: ``"converged"`` or ``"stopped"`` (at the limit of iterations)
    status: str
    #: Why, in a sentence
    message: str
    #: Number of calls of the system
    evaluations: int
    #: One entry a trial step
    history: tuple[Iteration, ...]

    @property
    def iterations(self) -> int:
        """Number of trial steps."""
        return len(self.history)


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """The system at one x, reduced to a triangle: |r + J dx|^2 = |R dx - rhs|^2 + constant."""

    #: (p,)
    x: Array
    #: E(x)
    cost: float
    #: (p, p), upper triangle
    R: Array
    #: (p,)
    rhs: Array
    #: (p,), norm of each column of J; 1 where a column is zero
    norms: Array

    @classmethod
    def of(cls, x: Array, r: Array, J: Array) -> _Reduced:
        """Reduce a system to its triangle, which carries all that r and J say: each damping costs p^3, not m p^2.

        Args:
            x: shape (p,).
            r: shape (m,), residual at x.
            J: shape (m, p), its Jacobian dr/dx.
        """
        R, rhs = _triangle(J, r)
        return cls(x, 0.5 * float(r @ r), R, rhs, _column_norms(J))

    def predicted_fall(self, dx: Array) -> float:
        """By how much the linear model of r lowers E after a step dx, (p,)."""
        after = float(np.sum((self.rhs - self.R @ dx) ** 2))
        return 0.5 * (float(self.rhs @ self.rhs) - after)


@dataclass(frozen=True, slots=True)
class _Damping:
    """Damping by the gain ratio, actual over predicted decrease of E (H. B. Nielsen, 1999)."""

    mu: float = 1e-8
    #: Factor at the next step that fails
    raise_by: float = 2.0

    def after_success(self, gain: float) -> _Damping:
        """Lower the damping by up to ten times: the closer the gain is to 1, the more."""
        factor = 0.1
        if gain < _GOOD_GAIN:
            factor = max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
        return _Damping(max(self.mu * factor, _LOWEST_DAMPING))

    def after_failure(self) -> _Damping:
        """Raise the damping, by twice the factor each time."""
        return _Damping(self.mu * self.raise_by, self.raise_by * 2.0)


def levenberg_marquardt(
    system: System,
    x0: Array,
    step_size: Array,
    step_tolerance: float = 1e-9,
    *,
    tolerance: float = 1e-12,
    iterations: int = 100,
) -> Solution:
    """Minimise E(x) by Levenberg-Marquardt with a damped step solved by QR.

    The step minimises |r + J dx|^2 + mu |D dx|^2, where D are the largest column norms of J so far (J. Moré, 1978) and
    mu follows the gain ratio (H. B. Nielsen, 1999).

    Args:
        system: Maps x, shape (p,), to the residual r, (m,), and its Jacobian dr/dx, (m, p).
        x0: shape (p,), start.
        step_size: shape (p,), change of each parameter that is one unit of a step's length.
        step_tolerance: A shorter step, in these units, has converged.
        tolerance: So has a step that promises to lower E by less than this share of it.
        iterations: The most trial steps.

    Raises:
        SolverError: The system is not finite at the start.
    """
    x = np.array(x0, dtype=np.float64)
    at = _Reduced.of(x, *_checked_start(system, x))
    largest_norms = at.norms
    damping = _Damping()
    history: list[Iteration] = []
    status, message = "converged", _CONVERGED
    while True:
        dx = _damped_step(at.R, at.rhs, np.sqrt(damping.mu) * largest_norms)
        predicted = at.predicted_fall(dx)
        length = float(np.linalg.norm(dx / step_size))
        if predicted <= tolerance * at.cost or length <= step_tolerance:
            break
        r, J = system(at.x + dx)
        cost = 0.5 * float(r @ r)
        gain = (at.cost - cost) / predicted if np.isfinite(cost) else -np.inf
        history.append(Iteration(at.cost, damping.mu, gain, length, gain > 0))
        if gain > 0:
            at = _Reduced.of(at.x + dx, r, J)
            largest_norms = np.maximum(largest_norms, at.norms)
            damping = damping.after_success(gain)
        else:
            damping = damping.after_failure()
            if damping.mu > _HIGHEST_DAMPING:
                message = "No step, however short, lowers the cost any further."
                break
        if len(history) == iterations:
            status, message = "stopped", _LIMIT.format(iterations)
            break
    return Solution(at.x, at.cost, status, message, len(history) + 1, tuple(history))


def paper_levenberg_marquardt(
    system: System,
    x0: Array,
    *,
    mu: float = 0.01,
    nu: float = 2.5,
    epsilon: float = 1e-6,
    iterations: int = 500,
) -> Solution:
    """Minimise E(X) by the paper's Levenberg-Marquardt, section 3.3, at *absolute* parameters X in mm and rad.

    dX = -(J^T J + mu I)^-1 J^T e;  stop when |dX| <= epsilon (|X| + epsilon);
    gain = 2 (E_(k+1) - E_k) / (dX^T (J^T e - mu dX));  mu / nu where gain > 0, mu nu otherwise.

    Read in two places so that it works: step 6 goes to the end when the test holds (the branches are printed the other
    way round), and a step with gain <= 0 is not taken.

    Args:
        system: Maps X, shape (p,), to the error e, (m,), and its Jacobian de/dX, (m, p).
        x0: shape (p,), start.
        mu: Damping of the first step.
        nu: Factor by which the damping changes.
        epsilon: Relative length of a step that has converged.
        iterations: The most trial steps.

    Raises:
        SolverError: The system is not finite at the start.
    """
    x = np.array(x0, dtype=np.float64)
    e, J = _checked_start(system, x)
    cost = 0.5 * float(e @ e)
    history: list[Iteration] = []
    while len(history) < iterations:
        dx = _damped_step(*_triangle(J, e), np.full(len(x), np.sqrt(mu)))
        length = float(np.linalg.norm(dx))
        e_trial, J_trial = system(x + dx)
        cost_trial = 0.5 * float(e_trial @ e_trial)
        if length <= epsilon * (float(np.linalg.norm(x)) + epsilon):
            message = "The step is shorter than epsilon (|X| + epsilon)."
            calls = len(history) + 2
            return Solution(x + dx, cost_trial, "converged", message, calls, tuple(history))
        gain = 2.0 * (cost_trial - cost) / float(dx @ (J.T @ e - mu * dx))
        history.append(Iteration(cost, mu, gain, length, gain > 0))
        if gain > 0:
            x, e, J, cost = x + dx, e_trial, J_trial, cost_trial
            mu = mu / nu
        else:
            mu = mu * nu
    message = _LIMIT.format(iterations)
    return Solution(x, cost, "stopped", message, len(history) + 1, tuple(history))


def scipy_least_squares(
    system: System,
    x0: Array,
    step_size: Array,
    step_tolerance: float = 1e-9,  # noqa: ARG001  it goes to the end each time
) -> Solution:
    """Minimise E(x) by SciPy's ``least_squares`` (trust-region reflective, exact SVD steps).

    Args:
        system: Maps x, shape (p,), to the residual r, (m,), and its Jacobian dr/dx, (m, p).
        x0: shape (p,), start.
        step_size: shape (p,), change of each parameter that is one unit of a step's length.
        step_tolerance: Not used.

    Raises:
        SolverError: The system is not finite at the start.
    """
    from scipy.optimize import least_squares

    r, _ = _checked_start(system, x0)
    best_cost = 0.5 * float(r @ r)
    best_x = np.array(x0, dtype=np.float64)
    history: list[Iteration] = []

    def residual(x: Array) -> Array:
        """The residual, with an entry in the history for each x that is new."""
        nonlocal best_cost, best_x
        r, _ = system(x)
        if not np.array_equal(x, best_x):
            cost = 0.5 * float(r @ r)
            step = float(np.linalg.norm((x - best_x) / step_size))
            history.append(Iteration(best_cost, 0.0, None, step, cost < best_cost))
            if cost < best_cost:
                best_cost, best_x = cost, x.copy()
        return r

    result = least_squares(
        residual,
        x0,
        jac=lambda x: system(x)[1],
        x_scale=step_size,
        ftol=1e-14,
        xtol=1e-12,
        gtol=1e-12,
        max_nfev=100,
    )
    return Solution(
        x=result.x,
        cost=float(result.cost),
        status="converged" if result.status > 0 else "stopped",
        message=result.message,
        evaluations=int(result.nfev),
        history=tuple(history),
    )


#: Maps a system, a start, a step of one unit for each parameter, and the length of a step that has converged (in these
#: units) to a solution.
Solver = Callable[[System, Array, Array, float], Solution]

#: The least-squares solvers by the name that `calib.calibrate` and ``--solver`` take; yours is one more.
SOLVERS: dict[str, Solver] = {"lm": levenberg_marquardt, "scipy": scipy_least_squares}


def _checked_start(system: System, x: Array) -> tuple[Array, Array]:
    """The system at the start; `SolverError` where it is not finite."""
    r, J = system(x)
    if not (np.all(np.isfinite(r)) and np.all(np.isfinite(J))):
        raise SolverError("The residual is not finite at the start: a number is far out.")
    return r, J


def _column_norms(J: Array) -> Array:
    """Norm of each column of J, (m, p), shape (p,); 1 where a column is zero, so that it can be divided by."""
    norms: Array = np.sqrt(np.einsum("ij,ij->j", J, J))
    return np.where(norms > 0.0, norms, 1.0)


def _triangle(J: Array, r: Array) -> tuple[Array, Array]:
    """R, (p, p), and rhs, (p,), of the triangle of [J, -r]: |J dx + r|^2 = |R dx - rhs|^2 + constant."""
    p = J.shape[1]
    # By columns, as LAPACK wants it; rows of zeros change nothing.
    both = np.zeros((max(len(r), p), p + 1), order="F")
    both[: len(r), :p] = J
    both[: len(r), p] = -r
    R = triangle(both)
    return R[:p, :p], R[:p, p]


def triangle(A: Array) -> Array:
    """Return the upper triangle R of A = Q R.

    Args:
        A: shape (m, n); overwritten if it is laid out by columns.

    Returns:
        shape (min(m, n), n).
    """
    if not A.size:  # LAPACK refuses it
        return np.zeros((min(A.shape), A.shape[1]))
    return np.triu(dgeqrf(A, overwrite_a=1)[0][: min(A.shape)])


def _damped_step(R: Array, rhs: Array, damping: Array) -> Array:
    """The dx, (p,), that minimises |R dx - rhs|^2 + |diag(damping) dx|^2, by QR; R (p, p), rhs and damping (p,)."""
    p = len(rhs)
    stacked = np.zeros((2 * p, p + 1), order="F")
    stacked[:p, :p] = R
    stacked[:p, p] = rhs
    stacked[p + np.arange(p), np.arange(p)] = damping
    reduced = triangle(stacked)
    return np.asarray(dtrtrs(reduced[:p, :p], reduced[:p, p])[0])
