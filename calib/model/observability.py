"""Observability of parameters in measured poses: rank, unobservable combinations by name, condition, indices.

The columns of a Jacobian are first scaled by declared steps (by default 1 mm and 1 mrad), so that metres and radians
can be compared, and the result does not change with the units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value, keep_read_only
from calib.model.families import unit_of

#: Directions with less than this share of the strongest one's effect cannot be identified: 1 mm moves points by < 1 um.
_NEGLIGIBLE = 1e-3

#: A larger ratio of neighbouring singular values is a gap.
_GAP = 30.0

#: Relative singular values up to this size are rounding.
_ROUNDING = 1e-13

#: The least effect of a parameter that a combination names, over the strongest effect in it.
_NAMED_EFFECT = 0.02

#: A parameter with a smaller share than this in the unobservable directions counts as identifiable.
_UNSEEN_SHARE = 0.05

#: The least entry that leads a row of the echelon form: a smaller one would make it ill-conditioned.
_LEAST_PIVOT = 0.05


@dataclass(frozen=True, slots=True)
class Combination:
    """Parameters that can change together without changing what was measured."""

    #: The parameters, in the model's order
    names: tuple[str, ...]
    #: Change of each, in its own unit, if the leading one (as a rule the first) changes by its declared step
    steps: tuple[float, ...]
    #: Symbol of the unit of each, see `calib.model.families.unit_of`
    units: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Observability(Value):
    """The result of `analyse`."""

    #: Number of parameters
    columns: int
    #: Number of combinations that the measurements determine
    rank: int
    #: Largest over smallest singular value of the determined part
    condition: float
    #: Shape (columns,), of the scaled Jacobian, descending, [m per step]
    singular_values: Array
    #: O1 to O5 of the determined part
    indices: Mapping[str, float]
    #: One combination for each missing rank
    unidentifiable: tuple[Combination, ...]
    #: Shape (columns,), True for a parameter that takes part in none of them
    identifiable: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "indices")


def steps(units: Sequence[str]) -> Array:
    """Return the declared step of each parameter in SI, shape (p,), by the symbols of their units."""
    return np.array([unit_of(unit).step for unit in units])


def analyse(
    jacobian: Array, names: Sequence[str], units: Sequence[str], count: int | None = None
) -> Observability:
    """Return rank, unobservable combinations and observability indices of a Jacobian.

    With singular values s_1 >= ... >= s_r of the scaled Jacobian of N rows (J. Hollerbach, A. Nahvi, 1996;
    Y. Sun, J. Hollerbach, 2008): O1 = (s_1 ... s_r)^(1/r) / sqrt(N), O2 = s_r / s_1, O3 = s_r, O4 = s_r^2 / s_1,
    O5 = 1 / (1/s_1 + ... + 1/s_r).

    Args:
        jacobian: Shape (rows, p), [m per unit of the parameter], derivative of the predicted coordinates.
        names: Names of the p parameters.
        units: Symbols of their units, "m" or "rad" for most, see `calib.model.families.unit_of`.
        count: Number N of rows, if the Jacobian is a triangle of the same products; None: its own.

    Returns:
        Rank, unobservable combinations and indices; of rank 0 without parameters. Of rank 0 there are no indices, and
        the condition is infinite, or 1 without parameters.
    """
    if not len(names):
        return Observability(0, 0, 1.0, read_only([]), {}, (), np.zeros(0, dtype=bool))
    step = steps(units)
    scaled = jacobian * step
    effect = np.linalg.norm(scaled, axis=0)  # of a step of each parameter
    # With rows of zeros there are p singular values, and their right vectors span the whole null space.
    rows, p = scaled.shape
    square = np.concatenate([scaled, np.zeros((max(p - rows, 0), p))])
    _, values, V = np.linalg.svd(square, full_matrices=False)
    rank = rank_by_gap(values)

    null = V[rank:]
    identifiable = np.linalg.norm(null, axis=0) < _UNSEEN_SHARE
    combinations = []
    for direction in _echelon(null):
        # Named are the parameters whose effect, not whose step, matters, and the one with the largest step.
        size = np.abs(direction)
        share = size * effect
        least = max(_NAMED_EFFECT * share.max(), _NEGLIGIBLE * size.max() * effect.max())
        members: list[int] = np.flatnonzero((share > least) | (size == size.max())).tolist()
        identifiable[members] = False
        combination = Combination(
            names=tuple(names[k] for k in members),
            steps=tuple((direction * step)[members].tolist()),
            units=tuple(units[k] for k in members),
        )
        combinations.append(combination)
    identifiable.setflags(write=False)

    condition = np.inf
    indices = {}
    if rank:
        determined = values[:rank]
        largest = float(determined[0])
        smallest = float(determined[-1])
        condition = float(determined[0] / determined[-1])
        indices = {
            "O1": float(
                np.exp(np.mean(np.log(determined))) / np.sqrt(rows if count is None else count)
            ),
            "O2": smallest / largest,
            "O3": smallest,
            "O4": smallest**2 / largest,
            "O5": float(1.0 / np.sum(1.0 / determined)),
        }
    return Observability(
        columns=len(names),
        rank=rank,
        condition=condition,
        singular_values=read_only(values),
        indices=indices,
        unidentifiable=tuple(combinations),
        identifiable=identifiable,
    )


def rank_by_gap(values: Array) -> int:
    """Return the number of singular values before the first wide gap whose lower end is negligible.

    The first, not the widest gap counts: axes that are parallel within a few mrad leave values that are far below the
    noise, though far above rounding, and practically zero. Without such a gap, all values above rounding count.

    Args:
        values: Shape (p,), descending.
    """
    if len(values) == 0 or values[0] == 0.0:
        return 0
    relative = np.maximum(values / values[0], _ROUNDING)
    negligible = relative[1:] < _NEGLIGIBLE
    wide = negligible & (relative[:-1] > _GAP * relative[1:])
    if np.any(wide):
        return int(np.argmax(wide)) + 1
    return int(np.sum(relative > 10.0 * _ROUNDING))


def _echelon(null: Array) -> Array:
    """Return the reduced row echelon form of a null space, shape (p - rank, p): sparse, with rows led by a 1."""
    rows: Array = null.copy()
    r, p = rows.shape
    count = 0  # rows that have their leader
    # Twice, because a row's only large entry may have grown in a column that was skipped.
    for column in (*range(p), *range(p)):
        if count == r:
            break
        pivot = count + int(np.argmax(np.abs(rows[count:, column])))
        if abs(rows[pivot, column]) < _LEAST_PIVOT:
            continue
        rows[[count, pivot]] = rows[[pivot, count]]
        rows[count] /= rows[count, column]
        others = np.arange(r) != count
        rows[others] -= np.outer(rows[others, column], rows[count])
        count += 1
    return rows
