"""What a calibration found, one by one: parameters with their intervals, rows that do not belong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.identify.fitting import Fitted
from calib.identify.statistics import interval_factor
from calib.model.observability import Observability
from calib.model.parameters import TARGET

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter of the result, in its unit.

    Attributes:
        name: Its name.
        unit: ``"m"``, ``"rad"``, ``"1"``, ``"m/m"``, ``"rad/Nm"`` or ``"m/N"``.
        nominal: The value before; None for a target that was not given.
        value: The value after.
        delta: The change; for a target that was not given, from where registration put it.
        std: Standard deviation of the value.
        low: Lower end of the 95 % interval of the value.
        high: Upper end.
        identifiable: Whether the measurements determine it; otherwise they know it in combinations only.
        at_bound: Whether it was stopped by a bound; std and interval are then not to be told, NaN.
        prior_std: Standard deviation of the prior on its change that the fit ended with; NaN where there was none.
        push: How hard the data push it against its prior [1/unit]: minus the derivative of half their squares. At the
            least of all squares that is the prior's pull, (x - mean) / std^2. Where a prior is next to nothing wide, x
            is too, and only this still tells what the data say.
    """

    name: str
    unit: str
    nominal: float | None
    value: float
    delta: float
    std: float
    low: float
    high: float
    identifiable: bool
    at_bound: bool = False
    prior_std: float = np.nan
    push: float = np.nan


@dataclass(frozen=True, slots=True)
class Outlier:
    """A row that does not belong to the others.

    Attributes:
        row: The row's number as a person sees it.
        residual: Norm of measured minus predicted length [m]; NaN where none was measured.
        score: How far it lies from what the other rows predict, in standard deviations.
    """

    row: int
    residual: float
    score: float


def parameter_estimates(
    fitted: Fitted, observability: Observability
) -> tuple[ParameterEstimate, ...]:
    """Nominal value, value and interval of each parameter.

    Args:
        fitted: The fit.
        observability: Of the rows that were fitted.
    """
    estimate, given = fitted.estimate, fitted.task.setup
    x, deviations = estimate.x, np.sqrt(np.diag(estimate.covariance))
    reach = interval_factor(estimate.freedom)
    places = fitted.kinematics.model.places
    first_target = len(places) - len(given.targets)
    precision, push = estimate.problem.precision, _pushes(fitted)
    result = []
    for k, parameter in enumerate(fitted.kinematics.model.parameters):
        nominal: float | None = parameter.nominal
        value = parameter.nominal + x[k]
        delta = x[k]
        if parameter.family == TARGET and parameter.unit == "m":
            t = places.index(parameter.place) - first_target
            start = fitted.kinematics.T_tip_target[t, :3, :3]
            axis = int(np.argmax(np.abs(start @ parameter.direction[:3])))  # of the tip
            value = fitted.kinematics.T_tip_target[t, axis, 3] + _shift(fitted, t)[axis]
            known = bool(given.target_given[t])
            nominal = float(given.T_tip_target[t, axis, 3]) if known else None
            delta = x[k] if nominal is None else value - nominal
        bounded = k in estimate.at_bound
        half = np.nan if bounded else float(reach * deviations[k])
        result.append(
            ParameterEstimate(
                name=parameter.name,
                unit=parameter.unit,
                nominal=nominal,
                value=float(value),
                delta=float(delta),
                std=np.nan if bounded else float(deviations[k]),
                low=float(value - half),
                high=float(value + half),
                identifiable=bool(observability.identifiable[k]),
                at_bound=bounded,
                prior_std=float(1.0 / np.sqrt(precision[k])) if precision[k] > 0.0 else np.nan,
                push=float(push[k]),
            )
        )
    return tuple(result)


def _shift(fitted: Fitted, t: int) -> Array:
    """How far a target moved in the tip, shape (3,), [m]."""
    found = fitted.placed().T_tip_target[t, :3, 3]
    return np.asarray(found - fitted.kinematics.T_tip_target[t, :3, 3])


def _pushes(fitted: Fitted) -> Array:
    """How hard the data push each parameter against its prior, shape (p,); see `ParameterEstimate`."""
    estimate = fitted.estimate
    problem, x = estimate.problem, estimate.x
    if fitted.task.solver == "paper":  # not at the least of squares, and without priors
        return np.asarray(problem.precision * (x - problem.centre))
    between, slope = problem.constraints(x)
    linear, given = problem.linear(x), problem.rows.scales
    data = linear.residual(x) * np.where(problem.rows.used, given / problem.scales, 0.0) ** 2
    push = np.einsum("nd,ndp->p", problem.weights[:, None] * data, linear.A)
    return np.asarray(push + between @ slope)
