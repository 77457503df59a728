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

#: x, shape (p,) -> residual r, shape (m,), and its Jacobian dr/dx, shape (m, p).
System = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Iteration:
    """One trial step."""

    cost: float  # E before the step
    mu: float  # Its damping; 0 for SciPy, which has a trust region instead
    gain: float | None  # Actual over predicted decrease of E; None where the solver does not tell
    step: float  # Length of the step, in the solver's units
    accepted: bool  # Whether x moved


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where a solver stopped."""

    x: Array  # shape (p,)
    cost: float  # E(x)
    status: str  # ``"converged"`` or ``"stopped"`` (at the limit of iterations)
    message: str  # Why, in a sentence
    evaluations: int  # Number of calls of the system
    history: tuple[Iteration, ...]  # One entry a trial step

    @property
    def iterations(self) -> int:
        """Number of trial steps."""
        return len(self.history)


def levenberg_marquardt(
    system: System,
    x0: Array,
    step_size: Array,
    step_tolerance: float = 1e-9,
    *,
    tolerance: float = 1e-12,
    iterations: int = 100,
) -> Solution:
    """Levenberg-Marquardt with a damped step solved by QR.

    The step minimises |r + J dx|^2 + mu |D dx|^2; D are the largest column norms seen (J. Moré, 1978), mu follows the
    gain ratio (H. B. Nielsen, 1999). It stops where a step promises to lower E by less than the share ``tolerance``, or
    is shorter than ``step_tolerance`` in units of ``step_size``, shape (p,).
    """
    x = np.array(x0, dtype=np.float64)
    r, J = _checked_start(system, x)
    cost, evaluations = 0.5 * float(r @ r), 1
    scale, (R, rhs) = _column_norms(J), _triangle(J, r)
    mu, raise_by = 1e-8, 2.0
    history: list[Iteration] = []
    status, message = "converged", "Relative change of cost and parameters below tolerance."
    while True:
        # A square of R's size carries all that J and r say, so that each mu costs p^3 and not m p^2.
        dx = _damped_step(R, rhs, np.sqrt(mu) * scale)
        predicted = 0.5 * (float(rhs @ rhs) - float(np.sum((rhs - R @ dx) ** 2)))
        length = float(np.linalg.norm(dx / step_size))
        if predicted <= tolerance * cost or length <= step_tolerance:
            break
        r_trial, J_trial = system(x + dx)
        evaluations += 1
        cost_trial = 0.5 * float(r_trial @ r_trial)
        gain = (cost - cost_trial) / predicted if np.isfinite(cost_trial) else -np.inf
        history.append(Iteration(cost, mu, gain, length, gain > 0))
        if gain > 0:
            x, cost = x + dx, cost_trial
            scale = np.maximum(scale, _column_norms(J_trial))
            R, rhs = _triangle(J_trial, r_trial)
            mu *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3) if gain < 0.9 else 0.1
            mu, raise_by = max(mu, 1e-15), 2.0
        else:
            mu, raise_by = mu * raise_by, raise_by * 2.0
            if mu > 1e12:
                message = "No step, however short, lowers the cost any further."
                break
        if len(history) == iterations:
            status, message = "stopped", _LIMIT.format(iterations)
            break
    return Solution(x, cost, status, message, evaluations, tuple(history))


def paper_levenberg_marquardt(
    system: System,
    x0: Array,
    *,
    mu: float = 0.01,
    nu: float = 2.5,
    epsilon: float = 1e-6,
    iterations: int = 500,
) -> Solution:
    """The paper's Levenberg-Marquardt, section 3.3, at *absolute* parameters X in mm and rad.

    dX = -(J^T J + mu I)^-1 J^T e;  stop when |dX| <= epsilon (|X| + epsilon);
    gain = 2 (E_(k+1) - E_k) / (dX^T (J^T e - mu dX));  mu / nu where gain > 0, mu nu otherwise.

    Read in two places so that it works: step 6 goes to the end when the test holds (the branches are printed the other
    way round), and a step with gain <= 0 is not taken.
    """
    x = np.array(x0, dtype=np.float64)
    e, J = _checked_start(system, x)
    cost, evaluations = 0.5 * float(e @ e), 1
    history: list[Iteration] = []
    while len(history) < iterations:
        dx = _damped_step(*_triangle(J, e), np.full(len(x), np.sqrt(mu)))
        length = float(np.linalg.norm(dx))
        e_trial, J_trial = system(x + dx)
        evaluations += 1
        cost_trial = 0.5 * float(e_trial @ e_trial)
        if length <= epsilon * (float(np.linalg.norm(x)) + epsilon):
            message = "The step is shorter than epsilon (|X| + epsilon)."
            return Solution(x + dx, cost_trial, "converged", message, evaluations, tuple(history))
        gain = 2.0 * (cost_trial - cost) / float(dx @ (J.T @ e - mu * dx))
        history.append(Iteration(cost, mu, gain, length, gain > 0))
        if gain > 0:
            x, e, J, cost = x + dx, e_trial, J_trial, cost_trial
        mu = mu / nu if gain > 0 else mu * nu
    message = _LIMIT.format(iterations)
    return Solution(x, cost, "stopped", message, evaluations, tuple(history))


def scipy_least_squares(
    system: System,
    x0: Array,
    step_size: Array,
    step_tolerance: float = 1e-9,  # noqa: ARG001  it goes to the end each time
) -> Solution:
    """SciPy's ``least_squares`` (trust-region reflective, exact SVD steps)."""
    from scipy.optimize import least_squares

    r, _ = _checked_start(system, x0)
    best, at = 0.5 * float(r @ r), np.array(x0, dtype=np.float64)
    history: list[Iteration] = []

    def residual(x: Array) -> Array:
        """The residual, with an entry in the history for each x that is new."""
        nonlocal best, at
        value, _ = system(x)
        if not np.array_equal(x, at):
            cost = 0.5 * float(value @ value)
            step = float(np.linalg.norm((x - at) / step_size))
            history.append(Iteration(best, 0.0, None, step, cost < best))
            if cost < best:
                best, at = cost, x.copy()
        return value

    stop = {"ftol": 1e-14, "xtol": 1e-12, "gtol": 1e-12, "max_nfev": 100}
    found = least_squares(residual, x0, jac=lambda x: system(x)[1], x_scale=step_size, **stop)
    status, cost = "converged" if found.status > 0 else "stopped", float(found.cost)
    return Solution(found.x, cost, status, found.message, int(found.nfev), tuple(history))


_LIMIT = "The limit of {} iterations was reached before the steps became negligible."

#: Called with a system, a start, a step of each parameter that matters, and the share of these that a last step may be.
Solver = Callable[[System, Array, Array, float], Solution]

#: The least-squares solvers by the name that `calib.calibrate` and ``--solver`` take; yours is one more.
SOLVERS: dict[str, Solver] = {"lm": levenberg_marquardt, "scipy": scipy_least_squares}


def _checked_start(system: System, x: Array) -> tuple[Array, Array]:
    """The system at the start, refused where it is not finite."""
    r, J = system(x)
    if not (np.all(np.isfinite(r)) and np.all(np.isfinite(J))):
        raise SolverError("The residual is not finite at the start: a number is far out.")
    return r, J


def _column_norms(J: Array) -> Array:
    """The norm of each column; 1 where a column is zero, so that it can be divided by."""
    norms: Array = np.sqrt(np.einsum("ij,ij->j", J, J))
    return np.where(norms > 0.0, norms, 1.0)


def _triangle(J: Array, r: Array) -> tuple[Array, Array]:
    """R, (p, p), and rhs, (p,), of the triangle of [J, -r]: |J dx + r|^2 = |R dx - rhs|^2 + constant."""
    p = J.shape[1]
    # As LAPACK wants it; rows of zeros change nothing.
    both = np.zeros((max(len(r), p), p + 1), order="F")
    both[: len(r), :p], both[: len(r), p] = J, -r
    R = triangle(both)
    return R[:p, :p], R[:p, p]


def triangle(A: Array) -> Array:
    """The triangle R of A = Q R, of as many rows as A has rows or columns; A is overwritten if laid out by columns."""
    if not A.size:  # LAPACK refuses it
        return np.zeros((min(A.shape), A.shape[1]))
    return np.triu(dgeqrf(A, overwrite_a=1)[0][: min(A.shape)])


def _damped_step(R: Array, rhs: Array, damping: Array) -> Array:
    """The dx that minimises |R dx - rhs|^2 + |diag(damping) dx|^2, by QR, shape (p,)."""
    p = len(rhs)
    stacked = np.zeros((2 * p, p + 1), order="F")
    stacked[:p, :p], stacked[:p, p] = R, rhs
    stacked[p + np.arange(p), np.arange(p)] = damping
    found = triangle(stacked)
    return np.asarray(dtrtrs(found[:p, :p], found[:p, p])[0])
