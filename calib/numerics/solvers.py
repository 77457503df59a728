"""Least-squares solvers, which see callables and start values, never a robot.

Each minimises E(x) = 1/2 r(x)^T r(x), keeps a history of its steps, and raises `SolverError` where the start is not
finite.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgeqrf, dtrtrs

import calib.basics.plugins as plugins
from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.errors import ModelError, SolverError, choices

#: Message of a solver that converged.
_CONVERGED = "Relative change of cost and parameters below tolerance."

#: Message of a solver that did not.
_LIMIT = "The limit of {} iterations was reached before the steps became negligible."

#: Message of a solver whose damping rose beyond its limit: it converged, by rounding.
_NO_STEP_HELPS = "No step, however short, lowers the cost any further."

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
class Solution(Value):
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
class _Evaluation:
    """The system evaluated at one x."""

    #: (p,)
    x: Array
    #: (m,), residual at x
    r: Array
    #: (m, p), its Jacobian dr/dx
    J: Array

    @classmethod
    def of(cls, system: System, x: Array) -> _Evaluation:
        """Evaluate a system.

        Args:
            system: Maps x to the residual r, shape (m,), and its Jacobian dr/dx, shape (m, p).
            x: shape (p,).
        """
        return cls(x, *system(x))

    @property
    def cost(self) -> float:
        """E(x) = 1/2 r^T r."""
        return 0.5 * float(self.r @ self.r)


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """A step of Levenberg-Marquardt that is to be tried."""

    #: (p,), change of x
    dx: Array
    #: Decrease of E by the linear model of r
    predicted: float
    #: Norm of dx in units of each parameter's step size
    length: float

    def gain(self, cost_before: float, cost_after: float) -> float:
        """Return the actual over the predicted decrease of E by the step.

        Args:
            cost_before: E before the step.
            cost_after: E after it.

        Returns:
            > 0 where E falls; minus infinity where E is not finite after the step.
        """
        if not np.isfinite(cost_after):
            return -np.inf
        return (cost_before - cost_after) / self.predicted


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
    #: (p,), the largest norm of each column of J so far, by which the damping of each parameter is scaled
    scale: Array

    @classmethod
    def of(cls, system: _Evaluation, smallest_scale: Array | float = 0.0) -> _Reduced:
        """Reduce a system to its triangle, which carries all that r and J say: each damping costs p^3, not m p^2.

        Args:
            system: Residual and Jacobian at one x.
            smallest_scale: shape (p,), largest norms of the columns of J before; 0 at the start.
        """
        R, rhs = _triangle(system.J, system.r)
        scale = np.maximum(smallest_scale, _column_norms(system.J))
        return cls(system.x, system.cost, R, rhs, scale)

    def damped_step(self, mu: float, step_size: Array) -> _Step:
        """Return the step that minimises |r + J dx|^2 + mu |D dx|^2, where D is the scale.

        Args:
            mu: Damping.
            step_size: shape (p,), change of each parameter that is one unit of a step's length.
        """
        dx = _damped_step(self.R, self.rhs, np.sqrt(mu) * self.scale)
        length = float(np.linalg.norm(dx / step_size))
        return _Step(dx, self._predicted_decrease(dx), length)

    def _predicted_decrease(self, dx: Array) -> float:
        """By how much the linear model of r lowers E after a step dx, (p,)."""
        after = float(np.sum((self.rhs - self.R @ dx) ** 2))
        return 0.5 * (float(self.rhs @ self.rhs) - after)


@dataclass(frozen=True, slots=True)
class _Damping:
    """Damping by the gain ratio, actual over predicted decrease of E (H. B. Nielsen, 1999)."""

    #: Damping of the next step
    mu: float = 1e-8
    #: Factor at the next step that fails
    raise_by: float = 2.0

    def after_success(self, gain: float) -> _Damping:
        """Lower the damping by up to ten times: the closer the gain is to 1, the more.

        Args:
            gain: Actual over predicted decrease of E, > 0.
        """
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
    at = _Reduced.of(_checked_start(system, x0))
    damping = _Damping()
    history: list[Iteration] = []
    while True:
        step = at.damped_step(damping.mu, step_size)
        if step.predicted <= tolerance * at.cost or step.length <= step_tolerance:
            return _solution(at, history, _CONVERGED)
        trial = _Evaluation.of(system, at.x + step.dx)
        gain = step.gain(at.cost, trial.cost)
        history.append(Iteration(at.cost, damping.mu, gain, step.length, gain > 0))
        if gain > 0:
            at = _Reduced.of(trial, at.scale)
            damping = damping.after_success(gain)
        else:
            damping = damping.after_failure()
            if damping.mu > _HIGHEST_DAMPING:
                return _solution(at, history, _NO_STEP_HELPS)
        if len(history) == iterations:
            message = _LIMIT.format(iterations)
            return _solution(at, history, message, status="stopped")


def _solution(
    at: _Reduced,
    history: list[Iteration],
    message: str,
    status: str = "converged",
) -> Solution:
    """The result of `levenberg_marquardt`, which calls the system at the start and once for each trial step.

    Args:
        at: The system at the solution.
        history: One entry a trial step.
        message: Why the steps ended.
        status: ``"converged"`` or ``"stopped"``.
    """
    return Solution(at.x, at.cost, status, message, len(history) + 1, tuple(history))


def paper_levenberg_marquardt(
    system: System,
    x0: Array,
    step_size: Array | None = None,  # noqa: ARG001  the length of its steps is relative to that of X
    step_tolerance: float = 0.0,  # noqa: ARG001
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
        step_size: Not used.
        step_tolerance: Not used.
        mu: Damping of the first step.
        nu: Factor by which the damping changes.
        epsilon: Relative length of a step that has converged.
        iterations: The most trial steps.

    Raises:
        SolverError: The system is not finite at the start.
    """
    at = _checked_start(system, x0)
    history: list[Iteration] = []
    while len(history) < iterations:
        damping = np.full(len(at.x), np.sqrt(mu))
        dx = _damped_step(*_triangle(at.J, at.r), damping)
        length = float(np.linalg.norm(dx))
        trial = _Evaluation.of(system, at.x + dx)
        if length <= epsilon * (float(np.linalg.norm(at.x)) + epsilon):
            return Solution(
                x=trial.x,
                cost=trial.cost,
                status="converged",
                message="The step is shorter than epsilon (|X| + epsilon).",
                evaluations=len(history) + 2,
                history=tuple(history),
            )
        predicted = float(dx @ (at.J.T @ at.r - mu * dx))
        gain = 2.0 * (trial.cost - at.cost) / predicted
        history.append(Iteration(at.cost, mu, gain, length, gain > 0))
        if gain > 0:
            at = trial
            mu = mu / nu
        else:
            mu = mu * nu
    message = _LIMIT.format(iterations)
    return Solution(at.x, at.cost, "stopped", message, len(history) + 1, tuple(history))


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

    start = _checked_start(system, x0)
    best_cost = start.cost
    best_x = start.x
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
SOLVERS: dict[str, Solver] = {
    "lm": levenberg_marquardt,
    "scipy": scipy_least_squares,
    "paper": paper_levenberg_marquardt,
}

#: Those that know neither weights nor priors: a fit has a whole estimate of its own for them, in place of
#: weighted least squares.
_WITHOUT_WEIGHTS_AND_PRIORS = frozenset({"paper"})

plugins.watch("solvers", SOLVERS)


def register(name: str, solver: Solver) -> None:
    """Add a solver, which fits can then name.

    Args:
        name: Its name, which no other solver has.
        solver: A function like those of `SOLVERS`.

    Raises:
        SolverError: The name is taken.
    """
    if name in SOLVERS:
        raise SolverError(f"The solver '{name}' needs a name other than {choices(SOLVERS, 60)}.")
    SOLVERS[name] = solver


def has_weights_and_priors(solver: str | Solver) -> bool:
    """Return whether fits by a solver, a name or the function itself, weigh rows and have priors of parameters."""
    return callable(solver) or solver not in _WITHOUT_WEIGHTS_AND_PRIORS


def check_name(name: str) -> None:
    """Check that there is a solver of this name.

    Raises:
        ModelError: There is none.
    """
    if name not in SOLVERS:
        raise ModelError(plugins.unknown("solvers", name, SOLVERS))


def _checked_start(system: System, x0: Array) -> _Evaluation:
    """Evaluate a system at the start x0, shape (p,), of which a copy is taken; `SolverError` where it is not finite."""
    start = _Evaluation.of(system, np.array(x0, dtype=np.float64))
    if not (np.all(np.isfinite(start.r)) and np.all(np.isfinite(start.J))):
        raise SolverError("The residual is not finite at the start: a number is far out.")
    return start


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
    height = min(A.shape)
    if not A.size:  # LAPACK refuses it
        return np.zeros((height, A.shape[1]))
    factored, *_ = dgeqrf(A, overwrite_a=1)
    return np.triu(factored[:height])


def _damped_step(R: Array, rhs: Array, damping: Array) -> Array:
    """The dx, shape (p,), that minimises |R dx - rhs|^2 + |diag(damping) dx|^2, by QR.

    Args:
        R: shape (p, p), upper triangle.
        rhs: shape (p,).
        damping: shape (p,), factor of each component of dx, >= 0.
    """
    p = len(rhs)
    stacked = np.zeros((2 * p, p + 1), order="F")
    stacked[:p, :p] = R
    stacked[:p, p] = rhs
    column = np.arange(p)
    stacked[p + column, column] = damping
    reduced = triangle(stacked)
    dx, _ = dtrtrs(reduced[:p, :p], reduced[:p, p])
    return np.asarray(dx)
