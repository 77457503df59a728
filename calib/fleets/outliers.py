"""odd_ones: which robots of a fleet are unlike the others, and in what.

A figure x of robot i is compared with those of all robots of its kind by

    z_i = (x_i - median) / scale_i,   scale_i = max(1.4826 MAD, floor, std_i)

with the median absolute deviation MAD, which odd ones hardly move, a floor below which differences do not matter, and
the figure's own standard deviation where it has one. Errors and noise are compared by their logarithms. A robot is
flagged where |z| is beyond what one fleet in twenty, with nothing odd in it, reaches anywhere among its n robots and k
figures, were they normally distributed:

    limit = quantile of Student's t with 0.41 n degrees of freedom at 1 - 0.05 / (2 n k)

The degrees of freedom make up for the MAD's own scatter; 0.41 is just below what simulations of 5 to 500 robots gave.
Half of the 0.05 is spent on the errors and the noise, the other half on the parameters. Of robots with the same
data one counts in n, median and MAD, and all are compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from calib.fleets.record import DONE, FleetRow
from calib.text.fleet import data_text, few_text, figure_text

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: With fewer robots nothing is said of what is usual.
FEWEST = 5

#: How often a fleet without odd ones has one flagged.
CHANCE = 0.05

#: Degrees of freedom of a scale from a MAD, for each robot.
_FREEDOM = 0.41

#: Errors and noise that differ by less are alike (natural logarithm).
_LOG_FLOOR = 0.05

#: Changes of a parameter that differ by less are alike, by unit; joint gains and compliances have their std only.
_FLOORS = {"m": 20e-6, "rad": 20e-6, "1": 20e-6}

_FIGURES = {
    "nominal_rms": ("nominal error", "m"),
    "left_out_rms": ("cross-validated error", "m"),
    "sigma": ("noise", "m"),
    "sigma_angle": ("noise of orientations", "rad"),
}


@dataclass(frozen=True, slots=True)
class Odd:
    """One reason why a robot is odd."""

    name: str  #: The robot
    #: What is odd about it: a figure's or a parameter's name, or ``"data"``
    figure: str
    unit: str = ""  #: Of value and usual; ``""`` for data, of which all numbers are NaN
    value: float = math.nan  #: Its value
    usual: float = math.nan  #: The median of the robots of its kind
    z: float = math.nan  #: How far it is off, see the module's text
    limit: float = math.nan  #: Beyond which it is flagged
    text: str = ""  #: The same in words


def odd_ones(rows: Sequence[FleetRow]) -> tuple[tuple[Odd, ...], tuple[str, ...]]:
    """The odd ones of a fleet, in the order of the robots and the farthest off first; and what could not be said."""
    done = [row for row in rows if row.status == DONE]
    found, notes = [*_same_data(done)], []
    kinds = dict.fromkeys(row.kind for row in done)
    for kind in kinds:
        alike = [row for row in done if row.kind == kind]
        count = int(np.sum(_counted(alike)))
        if count >= FEWEST:
            found += _figures(alike)
        else:
            shown = kind.split()[0] if len(kinds) > 1 else ""
            notes.append(few_text(len(alike), count, FEWEST, shown))
    place = {row.name: i for i, row in enumerate(rows)}
    found.sort(key=lambda odd: (place[odd.name], -math.inf if odd.z != odd.z else -abs(odd.z)))
    return tuple(found), tuple(notes)


def limit(robots: int, figures: int, chance: float = CHANCE) -> float:
    """The |z| beyond which one of k figures of one of n robots is flagged.

    Example:
        >>> [round(limit(n, 30), 1) for n in (5, 20, 200)]
        [50.5, 7.2, 4.8]
    """
    return float(stdtrit(_FREEDOM * robots, 1.0 - chance / (2.0 * robots * figures)))


def _counted(rows: Sequence[FleetRow]) -> Mask:
    """Which robots count in what is usual, shape (n,): of those with the same data the first."""
    mask = np.zeros(len(rows), dtype=np.bool_)
    mask[np.unique([row.measured for row in rows], return_index=True)[1]] = True
    return mask


def _figures(rows: list[FleetRow]) -> Iterator[Odd]:
    """Robots whose errors, noise or parameters are odd."""
    once, exact = _counted(rows), np.zeros(len(rows))
    errors: list[tuple[str, str, Array, Array, float]] = []
    parameters: list[tuple[str, str, Array, Array, float]] = []
    for name, (figure, unit) in _FIGURES.items():
        x = np.array([getattr(row, name) for row in rows])
        errors.append((figure, unit, np.log(np.where(x > 0.0, x, math.nan)), exact, _LOG_FLOOR))
    named = [{p.name: p for p in row.parameters if p.std == p.std} for row in rows]
    for figure, unit in {p.name: p.unit for own in named for p in own.values()}.items():
        own = [of.get(figure) for of in named]
        x, std = np.array([(p.change, p.std) if p else (math.nan, math.nan) for p in own]).T
        parameters.append((figure, unit, x, std, _FLOORS.get(unit, 0.0)))
    for group, size in ((errors, np.exp), (parameters, np.asarray)):
        shared = [one for one in group if np.sum(np.isfinite(one[2][once])) >= FEWEST]
        for figure, unit, x, std, floor in shared:
            bound = limit(int(np.sum(once)), len(shared), 0.5 * CHANCE)
            z = scores(x, std, floor, once)
            usual = float(size(np.nanmedian(x[once])))
            for i in np.flatnonzero(np.abs(z) > bound):
                found = (figure, unit, float(size(x[i])), usual, float(z[i]), bound)
                yield Odd(rows[i].name, *found, figure_text(*found))


def scores(x: Array, std: Array, floor: float, once: Mask) -> Array:
    """The z of each value, shape (n,); see the module's text. Those of ``once`` count in median and MAD."""
    away = x - np.nanmedian(x[once])
    scale = np.fmax(np.fmax(1.4826 * np.nanmedian(np.abs(away[once])), floor), std)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(away == 0.0, 0.0, away / scale)


def _same_data(rows: Sequence[FleetRow]) -> Iterator[Odd]:
    """Robots whose measurements are those of another."""
    same: dict[str, list[FleetRow]] = {}
    for row in rows:
        same.setdefault(row.measured, []).append(row)
    for group in same.values():
        for row in group:
            others = [other.name for other in group if other is not row]
            if others:
                yield Odd(row.name, "data", text=data_text(others, row.data))
