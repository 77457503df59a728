"""What must hold of the rows of a table: shapes, names, words, lengths and rotations, and what belongs together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.table import SETS
from calib.errors import MeasurementError, choices
from calib.units import UNITS, Unit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# No instrument is better or worse than this [m or rad], and squares beyond it leave the range of numbers.
SIGMAS = (1e-15, 1e6)

# Beyond this [m or rad] doubles are further apart than what calib computes to, and no robot gets there.
FARTHEST = 1e6
REACH = (-FARTHEST, FARTHEST)

# The points of a robot cell lie between these distances from the origin of any frame in use [m].
FAR_M = 100.0
NEAR_M = 5e-3

# Two rows that share a distance have it to all digits of a table.
_AGREE_M = 1e-9

# A quaternion written with four digits has length one to half of this; a matrix of seven digits is orthonormal to that.
_LENGTH_TOLERANCE = 1e-3
_MATRIX_TOLERANCE = 1e-6


def to_matrices(values: Array) -> Array:
    """Rotation matrices, shape (N, 3, 3), of (x, y, z, w), shape (N, 4), or of vectors [rad], shape (N, 3).

    Quaternions are made unit length; q and -q are the same rotation. NaN rows stay NaN.
    """
    result = np.full((len(values), 3, 3), np.nan)
    there = np.isfinite(values).all(axis=1)
    if there.any():
        make = Rotation.from_quat if values.shape[1] == 4 else Rotation.from_rotvec
        result[there] = make(values[there]).as_matrix()
    return result


def to_quaternions(rotations: Array) -> Array:
    """Unit quaternions (x, y, z, w) with w >= 0, shape (N, 4), of matrices (N, 3, 3). NaN rows stay NaN."""
    result = np.full((len(rotations), 4), np.nan)
    there = np.isfinite(rotations).all(axis=(1, 2))
    if there.any():
        result[there] = Rotation.from_matrix(rotations[there]).as_quat(canonical=True)
    return result


def wrong_length(quaternions: Array) -> tuple[int, float] | None:
    """The first quaternion (N, 4) whose length is not one, and that length; None when all are. NaN rows pass."""
    with np.errstate(over="ignore"):  # what is infinite is too long as well
        length = np.linalg.norm(quaternions, axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > _LENGTH_TOLERANCE)
    return (int(wrong[0]), float(length[wrong[0]])) if wrong.size else None


def no_rotation(matrices: Array) -> Mask:
    """True for matrices (N, 3, 3) that are not finite, orthonormal and right-handed, shape (N,)."""
    product = np.swapaxes(matrices, 1, 2) @ matrices
    error = np.abs(product - np.eye(3)).max(axis=(1, 2), initial=0.0)
    good = (error <= _MATRIX_TOLERANCE) & (np.linalg.det(np.nan_to_num(matrices)) > 0.0)
    return np.asarray(~good, dtype=np.bool_)


def implausible(metres: Array, unit: Unit, *, near: bool = True) -> tuple[int, str]:
    """The row of (N, k) [m] furthest from the origin, and why it cannot be there, or all so ``near``; "" if it can."""
    distance = np.hypot.reduce(metres, axis=1)  # does not square: a huge number stays one
    row = int(np.argmax(distance))
    if not distance[row] <= FAR_M:
        return row, f"further from the origin than {FAR_M:g} m"
    if near and distance[row] < NEAR_M and unit.symbol != "m":
        return row, f"and none is further from the origin than {NEAR_M * 1e3:g} mm"
    return row, ""


def better_unit(value: float, unit: Unit) -> str:
    """The unit of length in which a value would be a distance in a robot cell; "" for the same or none."""
    fits = [u for u in ("mm", "m", "um") if 0.01 <= abs(value) * UNITS[u].to_si <= 20.0]
    return fits[0] if fits and fits[0] != unit.symbol else ""


def check_signs(source: str, signs: Mapping[str, int]) -> None:
    """Refuse decimal points beside decimal commas, one of which may separate thousands; ``signs`` has a line of each.

    Raises:
        MeasurementError: There are both.
    """
    if len(signs) == 2:
        raise MeasurementError(
            f"{source}: numbers have a decimal point in line {signs['.']} and a decimal comma in line "
            f"{signs[',']}. Write all in one way, without a sign between thousands."
        )


class Where(NamedTuple):
    """What a message says of a row: the file's name, the rows' numbers and their kinds."""

    source: str
    rows: Sequence[int]
    kinds: Sequence[str]

    def fail(self, row: int, what: str) -> NoReturn:
        """Refuse a row, from 0."""
        raise MeasurementError(f"{self.source or 'Measurements'}, row {self.rows[row]}: {what}")

    def by_word(self, kind: str, words: Sequence[str]) -> dict[str, list[int]]:
        """The rows of one kind, from 0, by a word of theirs."""
        found: dict[str, list[int]] = {}
        for i in range(len(words)) if kind in self.kinds else ():
            if self.kinds[i] == kind:
                found.setdefault(words[i], []).append(i)
        return found

    def pairs(self, words: Sequence[str]) -> dict[str, list[int]]:
        """The rows, from 0, of each pair by its word; there may be one row only, or more than two."""
        found: dict[str, list[int]] = {}
        for kind in registry.names():
            if registry.get(kind).paired:
                found.update(self.by_word(kind, words))
        return found


def check_words(where: Where, words: Mapping[str, Sequence[str]], count: int) -> None:
    """Refuse words that are not allowed, and row numbers that are not unique.

    Raises:
        MeasurementError: with the row and what is allowed.
    """
    for name, number in (*((n, len(w)) for n, w in words.items()), ("rows", len(where.rows))):
        if number != count:
            raise MeasurementError(
                f"Measurements: '{name}' has {number} entries and should have {count}, one a row"
            )
    for name, allowed in (("sets", SETS), ("kinds", registry.names())):
        wrong = set(words[name]) - set(allowed)
        if wrong:
            i = next(i for i, word in enumerate(words[name]) if word in wrong)
            where.fail(
                i, f"{words[name][i]!r} in '{name}' is not allowed; it is one of {choices(allowed)}"
            )
    if len(set(where.rows)) < count:
        twice = Counter(where.rows).most_common(1)[0][0]
        raise MeasurementError(
            f"{where.source or 'Measurements'}: the row number {twice} stands there twice; each row has its own"
        )


def numbers(
    where: Where,
    name: str,
    values: ArrayLike | None,
    tail: tuple[int, ...],
    told: Mask,
    limits: tuple[float, float] = REACH,
    columns: Sequence[str] = (),
) -> Array | None:
    """A read-only copy of an array (N, *tail) in SI units, NaN in rows that do not measure it; None if none is left.

    Raises:
        MeasurementError: another shape, or a number of a row that is not finite, or outside of the limits.
    """
    if values is None:
        return None
    array = np.array(values, dtype=np.float64)
    if array.shape != (len(told), *tail):
        raise MeasurementError(
            f"Measurements: '{name}' has shape {array.shape} and should have {(len(told), *tail)}"
        )
    if not told.any():
        return None
    good = (array >= limits[0]) & (array <= limits[1])
    wrong = np.argwhere(~good & told.reshape(-1, *(1 for _ in tail)))
    if len(wrong):
        at = tuple(int(i) for i in wrong[0])
        what = columns[at[1]] if columns else name
        where.fail(
            at[0],
            f"'{what}' is {array[at]:g}; in a row of the kind '{where.kinds[at[0]]}' it is a number from "
            f"{limits[0]:g} to {limits[1]:g}, in SI units. Correct it, or its unit.",
        )
    array[~told] = np.nan
    array.setflags(write=False)
    return array


def lacking(where: Where, told: Mask, name: str) -> NoReturn:
    """Refuse rows, shape (N,), whose kind needs numbers that there are none of."""
    i = int(np.argmax(told))
    where.fail(i, f"a row of the kind '{where.kinds[i]}' needs '{name}', and there are none")


def shared(where: Where, values: ArrayLike, pairs: Mapping[str, Sequence[int]]) -> Array:
    """Values with each one that stands in one row of a pair copied into the other, shape (N,).

    Raises:
        MeasurementError: the two rows of a pair have different ones.
    """
    result = np.array(values, dtype=np.float64)
    for word, rows in pairs.items():
        if len(rows) != 2:
            continue
        one, other = result[list(rows)]
        if abs(one - other) > _AGREE_M:
            what = (
                f"the pair '{word}' has {one:.10g} m here and {other:.10g} m in row "
                f"{where.rows[rows[1]]}; give it once, or the same"
            )
            where.fail(rows[0], what)
        result[list(rows)] = other if np.isnan(one) else one
    return result


def check_whole(where: Where, words: Mapping[str, Sequence[str]]) -> None:
    """Refuse, in a table as it was read, pairs of other than two rows and groups with too few.

    A selection of rows may have both.

    Raises:
        MeasurementError: with the word or the group, and its rows.
    """

    def named(at: Sequence[int]) -> str:
        """These rows, from 0, by their numbers."""
        numbers = ", ".join(str(where.rows[i]) for i in at[:8])
        return f"row {numbers} only" if len(at) == 1 else f"rows {numbers}"

    for word, at in where.pairs(words["pairs"]).items():
        if len(at) != 2 or words["sets"][at[0]] != words["sets"][at[1]]:
            raise MeasurementError(
                f"{where.source}: the pair '{word}' stands in {named(at)}; a distance is between two rows of one set. "
                "Give each pair a word of its own."
            )
    for kind in registry.names():
        fewest = registry.get(kind).fewest
        for group, at in where.by_word(kind, words["groups"]).items() if fewest > 1 else ():
            if len(at) < fewest:
                raise MeasurementError(
                    f"{where.source}: the group '{group}' of the kind '{kind}' stands in {named(at)}; it takes "
                    f"{fewest} rows or more. Measure more, or correct the group's name."
                )
