"""Fleet outliers: robots whose figures differ from those of the other robots of their kind.

A figure x of robot i is compared with those of the n others of its kind that are no outliers in it,

    z_i = (x_i - mean) / (scale_i sqrt(1 + 1/n)),   scale_i = max(std of the others, floor, std_i)

with a floor below which differences do not matter, and the figure's own standard deviation if it has one. Errors and
noise are compared by their logarithms. Outliers are found by B. Rosner's test (Technometrics 25, 1983): the robot with
the largest |z| among all is set aside, then that with the largest among the rest, and so on; all are outliers up to the
last one whose |z| exceeds its limit

    limit = quantile of Student's t with n - 1 degrees of freedom at 1 - chance / (2 (n + 1) k)

for k figures of each robot, so that only ``chance`` of the fleets without outliers have a flagged robot. A third of
0.05 is spent on the errors and the noise, one on the parameters, one on the joint zeros alone, which every result has,
whichever model it was fitted with. Robots with the same data are all compared, but count once.
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

#: Share of the robots that may be outliers in one figure: the others say what is usual.
_MOST = 1.0 / 3.0

#: Errors and noise, parameters, joint zeros: each gets its part of `CHANCE`.
_KINDS = 3

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
    #: Mean of the robots of its kind that are no outliers in it
    usual: float = math.nan
    #: Deviation from that mean, see the module's text
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


def limit(others: int, figures: int, chance: float = CHANCE) -> float:
    """Return the |z| beyond which a figure is flagged; see the module's text.

    Args:
        others: Number n of robots that one is compared with.
        figures: Number k of figures of each robot.
        chance: Probability that any figure is flagged in a fleet without outliers.

    Returns:
        The limit.

    Example:
        >>> [round(limit(n - 1, 30), 1) for n in (5, 20, 200)]
        [18.7, 5.0, 4.6]
    """
    probability = 1.0 - chance / (2.0 * (others + 1) * figures)
    return float(stdtrit(others - 1, probability))


def scores(values: Array, stds: Array, floor: float, usual: Mask) -> Array:
    """Return the deviation z of each robot's value from the usual ones, in units of its scale; see the module's text.

    Args:
        values: Figures of n robots, shape (n,); NaN: the robot has none.
        stds: Their standard deviations, in the same unit, shape (n,); 0 or NaN: none.
        floor: Smallest scale, in the same unit.
        usual: Robots whose values are usual, shape (n,), 3 or more of them; each is compared with the others of them.

    Returns:
        z, shape (n,), positive above the mean; NaN for robots without a value.
    """
    kept = usual & np.isfinite(values)
    inside = kept.astype(np.float64)
    others = kept.sum() - inside
    # Counted from a usual value, so that little is lost to rounding.
    shifted = values - np.median(values[kept])
    total, squares = np.sum(shifted[kept]), np.sum(shifted[kept] ** 2)
    own = np.where(kept, shifted, 0.0)
    mean = (total - own) / others
    spread = np.sqrt(np.maximum(squares - own**2 - others * mean**2, 0.0) / (others - 1.0))
    scale = np.fmax(np.fmax(spread, floor), stds) * np.sqrt(1.0 + 1.0 / others)
    deviation = shifted - mean
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(deviation == 0.0, 0.0, deviation / scale))


def usual_robots(
    values: Array, stds: Array, floor: float, counted: Mask, figures: int, chance: float
) -> Mask:
    """Return which robots are no outliers in a figure, by Rosner's test; see the module's text.

    Args:
        values: Figures of n robots, shape (n,); NaN: the robot has none.
        stds: Their standard deviations, in the same unit, shape (n,); 0 or NaN: none.
        floor: Smallest scale, in the same unit.
        counted: Robots that count, shape (n,).
        figures: Number k of figures of each robot.
        chance: Probability that any figure is flagged in a fleet without outliers.

    Returns:
        shape (n,); False for those that do not count, or have no value.
    """
    rest = np.asarray(counted & np.isfinite(values))
    usual: Mask = rest.copy()
    for _ in range(int(_MOST * rest.sum())):
        z = np.where(rest, np.abs(scores(values, stds, floor, rest)), -1.0)
        furthest = int(np.argmax(z))
        bound = limit(int(rest.sum()) - 1, figures, chance)
        rest[furthest] = False
        if z[furthest] > bound:
            usual = rest.copy()
    return usual


def _unusual_figures(rows: Sequence[FleetRow], counted: Mask) -> Iterator[FleetOutlier]:
    """Yield the outliers among the robots of one kind: of the errors and noise, of the parameters, of the joint zeros.

    Robots that are not ``counted``, a mask (n,), are compared, but do not say what is usual.
    """
    by_kind = (
        _error_figures(rows),
        _parameter_figures([row.parameters for row in rows]),
        _parameter_figures([row.zeros for row in rows]),
    )
    chance = CHANCE / _KINDS
    for figures in by_kind:
        # A figure is compared if enough robots have it.
        shared = [f for f in figures if np.isfinite(f.values[counted]).sum() >= FEWEST]
        for figure in shared:
            compared = (figure.values, figure.stds, figure.floor)
            usual = usual_robots(*compared, counted, len(shared), chance)
            bound = limit(int(usual.sum()), len(shared), chance)
            z = scores(*compared, usual)
            mean = figure.shown(float(np.mean(figure.values[usual])))
            # One that is set aside is an outlier even where, beside the others so set aside, its |z| is below.
            unusual = ~usual & np.where(counted, np.isfinite(z), np.abs(z) > bound)
            for i in np.flatnonzero(unusual).tolist():
                value, score = figure.shown(figure.values[i]), float(z[i])
                text = figure_text(figure.name, figure.unit, value, mean, score, bound)
                yield FleetOutlier(
                    name=rows[i].name,
                    figure=figure.name,
                    unit=figure.unit,
                    value=value,
                    usual=mean,
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


def _parameter_figures(of_robots: Sequence[Sequence[FleetParameter]]) -> list[_Figure]:
    """Return figures of the changes of parameters of n robots, one for each that any robot's measurements determine.

    Robots whose measurements do not determine it have NaN.
    """
    determined = []
    for parameters in of_robots:
        by_name = {p.name: p for p in parameters if not math.isnan(p.std)}
        determined.append(by_name)
    units: dict[str, str] = {}
    for of_robot in determined:
        for name, parameter in of_robot.items():
            units[name] = parameter.unit
    absent = FleetParameter("", "", math.nan, math.nan)
    figures = []
    for name, unit in units.items():
        column = [of_robot.get(name, absent) for of_robot in determined]
        changes = np.array([parameter.change for parameter in column])
        stds = np.array([parameter.std for parameter in column])
        floor = _FLOORS.get(unit, 0.0)
        figures.append(_Figure(name, unit, changes, stds, floor, logarithmic=False))
    return figures
