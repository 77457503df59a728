"""What a calibration found, one by one: parameters with their intervals, rows that do not belong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.identify.fitting import Fitted
from calib.identify.statistics import interval_factor
from calib.measure.cell import Cell
from calib.model.error_model import TARGET
from calib.model.observability import Observability


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter of the result, in its unit (m or rad).

    Attributes:
        name: Its name.
        unit: ``"m"`` or ``"rad"``.
        nominal: The value before; None for a target that was not given.
        value: The value after.
        delta: The change; for a target that was not given, from where registration put it.
        std: Standard deviation of the value.
        low: Lower end of the 95 % interval of the value.
        high: Upper end.
        identifiable: Whether the measurements determine it; otherwise they know it in combinations only.
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


@dataclass(frozen=True, slots=True)
class Outlier:
    """A row that does not belong to the others.

    Attributes:
        row: The row's number as a person sees it.
        residual: Norm of measured minus predicted [m].
        score: How far it lies from what the other rows predict, in standard deviations.
    """

    row: int
    residual: float
    score: float


def parameter_estimates(
    fitted: Fitted, cell: Cell, observability: Observability
) -> tuple[ParameterEstimate, ...]:
    """Nominal value, value and interval of each parameter.

    Args:
        fitted: The fit.
        cell: The set-up as given.
        observability: Of the rows that were fitted.
    """
    x, deviations = fitted.estimate.x, np.sqrt(np.diag(fitted.estimate.covariance))
    reach = interval_factor(fitted.estimate.freedom)
    start = fitted.kinematics.T_tip_target[:3, 3]
    result = []
    for k, parameter in enumerate(fitted.kinematics.model.parameters):
        nominal: float | None = parameter.nominal
        value = parameter.nominal + x[k]
        delta = x[k]
        if parameter.place == TARGET:
            axis = "xyz".index(parameter.name[-1])
            value = start[axis] + x[k]
            nominal = None if cell.target is None else float(cell.target[axis])
            delta = x[k] if nominal is None else value - nominal
        result.append(
            ParameterEstimate(
                name=parameter.name,
                unit=parameter.unit,
                nominal=nominal,
                value=float(value),
                delta=float(delta),
                std=float(deviations[k]),
                low=float(value - reach * deviations[k]),
                high=float(value + reach * deviations[k]),
                identifiable=bool(observability.identifiable[k]),
            )
        )
    return tuple(result)
