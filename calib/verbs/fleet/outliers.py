"""Fleet outliers: robots whose figures differ from those of the other robots of their kind.

A figure x of robot i is compared with those of all robots of its kind by

    z_i = (x_i - median) / scale_i,   scale_i = max(1.4826 MAD, floor, std_i)

with the median absolute deviation MAD, which outliers hardly change, a floor below which differences do not matter, and
the figure's own standard deviation if it has one. Errors and noise are compared by their logarithms. A robot is flagged
if |z| exceeds a limit that, for normally distributed figures, only one of twenty fleets without outliers exceeds
anywhere among its n robots and k figures:

    limit = quantile of Student's t with 0.41 n degrees of freedom at 1 - 0.05 / (2 n k)

The degrees of freedom make up for the MAD's own scatter; 0.41 is just below what simulations of 5 to 500 robots gave.
Half of the 0.05 is spent on the errors and the noise, the other half on the parameters. Robots with the same data are
all compared, but count once in n, median and MAD.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from calib.basics.arrays import Array, Mask
from calib.basics.channels import RESIDUAL_UNITS
from calib.verbs.fleet.fleet_row import DONE, FleetParameter, FleetRow
from calib.verbs.fleet.text import data_text, few_text, figure_text

#: Robots of a kind that it takes to compare them.
FEWEST = 5

#: Probability that a fleet without outliers has a flagged robot.
CHANCE = 0.05

#: Degrees of freedom of a scale from a MAD, for each robot; see the module's text.
_FREEDOM = 0.41

#: Factor from the MAD of a normal distribution to its standard deviation.
_STD_OF_MAD = 1.4826

#: Errors and noise that differ by less are alike (natural logarithm).
_LOG_FLOOR = 0.05

#: Changes of a parameter that differ by less are alike, by unit; joint gains and compliances have their std only.
_FLOORS = {"m": 20e-6, "rad": 20e-6, "1": 20e-6}

#: Errors and noise that are compared in each unit: attribute of `FleetRow`, and name of the figure.
_ERRORS = (
    ("nominal_rms", "nominal error"),
    ("held_out_rms", "cross-validated error"),
    ("sigma", "noise"),
)


@dataclass(frozen=True, slots=True)
class FleetOutlier:
    """One figure in which a robot differs from the others, or data that it shares with another."""

    #: The robot's name
    name: str
    #: Name of the figure or parameter; or ``"data"``, with NaN for all numbers
    figure: str
    #: Unit of ``value`` and ``usual``; ``""`` for data
    unit: str = ""
    #: The robot's figure
    value: float = math.nan
    #: Median of the robots of its kind
    usual: float = math.nan
    #: Deviation from the median, see the module's text
    z: float = math.nan
    #: |z| beyond which a figure is flagged
    limit: float = math.nan
    #: The outlier in words
    text: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Figure:
    """One figure of the n robots of a kind."""

    #: Name of the figure or parameter
    name: str
    #: Its unit
    unit: str
    #: Compared values, shape (n,), logarithms if ``logarithmic``; NaN: the robot has none
    values: Array
    #: Their standard deviations, shape (n,); 0 or NaN: none
    stds: Array
    #: Differences of values below which robots are alike
    floor: float
    #: Whether ``values`` are natural logarithms of the figure
    logarithmic: bool

    def shown(self, value: float) -> float:
        """Return the figure in its unit, from a compared value, which may be its logarithm."""
        return float(np.exp(value)) if self.logarithmic else float(value)


def fleet_outliers(
    rows: Sequence[FleetRow],
) -> tuple[tuple[FleetOutlier, ...], tuple[str, ...]]:
    """Compare the robots of a fleet, each with those of its kind.

    Args:
        rows: The robots; failed ones are not compared.

    Returns:
        The outliers, in the order of the robots, of each robot the same data first, then the largest |z|; and notes on
        kinds that have too few robots to compare them.
    """
    done = [row for row in rows if row.status == DONE]
    # Robots whose measurements are those of another, of whatever kind.
    outliers = []
    with_data: dict[str, list[FleetRow]] = {}
    for row in done:
        with_data.setdefault(row.measured, []).append(row)
    for same in with_data.values():
        for row in same:
            others = [other.name for other in same if other is not row]
            if others:
                outliers.append(FleetOutlier(row.name, "data", text=data_text(others, row.data)))

    notes = []
    kinds = list(dict.fromkeys(row.kind for row in done))
    for kind in kinds:
        alike = [row for row in done if row.kind == kind]
        # Of robots with the same data the first one counts in median and MAD.
        _, first = np.unique([row.measured for row in alike], return_index=True)
        counted = np.zeros(len(alike), dtype=np.bool_)
        counted[first] = True
        count = len(first)
        if count >= FEWEST:
            outliers += _unusual_figures(alike, counted)
        else:
            robot_name = kind.split()[0] if len(kinds) > 1 else ""
            notes.append(few_text(len(alike), count, FEWEST, robot_name))

    place = {row.name: i for i, row in enumerate(rows)}

    def key(outlier: FleetOutlier) -> tuple[int, float]:
        """Return the robot's place, and minus |z|."""
        height = math.inf if math.isnan(outlier.z) else abs(outlier.z)
        return place[outlier.name], -height

    return tuple(sorted(outliers, key=key)), tuple(notes)


def limit(robots: int, figures: int, chance: float = CHANCE) -> float:
    """Return the |z| beyond which a figure is flagged; see the module's text.

    Args:
        robots: Number n of robots that are compared.
        figures: Number k of figures of each robot.
        chance: Probability that any of the n k figures is flagged in a fleet without outliers.

    Returns:
        The limit.

    Example:
        >>> [round(limit(n, 30), 1) for n in (5, 20, 200)]
        [50.5, 7.2, 4.8]
    """
    probability = 1.0 - chance / (2.0 * robots * figures)
    return float(stdtrit(_FREEDOM * robots, probability))


def scores(values: Array, stds: Array, floor: float, counted: Mask) -> Array:
    """Return the deviation z of each robot's value from the median, in units of its scale; see the module's text.

    Args:
        values: Figures of n robots, shape (n,); NaN: the robot has none.
        stds: Their standard deviations, in the same unit, shape (n,); 0 or NaN: none.
        floor: Smallest scale, in the same unit.
        counted: Robots that count in median and MAD, shape (n,).

    Returns:
        z, shape (n,), positive above the median; NaN for robots without a value.
    """
    deviations = values - np.nanmedian(values[counted])
    mad = np.nanmedian(np.abs(deviations[counted]))
    spread = np.fmax(_STD_OF_MAD * mad, floor)
    scale = np.fmax(spread, stds)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(deviations == 0.0, 0.0, deviations / scale)


def _unusual_figures(rows: Sequence[FleetRow], counted: Mask) -> Iterator[FleetOutlier]:
    """Yield the outliers among the robots of one kind, of the errors and noise first, then of the parameters.

    Robots that are not ``counted``, a mask (n,), are compared, but count neither in median and MAD nor in the limit.
    """
    for figures in (_error_figures(rows), _parameter_figures(rows)):
        # A figure is compared if enough robots have it.
        shared = [f for f in figures if np.isfinite(f.values[counted]).sum() >= FEWEST]
        for figure in shared:
            bound = limit(int(counted.sum()), len(shared), 0.5 * CHANCE)
            z = scores(figure.values, figure.stds, figure.floor, counted)
            usual = figure.shown(np.nanmedian(figure.values[counted]))
            for i in np.flatnonzero(np.abs(z) > bound).tolist():
                value, score = figure.shown(figure.values[i]), float(z[i])
                text = figure_text(figure.name, figure.unit, value, usual, score, bound)
                yield FleetOutlier(
                    name=rows[i].name,
                    figure=figure.name,
                    unit=figure.unit,
                    value=value,
                    usual=usual,
                    z=score,
                    limit=bound,
                    text=text,
                )


def _error_figures(rows: Sequence[FleetRow]) -> list[_Figure]:
    """Return figures of errors and noise of n robots, by their logarithms, one for each kind of error and unit.

    A robot without an error in a unit, or with 0, has NaN.
    """
    no_std = np.zeros(len(rows))
    figures = []
    for symbol, unit in RESIDUAL_UNITS.items():
        for attribute, name in _ERRORS:
            errors = np.array([getattr(row, attribute).get(symbol, math.nan) for row in rows])
            logarithms = np.log(np.where(errors > 0.0, errors, math.nan))
            name_of_unit = name if symbol == "m" else f"{name} of {unit.measured}s"
            figure = _Figure(name_of_unit, symbol, logarithms, no_std, _LOG_FLOOR, logarithmic=True)
            figures.append(figure)
    return figures


def _parameter_figures(rows: Sequence[FleetRow]) -> list[_Figure]:
    """Return figures of the changes of parameters of n robots, one for each that any robot's measurements determine.

    Robots whose measurements do not determine it have NaN.
    """
    determined = []
    for row in rows:
        by_name = {p.name: p for p in row.parameters if not math.isnan(p.std)}
        determined.append(by_name)
    units: dict[str, str] = {}
    for parameters in determined:
        for name, parameter in parameters.items():
            units[name] = parameter.unit
    absent = FleetParameter("", "", math.nan, math.nan)
    figures = []
    for name, unit in units.items():
        column = [parameters.get(name, absent) for parameters in determined]
        changes = np.array([parameter.change for parameter in column])
        stds = np.array([parameter.std for parameter in column])
        floor = _FLOORS.get(unit, 0.0)
        figures.append(_Figure(name, unit, changes, stds, floor, logarithmic=False))
    return figures
