"""What must hold of the rows of a table: shapes, names, words and numbers, and what belongs together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.errors import MeasurementError, choices
from calib.measure.columns import QUATERNION, SETS, TORQUE, reserved
from calib.measure.orientation import no_rotation

Array = NDArray[np.float64]

# No instrument is better or worse than this [m or rad], and squares beyond it leave the range of numbers.
SIGMAS = (1e-15, 1e6)

# Beyond this [m or rad] doubles are further apart than what calib computes to, and no robot gets there.
FARTHEST = 1e6
REACH = (-FARTHEST, FARTHEST)

# Two rows that share a distance have it to all digits of a table.
AGREE_M = 1e-9


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


def is_name(text: str) -> bool:
    """Whether a text is one line and not empty, without blanks around it, such as a text file can hold."""
    return text != "" and text == text.strip() and len(text.splitlines()) == 1 and "\0" not in text


def check_joint_names(
    source: str, names: Sequence[str], prismatic: Sequence[str], *, turned: bool, torques: bool
) -> None:
    """Refuse names of joints that a table cannot hold or that mean something else.

    Raises:
        MeasurementError: with the names.
    """
    taken = (*reserved(), *(QUATERNION if turned else ()))
    if torques:
        taken += tuple(name + TORQUE for name in names)
    bad = [n for n, count in Counter(names).items() if n in taken or not is_name(n) or count > 1]
    if bad or not names:
        raise MeasurementError(
            f"{source}: joint names are unique, on one line, without blanks around them, and none "
            f"of {choices(taken, limit=30)}; given were {choices(bad or ['no names at all'])}"
        )
    strange = [name for name in prismatic if name not in names]
    if strange:
        raise MeasurementError(
            f"{source}: 'prismatic' names {choices(strange)}; the joints are {choices(names)}"
        )


def check_words(where: Where, words: Mapping[str, Sequence[str]]) -> None:
    """Refuse words that are not allowed; each different one is looked at once, for there may be a million rows.

    Args:
        where: The rows.
        words: Those of ``sets``, ``targets``, ``groups``, ``kinds`` and ``pairs``.

    Raises:
        MeasurementError: with the row and what is allowed.
    """
    known = registry.names()
    allowed = {
        "sets": (SETS.__contains__, f"one of {choices(SETS)}"),
        "kinds": (known.__contains__, f"one of {choices(known)}"),
        "targets": (is_name, "a name on one line, without blanks around it"),
        "groups": (lambda word: word == "" or is_name(word), "a name on one line, or empty"),
    }
    for name, (is_good, what) in allowed.items():
        wrong = {word for word in set(words[name]) if not is_good(word)}
        if wrong:
            i = next(i for i, word in enumerate(words[name]) if word in wrong)
            where.fail(i, f"{words[name][i]!r} in '{name}' is not allowed; each is {what}")
    for word, rows in where.pairs(words["pairs"]).items():
        if not is_name(word):
            where.fail(rows[0], f"the pair {word!r} is a word on one line that two rows share")


def check_row_numbers(source: str, rows: Sequence[int]) -> None:
    """Refuse row numbers that are no whole numbers, or there twice.

    Raises:
        MeasurementError: with the number.
    """
    strange = set(map(type, rows)) - {int}
    broken = [row for row in rows if strange and not isinstance(row, (int, np.integer))]
    if broken or len(set(rows)) < len(rows):
        what = f"{broken[0]!r}" if broken else f"{Counter(rows).most_common(1)[0][0]}, twice"
        raise MeasurementError(
            f"{source}: row numbers are whole numbers, each once; there is {what}"
        )


def numbers(
    where: Where,
    name: str,
    values: ArrayLike | None,
    tail: tuple[int, ...],
    told: NDArray[np.bool_],
    limits: tuple[float, float] = REACH,
    columns: Sequence[str] = (),
) -> Array | None:
    """A read-only copy of an array, NaN in rows that do not measure it; None if none is left.

    Args:
        where: The rows.
        name: Of the array, for messages.
        values: shape (N, *tail), in SI units; None where there are none.
        tail: The shape of one row's.
        told: shape (N,), the rows that measure it.
        limits: Between which the values are.
        columns: The names of the columns, for messages.

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
    good = np.isfinite(array) & (array >= limits[0]) & (array <= limits[1])
    wrong = np.argwhere(~good & told.reshape(-1, *(1 for _ in tail)))
    if len(wrong):
        at = tuple(int(i) for i in wrong[0])
        what = columns[at[1]] if columns else name
        where.fail(
            at[0],
            f"'{what}' is {array[at]:g}; in a row of the kind '{where.kinds[at[0]]}' it is a number from "
            f"{limits[0]:g} to {limits[1]:g}, in SI units. Correct it, or its unit.",
        )
    if not told.all():
        array[~told] = np.nan
    array.setflags(write=False)
    return array


def check_rotations(where: Where, rotations: Array, told: NDArray[np.bool_]) -> None:
    """Refuse matrices that are no rotations.

    Raises:
        MeasurementError: with the row.
    """
    rows = np.flatnonzero(told)
    wrong = rows[no_rotation(rotations[rows])]
    if wrong.size:
        where.fail(
            int(wrong[0]), "'rotations' holds no rotation; each is orthonormal with determinant 1"
        )


def lacking(where: Where, told: NDArray[np.bool_], name: str) -> NoReturn:
    """Refuse rows, shape (N,), whose kind needs numbers that there are none of."""
    i = int(np.argmax(told))
    where.fail(i, f"a row of the kind '{where.kinds[i]}' needs '{name}', and there are none")


def checked_torques(where: Where, names: Sequence[str], torques: ArrayLike | None) -> Array | None:
    """A read-only copy of torques, shape (N, n); of each joint there are all, or none (NaN).

    Raises:
        MeasurementError: another shape, or with the joint and a row without one.
    """
    if torques is None:
        return None
    result = np.array(torques, dtype=np.float64)
    if result.shape != (len(where.rows), len(names)):
        raise MeasurementError(
            f"Measurements: 'torques' has shape {result.shape} and should have {(len(where.rows), len(names))}"
        )
    for name, there in zip(names, np.isfinite(result).T, strict=True):
        if there.any() and not there.all():
            what = (
                f"joint '{name}' has no torque here and has one in other rows; give all of them, or none of the joint "
                "(NaN)"
            )
            where.fail(int(np.argmin(there)), what)
    result.setflags(write=False)
    return result


def shared(where: Where, values: Array, pairs: Mapping[str, Sequence[int]]) -> Array:
    """Values with each one that stands in one row of a pair copied into the other, shape (N,).

    Raises:
        MeasurementError: the two rows of a pair have different ones.
    """
    result = np.array(values, dtype=np.float64)
    for word, rows in pairs.items():
        if len(rows) != 2:
            continue
        one, other = result[list(rows)]
        if abs(one - other) > AGREE_M:
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

    Args:
        where: The rows.
        words: Those of ``sets``, ``groups`` and ``pairs``.

    Raises:
        MeasurementError: with the word or the group, and its rows.
    """
    for word, at in where.pairs(words["pairs"]).items():
        said = f"{where.source}: the pair '{word}' stands in {_name_rows(where, at)}"
        if len(at) != 2:
            raise MeasurementError(
                f"{said}; a distance is between two rows. Give each pair a word of its own."
            )
        if words["sets"][at[0]] != words["sets"][at[1]]:
            raise MeasurementError(
                f"{said}, one 'estimate', one 'validate'. Put both into one set."
            )
    for kind in registry.names():
        fewest = registry.get(kind).fewest
        for group, at in where.by_word(kind, words["groups"]).items() if fewest > 1 else ():
            if len(at) < fewest:
                raise MeasurementError(
                    f"{where.source}: the group '{group}' of the kind '{kind}' stands in {_name_rows(where, at)}"
                    f"; it takes {fewest} rows or more to say anything of the robot. Measure more, "
                    "correct the group's name, or remove it."
                )


def _name_rows(where: Where, at: Sequence[int]) -> str:
    """These rows, from 0, by their numbers."""
    named = [str(where.rows[i]) for i in at[:8]] + (["..."] if len(at) > 8 else [])
    return f"row {named[0]} only" if len(at) == 1 else f"rows {', '.join(named)}"
