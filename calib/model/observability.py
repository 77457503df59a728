"""What the measured poses can tell apart: rank, named combinations, condition, observability indices.

The columns of a Jacobian are first scaled by declared steps (by default 1 mm and 1 mrad), so that metres and radians
can be compared, and the result does not change with the units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.model.families import unit_of
from calib.robot.robot import read_only
from calib.units import Array

#: Directions with less than this share of the strongest one's effect cannot be identified: 1 mm moves points by < 1 um.
_NEGLIGIBLE = 1e-3
_GAP = 30.0  #: A ratio of neighbouring singular values that is a gap.
_ROUNDING = 1e-13  #: A relative singular value of this size is zero.
_NAMED_EFFECT = 0.02  #: A parameter's least share of a combination's strongest effect, to be named.
_UNSEEN_SHARE = 0.05  #: A parameter with less than this share in what cannot be identified counts as identifiable.


@dataclass(frozen=True, slots=True)
class Combination:
    """Parameters that can change together without changing what was measured."""

    names: tuple[str, ...]  #: The parameters, in the model's order.
    #: How much each changes, in its own unit: the leading one, as a rule the first, by its declared step.
    steps: tuple[float, ...]
    units: tuple[str, ...]  #: Of each, see `calib.model.families.unit_of`.


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """The result of `analyse`."""

    columns: int  #: Number of parameters.
    rank: int  #: Number of combinations that the measurements determine.
    condition: float  #: Largest over smallest singular value of the determined part.
    singular_values: Array  #: shape (columns,), of the scaled Jacobian, descending, [m per step].
    indices: dict[str, float]  #: O1 to O5 of the determined part.
    unidentifiable: tuple[Combination, ...]  #: One combination for each missing rank.
    identifiable: NDArray[np.bool_]  #: shape (columns,), whether one takes part in none of them.


def steps(units: Sequence[str]) -> Array:
    """The declared step of each parameter, shape (p,), by its unit."""
    return np.array([unit_of(unit).step for unit in units])


def analyse(jacobian: Array, names: Sequence[str], units: Sequence[str]) -> Observability:
    """Rank, combinations and indices of a Jacobian of shape (rows, p), [m per unit of the parameter].

    With singular values s_1 >= ... >= s_r of the scaled Jacobian of N rows (J. Hollerbach, A. Nahvi, 1996;
    Y. Sun, J. Hollerbach, 2008): O1 = (s_1 ... s_r)^(1/r) / sqrt(N), O2 = s_r / s_1, O3 = s_r, O4 = s_r^2 / s_1,
    O5 = 1 / (1/s_1 + ... + 1/s_r).
    """
    step = steps(units)
    p = len(names)
    if p == 0:
        return Observability(0, 0, 1.0, read_only([]), {}, (), np.zeros(0, dtype=bool))
    # Rows of zeros, so that there are p singular values and the whole null space; they change nothing.
    scaled = np.concatenate([jacobian * step, np.zeros((max(p - len(jacobian), 0), p))])
    _, values, V = np.linalg.svd(scaled, full_matrices=False)
    rank, effect = rank_by_gap(values), np.linalg.norm(scaled, axis=0)
    null, indices, combinations = V[rank:], {}, []
    identifiable = np.linalg.norm(null, axis=0) < _UNSEEN_SHARE
    for row in _echelon(null):
        # Those whose effect on the measurements, not whose step, matters.
        size, share = np.abs(row), np.abs(row) * effect
        least = max(_NAMED_EFFECT * share.max(), _NEGLIGIBLE * size.max() * effect.max())
        chosen = np.flatnonzero((share > least) | (size == size.max())).tolist()
        identifiable[chosen] = False
        changes = tuple((row * step)[chosen].tolist())
        one = Combination(tuple(names[k] for k in chosen), changes, tuple(units[k] for k in chosen))
        combinations.append(one)
    identifiable.setflags(write=False)
    if rank:
        seen, largest, smallest = values[:rank], float(values[0]), float(values[rank - 1])
        indices = {
            "O1": float(np.exp(np.mean(np.log(seen))) / np.sqrt(len(jacobian))),
            "O2": smallest / largest,
            "O3": smallest,
            "O4": smallest**2 / largest,
            "O5": float(1.0 / np.sum(1.0 / seen)),
        }
    return Observability(
        columns=p,
        rank=rank,
        condition=float(values[0] / values[rank - 1]) if rank else np.inf,
        singular_values=read_only(values),
        indices=indices,
        unidentifiable=tuple(combinations),
        identifiable=identifiable,
    )


def rank_by_gap(values: Array) -> int:
    """The number of singular values, descending, before the first wide gap that ends below what is negligible.

    The first, not the widest gap counts: axes that are parallel but for a few mrad leave values far below the noise and
    yet far above rounding, and they are as good as zero.
    """
    if len(values) == 0 or values[0] == 0.0:
        return 0
    relative = np.maximum(values / values[0], _ROUNDING)
    wide = (relative[1:] < _NEGLIGIBLE) & (relative[:-1] > _GAP * relative[1:])
    if np.any(wide):
        return int(np.argmax(wide)) + 1
    return int(np.sum(relative > 10.0 * _ROUNDING))


def _echelon(null: Array) -> Array:
    """The reduced row echelon form of the null space: sparse, each row led by a 1, the earliest parameters first."""
    rows: Array = null.copy()
    r, p = rows.shape
    done = 0
    # Twice, for a row whose only large entry grew in a column that had been passed over.
    for column in (*range(p), *range(p)):
        if done == r:
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        # A column with little left in it would make a badly conditioned leader: take a later one.
        if abs(rows[pivot, column]) < 0.05:
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        others = np.arange(r) != done
        rows[others] -= np.outer(rows[others, column], rows[done])
        done += 1
    return rows
