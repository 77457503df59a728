"""Least-squares solvers, which see callables and start values, never a robot.

Each minimises E(x) = 1/2 r(x)^T r(x), keeps a history of its steps, and raises `SolverError` if the residual is not
finite at the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgeqrf, dpotrf, dtrtrs

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

#: Message of a solver that ran to where there is nothing left to solve.
_LOST = "The residual no longer depends on parameter {}, which the steps have carried far away."

#: Damping of the first step.
_FIRST_DAMPING = 1e-8

#: After a gain ratio of at least this the damping falls to a tenth.
_GOOD_GAIN = 0.9

#: The least damping. It counts relative to the largest column norms so far, beside which those at the solution may be
#: nothing: a parameter that an exponential multiplies can fall by fifty powers of ten.
_LOWEST_DAMPING = 1e-200

#: With more damping no step is long enough to change x.
_HIGHEST_DAMPING = 1e12

#: Where a step promises to lower the cost by a smaller share, rounding decides whether the cost falls.
_ROUNDING = 1e-13

#: Damping grows by this factor until a step is no longer than the longest.
_SHORTEN = 4.0

#: The residual hardly depends on a parameter any more whose column has fallen to this share of its largest norm.
_FLAT = 1e-8

#: Columns that LAPACK's QR takes at a time: it needs room for as many. By default it has room for three.
_QR_BLOCK = 32

#: A matrix of unit diagonal has a Cholesky factor that rounding hardly changes if no entry on its diagonal is smaller.
_SINGULAR = 1e-6

#: x, shape (p,) -> residual r, shape (m,), and its Jacobian dr/dx, shape (m, p).
System = Callable[[Array], tuple[Array, Array]]


#: After a step of a higher gain the next one is made longer. A gain near 1 is that of a linear problem, where a longer
#: step gains nothing; and plain steps of the gain g leave g - 1 of the way each, here a fifth.
_SHORT = 1.2

#: It is made longer by at most this factor: beyond it 2 - gain is below 0.05, where rounding and what the parabola
#: lacks are as large. From a gain of 2 on, the parabola has no minimum.
_LONGEST = 20.0


@dataclass(frozen=True, slots=True)
class Iteration:
    """One trial step."""

    #: E before the step
    cost: float
    #: Its damping; 0 for SciPy, which has a trust region instead
    mu: float
    #: Actual over predicted decrease of E; None if the solver does not state it, or if both are rounding
    gain: float | None
    #: Length of the step, in the solver's units
    step: float
    #: True if x moved
    accepted: bool


@dataclass(frozen=True, slots=True, eq=False)
class Solution(Value):
    """Result of a solver."""

    #: Shape (p,)
    x: Array
    #: E(x)
    cost: float
    #: ``"converged"`` or ``"stopped"`` (at the limit of iterations, or where a parameter has lost its effect)
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


def levenberg_marquardt(
    system: System,
    x0: Array,
    step_size: Array,
    step_tolerance: float = 1e-9,
    *,
    tolerance: float = 1e-12,
    longest_step: float = np.inf,
    iterations: int = 100,
) -> Solution:
    """Minimise E(x) = 1/2 r(x)^T r(x) by Levenberg-Marquardt with a damped step solved by QR.

    The step minimises |r + J dx|^2 + mu |D dx|^2, where D are the largest column norms of J so far (J. Moré, 1978) and
    mu follows the gain ratio (H. B. Nielsen, 1999).

    Where residuals stay large, as of images or of a wrong set-up, E curves less than r + J dx says: all steps are too
    short by the same factor. The parabola through E, its slope and its value after a step of the gain g has its minimum
    at 1 / (2 - g) times the step. So a step with g well above 1 is followed by one that is longer by this factor.

    E tells x to some eight digits only, because it is flat at its minimum: then steps are taken as long as the next one
    promises less than the last, which tells x almost to rounding. A `tolerance` of 1e-12 ends before that.

    Args:
        system: Maps x, shape (p,), to the residual r, (m,), and its Jacobian dr/dx, (m, p).
        x0: shape (p,), start.
        step_size: shape (p,), change of each parameter that is one unit of a step's length.
        step_tolerance: A shorter step, in these units, has converged.
        tolerance: So has a step that promises to lower E by less than this share of it.
        longest_step: The damping is raised until a step is no longer than this, in the units of `step_size`. A model
            that is far from linear may otherwise throw the first steps to where its residual is flat.
        iterations: The most trial steps.

    Returns:
        The last x that was accepted, and all trial steps. The status is ``"stopped"`` if it took the most steps, or if
        a parameter lost its effect on the residual before it was determined.

    Raises:
        SolverError: The system is not finite at the start.
    """
    x, r, J = _start(system, x0)
    cost = _cost(r)
    scale = _column_norms(J)
    # |r + J dx|^2 = |R dx - rhs|^2 + constant: each damping then costs p^3, not m p^2.
    R, rhs = _triangle(J, r)
    mu = _FIRST_DAMPING
    raise_by = 2.0  # factor of the damping at the next step that fails
    stretch = 1.0
    history: list[Iteration] = []
    status = "converged"
    while True:
        dx, length = _step(R, rhs, mu, scale, step_size)
        while length > longest_step:
            mu = mu * _SHORTEN
            dx, length = _step(R, rhs, mu, scale, step_size)
        predicted = _predicted(R, rhs, dx)
        if predicted <= tolerance * cost or length <= step_tolerance:
            message = _CONVERGED
            break
        if predicted <= _ROUNDING * cost:
            trial_x = x + dx
            trial_r, trial_J = system(trial_x)
            trial_R, trial_rhs = _triangle(trial_J, trial_r)
            next_dx, _ = _step(trial_R, trial_rhs, mu, scale, step_size)
            nearer = _predicted(trial_R, trial_rhs, next_dx) < predicted
            history.append(Iteration(cost, mu, None, length, nearer))
            if not nearer:
                message = _NO_STEP_HELPS
                break
            x, cost, R, rhs = trial_x, _cost(trial_r), trial_R, trial_rhs
        else:
            trial_x = x + stretch * dx
            trial_r, trial_J = system(trial_x)
            trial_cost = _cost(trial_r)
            gain = (cost - trial_cost) / predicted if np.isfinite(trial_cost) else -np.inf
            history.append(Iteration(cost, mu, gain, stretch * length, gain > 0))
            if gain > 0:
                x, cost = trial_x, trial_cost
                R, rhs = _triangle(trial_J, trial_r)
                scale = np.maximum(scale, _column_norms(trial_J))
            if stretch > 1.0:  # a plain step follows, whose gain tells how far the next may go
                stretch = 1.0
            elif gain > 0:
                # The closer the gain is to 1, the more the damping falls.
                factor = 0.1
                if gain < _GOOD_GAIN:
                    factor = max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
                mu = max(mu * factor, _LOWEST_DAMPING)
                raise_by = 2.0
                if gain > _SHORT:
                    stretch = 1.0 / max(2.0 - gain, 1.0 / _LONGEST)
            else:
                mu = mu * raise_by
                raise_by = raise_by * 2.0
                if mu > _HIGHEST_DAMPING:
                    message = _NO_STEP_HELPS
                    break
        if len(history) == iterations:
            status = "stopped"
            message = _LIMIT.format(iterations)
            break
    lost = _lost(R, rhs, scale, step_size, step_tolerance)
    if status == "converged" and len(lost):
        status = "stopped"
        message = _LOST.format(int(lost[0]) + 1)
    return Solution(x, cost, status, message, len(history) + 1, tuple(history))


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
    """Minimise E(X) = 1/2 e^T e by the paper's Levenberg-Marquardt, section 3.3, at *absolute* X in mm and rad.

    dX = -(J^T J + mu I)^-1 J^T e;  stop when |dX| <= epsilon (|X| + epsilon);
    gain = 2 (E_(k+1) - E_k) / (dX^T (J^T e - mu dX));  mu / nu if gain > 0, mu nu otherwise.

    Two places are read so that they work: step 6 goes to the end when the test holds (the branches are printed the
    other way round), and a step with gain <= 0 is not taken.

    Args:
        system: Maps X, shape (p,), to the error e, (m,), and its Jacobian de/dX, (m, p).
        x0: shape (p,), start.
        step_size: Not used.
        step_tolerance: Not used.
        mu: Damping of the first step.
        nu: Factor by which the damping changes.
        epsilon: Relative length of a step that has converged.
        iterations: The most trial steps.

    Returns:
        X after the step that converged; or the last one accepted, with status ``"stopped"``; and all trial steps.

    Raises:
        SolverError: The system is not finite at the start.
    """
    x, r, J = _start(system, x0)
    cost = _cost(r)
    history: list[Iteration] = []
    while len(history) < iterations:
        dx = _damped_step(*_triangle(J, r), np.full(len(x), np.sqrt(mu)))
        length = float(np.linalg.norm(dx))
        trial_x = x + dx
        trial_r, trial_J = system(trial_x)
        trial_cost = _cost(trial_r)
        if length <= epsilon * (float(np.linalg.norm(x)) + epsilon):
            return Solution(
                x=trial_x,
                cost=trial_cost,
                status="converged",
                message="The step is shorter than epsilon (|X| + epsilon).",
                evaluations=len(history) + 2,
                history=tuple(history),
            )
        predicted = float(dx @ (J.T @ r - mu * dx))
        gain = 2.0 * (trial_cost - cost) / predicted
        history.append(Iteration(cost, mu, gain, length, gain > 0))
        if gain > 0:
            x, r, J, cost = trial_x, trial_r, trial_J, trial_cost
            mu = mu / nu
        else:
            mu = mu * nu
    message = _LIMIT.format(iterations)
    return Solution(x, cost, "stopped", message, len(history) + 1, tuple(history))


def scipy_least_squares(
    system: System,
    x0: Array,
    step_size: Array,
    step_tolerance: float = 1e-9,  # noqa: ARG001  SciPy has tolerances of its own
) -> Solution:
    """Minimise E(x) = 1/2 r(x)^T r(x) by SciPy's ``least_squares`` (trust-region reflective, exact SVD steps).

    Args:
        system: Maps x, shape (p,), to the residual r, (m,), and its Jacobian dr/dx, (m, p).
        x0: shape (p,), start.
        step_size: shape (p,), change of each parameter that is one unit of a step's length.
        step_tolerance: Not used.

    Returns:
        SciPy's x and message, with status ``"stopped"`` if it took the most evaluations, and every x that it tried.

    Raises:
        SolverError: The system is not finite at the start.
    """
    from scipy.optimize import least_squares

    best_x, start_r, _ = _start(system, x0)
    best_cost = _cost(start_r)
    history: list[Iteration] = []

    def residual(x: Array) -> Array:
        """Return the residual at x (p,), and add each new x to the history."""
        nonlocal best_cost, best_x
        r, _ = system(x)
        if not np.array_equal(x, best_x):
            cost = _cost(r)
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


#: Maps a system, a start, the change of each parameter that is one unit of a step's length, and the length of a step
#: that has converged to a solution.
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
        solver: The function: of a system, a start, the change of each parameter that is one unit of a step's length,
            and the length of a step that has converged; see `levenberg_marquardt`.

    Raises:
        SolverError: The name is taken.
    """
    if name in SOLVERS:
        raise SolverError(f"The solver '{name}' needs a name other than {choices(SOLVERS, 60)}.")
    SOLVERS[name] = solver


def has_weights_and_priors(solver: str | Solver) -> bool:
    """Return True if fits by a solver, a name or the function itself, weigh rows and have priors of parameters."""
    return callable(solver) or solver not in _WITHOUT_WEIGHTS_AND_PRIORS


def check_name(name: str) -> None:
    """Refuse a name that is not that of a registered solver.

    Raises:
        ModelError: There is none.
    """
    if name not in SOLVERS:
        raise ModelError(plugins.unknown("solvers", name, SOLVERS))


def _start(system: System, x0: Array) -> tuple[Array, Array, Array]:
    """Return a copy of the start x0, (p,), with residual and Jacobian there; SolverError if these are not finite."""
    x = np.array(x0, dtype=np.float64)
    r, J = system(x)
    if not (np.all(np.isfinite(r)) and np.all(np.isfinite(J))):
        raise SolverError("The residual is not finite at the start: a number is far out.")
    return x, r, J


def _cost(r: Array) -> float:
    """Return the cost E = 1/2 r^T r of a residual r (m,); of a trial that went far out it may be infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return 0.5 * float(r @ r)


def _column_norms(J: Array) -> Array:
    """Return the norm of each column of J, (m, p), shape (p,); 1 for a column of zeros, to be divided by."""
    norms: Array = np.sqrt(np.einsum("ij,ij->j", J, J))
    return np.where(norms > 0.0, norms, 1.0)


def _triangle(J: Array, r: Array) -> tuple[Array, Array]:
    """Return R (p, p) and rhs (p,) with |J dx + r|^2 = |R dx - rhs|^2 + constant, of J (m, p) and r (m,), by QR."""
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
    factored, *_ = dgeqrf(A, lwork=_QR_BLOCK * A.shape[1], overwrite_a=1)
    return np.triu(factored[:height])


def upper_root(products: Array) -> Array | None:
    """Return the upper triangle R of P = R^T R, by Cholesky.

    Args:
        products: P, shape (n, n), symmetric and positive semidefinite.

    Returns:
        shape (n, n); None if P is so nearly singular that its rounding counts.
    """
    scale = np.sqrt(products.diagonal())
    if not np.all(scale > 0.0):
        return None
    root, failed = dpotrf(products / np.outer(scale, scale), clean=1)
    if failed or root.diagonal().min() < _SINGULAR:
        return None
    return np.asarray(root * scale)


def _step(R: Array, rhs: Array, mu: float, scale: Array, step_size: Array) -> tuple[Array, float]:
    """Return the step dx (p,) with the damping mu, and its length in units of step_size, (p,)."""
    dx = _damped_step(R, rhs, np.sqrt(mu) * scale)
    return dx, float(np.linalg.norm(dx / step_size))


def _predicted(R: Array, rhs: Array, dx: Array) -> float:
    """Return by how much a step dx (p,) lowers E, as |R dx - rhs|^2 says."""
    cost_of_model = float(np.sum((rhs - R @ dx) ** 2))
    return 0.5 * (float(rhs @ rhs) - cost_of_model)


def _lost(R: Array, rhs: Array, scale: Array, step_size: Array, step_tolerance: float) -> Array:
    """Return the indices of columns that are next to nothing beside their largest norm, and call for a long step."""
    norms = np.sqrt(np.einsum("ij,ij->j", R, R))
    lost = []
    for k in np.flatnonzero(norms < _FLAT * scale):
        # The minimum along x_k alone.
        with np.errstate(divide="ignore", invalid="ignore"):
            step = (R[:, k] @ rhs) / norms[k] ** 2 / step_size[k]
        if not abs(step) <= step_tolerance:
            lost.append(k)
    return np.array(lost, dtype=np.intp)


def _damped_step(R: Array, rhs: Array, damping: Array) -> Array:
    """Return the dx (p,) that minimises |R dx - rhs|^2 + |diag(damping) dx|^2, R (p, p), the others (p,), by QR."""
    p = len(rhs)
    stacked = np.zeros((2 * p, p + 1), order="F")
    stacked[:p, :p] = R
    stacked[:p, p] = rhs
    column = np.arange(p)
    stacked[p + column, column] = damping
    reduced = triangle(stacked)
    dx, _ = dtrtrs(reduced[:p, :p], reduced[:p, p])
    return np.asarray(dx)
