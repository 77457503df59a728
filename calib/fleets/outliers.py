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
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from calib.fleets.record import DONE, FleetRow

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

#: A model is usual if this share of the robots has it, and unusual if no more than this, or one robot, has it.
_USUAL, _UNUSUAL = 0.75, 0.05

_FIGURES = {
    "nominal_rms": "nominal error",
    "left_out_rms": "cross-validated error",
    "sigma": "noise",
    "sigma_angle": "noise of orientations",
}


@dataclass(frozen=True, slots=True)
class Odd:
    """One reason why a robot is odd."""

    name: str  #: The robot
    #: What is odd about it: a figure's or a parameter's name, ``"data"`` or ``"model"``
    figure: str
    unit: str = ""  #: Of value and usual; ``""`` where they are no numbers
    value: float = math.nan  #: Its value; NaN where it is no number
    usual: float = math.nan  #: The median of the robots of its kind; NaN likewise
    z: float = math.nan  #: How far it is off, see the module's text; NaN likewise
    limit: float = math.nan  #: Beyond which it is flagged; NaN likewise
    text: str = ""  #: The same in words


def odd_ones(rows: Sequence[FleetRow]) -> tuple[tuple[Odd, ...], tuple[str, ...]]:
    """The odd ones of a fleet, in the order of the robots and the farthest off first; and what could not be said."""
    done = [row for row in rows if row.status == DONE]
    found, notes = list(_same_data(done)), []
    kinds = dict.fromkeys(row.kind for row in done)
    for kind in kinds:
        alike = [row for row in done if row.kind == kind]
        count = int(np.sum(_counted(alike)))
        if count >= FEWEST:
            found += [*_figures(alike), *_models(alike)]
            continue
        robots = f"{len(alike)} robot{'s' * (len(alike) > 1)}"
        robots += f" with the data of {count}" * (count < len(alike))
        which = f"{robots} of the kind '{kind.split()[0]}'" if len(kinds) > 1 else robots
        notes.append(
            f"What is usual cannot be told of {which}; it takes {FEWEST}. Only data given twice are looked for."
        )
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
    first = {row.measured: k for k, row in reversed([*enumerate(rows)])}
    return np.array([first[row.measured] == k for k, row in enumerate(rows)], dtype=bool)


def _figures(rows: list[FleetRow]) -> Iterator[Odd]:
    """Robots whose errors, noise or parameters are odd."""
    once = _counted(rows)
    count = int(np.sum(once))
    sizes = {name: np.array([getattr(row, name) for row in rows]) for name in _FIGURES}
    sizes = {name: x for name, x in sizes.items() if np.sum(x[once] > 0.0) >= FEWEST}
    bound = limit(count, len(sizes), 0.5 * CHANCE) if sizes else math.nan
    for name, x in sizes.items():
        log = np.log(x, where=x > 0.0, out=np.full(len(x), math.nan))
        z = scores(log, np.zeros(len(x)), _LOG_FLOOR, once)
        usual = float(np.exp(np.nanmedian(log[once])))
        unit = "rad" if name == "sigma_angle" else "m"
        yield from _flagged(rows, _FIGURES[name], unit, x, usual, z, bound)
    known = [{p.name: p for p in row.parameters} for row in rows]
    told = Counter(
        name for i in np.flatnonzero(once) for name, p in known[i].items() if p.std == p.std
    )
    shared = [name for name, robots in told.items() if robots >= FEWEST]
    for name in shared:
        own = [one.get(name) for one in known]
        unit = next(p.unit for p in own if p is not None)
        std = np.array([math.nan if p is None else p.std for p in own])
        x = np.array([math.nan if p is None or p.std != p.std else p.change for p in own])
        z = scores(x, std, _FLOORS.get(unit, 0.0), once)
        bound = limit(count, len(shared), 0.5 * CHANCE)
        yield from _flagged(rows, name, unit, x, float(np.nanmedian(x[once])), z, bound)


def scores(x: Array, std: Array, floor: float, once: Mask | None = None) -> Array:
    """How far each value of shape (n,) is from the median, in scales of its std or a floor at least.

    Those that ``once`` says count in median and MAD, all by default.
    """
    counted = np.ones(len(x), dtype=bool) if once is None else once
    away = x - np.nanmedian(x[counted])
    scale = np.fmax(np.fmax(1.4826 * np.nanmedian(np.abs(away[counted])), floor), std)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(away == 0.0, 0.0, away / scale)


def _flagged(
    rows: list[FleetRow], figure: str, unit: str, x: Array, usual: float, z: Array, bound: float
) -> Iterator[Odd]:
    """The robots beyond the limit."""
    scale, shown = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}.get(unit, (1.0, unit))
    for i in np.flatnonzero(np.abs(z) > bound):
        text = (
            f"{figure} {scale * x[i]:.4g} {shown}, usually {scale * usual:.4g} {shown} (|z| {abs(z[i]):.1f}, limit "
            f"{bound:.1f})"
        )
        yield Odd(rows[i].name, figure, unit, float(x[i]), usual, float(z[i]), bound, text)


def _models(rows: list[FleetRow]) -> Iterator[Odd]:
    """Robots with another model than nearly all others."""
    models = [" and ".join(filter(None, (row.model, row.larger))) for row in rows]
    counts = Counter(model for model, one in zip(models, _counted(rows), strict=True) if one)
    usual, most = counts.most_common(1)[0]
    count = counts.total()
    if most < _USUAL * count:
        return
    for row, model in zip(rows, models, strict=True):
        if model != usual and counts[model] <= max(1.0, _UNUSUAL * count):
            text = f"model {model}, {most} of {count} have {usual}"
            yield Odd(row.name, "model", text=text)


def _same_data(rows: Sequence[FleetRow]) -> Iterator[Odd]:
    """Robots whose measurements are those of another."""
    same: dict[str, list[FleetRow]] = {}
    for row in rows:
        same.setdefault(row.measured, []).append(row)
    for group in same.values():
        for row in group:
            others = [other.name for other in group if other is not row]
            if others:
                more = f" and {len(others) - 3} more" * (len(others) > 3)
                text = f"the same measurements as {', '.join(others[:3])}{more} ({row.data})"
                yield Odd(row.name, "data", text=text)
