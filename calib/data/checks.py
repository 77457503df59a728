"""Checks of rows of measurements: words, numbers in range, rotations, covariances, complete pairs and groups."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.basics.arguments import (
    check_mapping,
    check_names,
    check_path,
    check_type,
    numbers,
    wrong_type,
)
from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.tables import Table
from calib.data.columns import SETS, WORD_COLUMNS, reserved
from calib.data.forms.column_options import ColumnOptions
from calib.data.references import References
from calib.errors import MeasurementError, choices
from calib.numerics.correlated_noise import POSE
from calib.numerics.geometry import FARTHEST, not_rotations

#: Two rows of a pair that both give its distance give the same to all digits of a table [m].
_AGREE_M = 1e-9

#: Least and largest entry of a covariance [m^2, m rad, rad^2].
_COVARIANCES = (-(registry.SIGMAS[1] ** 2), registry.SIGMAS[1] ** 2)

#: Difference of a correlation from that of the same two numbers, in digits that a table may have.
_SYMMETRIC = 1e-4

#: The order and the units of the entries of a covariance, for messages.
_ENTRIES_ARE = "It has x, y, z [m] and the rotations about x, y, z [rad], row by row."

#: Most rows that a message lists.
_LISTED_ROWS = 8


@dataclass(frozen=True, slots=True)
class RowLabels:
    """Names of N rows of measurements and their joints, for messages."""

    #: The file's name; empty: none.
    source: str
    #: Row numbers as the table has them.
    rows: Sequence[int]
    #: Name of each row's kind.
    kinds: Sequence[str]
    #: Names of the joints, in the order of the columns of joint values.
    joint_names: Sequence[str]

    @property
    def name(self) -> str:
        """Name of the measurements as a whole."""
        return self.source or "Measurements"

    def fail(self, index: int, what: str) -> NoReturn:
        """Refuse a row of measurements, with its row number in the message.

        Args:
            index: The row, from 0; the message has its row number.
            what: What is wrong with it, for the message.

        Raises:
            MeasurementError: Always.
        """
        raise MeasurementError(f"{self.name}, row {self.rows[index]}: {what}")

    def fail_on(self, what: str, indices: Sequence[int], fix: str) -> NoReturn:
        """Refuse several rows together.

        Args:
            what: What the rows are, for the message: ``"the pair 'A'"``.
            indices: The rows, from 0; the message has their row numbers.
            fix: What is wrong with them and how to mend it, for the message.

        Raises:
            MeasurementError: Always.
        """
        numbers = ", ".join(str(self.rows[i]) for i in indices[:_LISTED_ROWS])
        plural = "s" if len(indices) > 1 else ""
        raise MeasurementError(f"{self.name}: {what} is in row{plural} {numbers}; {fix}")


def by_word(words: Sequence[str], rows: Mask) -> dict[str, list[int]]:
    """Return the indices of chosen rows, from 0, by their words.

    Args:
        words: Word of each of all N rows, such as the name of its pair.
        rows: Which rows to group, shape (N,).

    Returns:
        Indices of these rows, from 0, by their words.
    """
    result: dict[str, list[int]] = {}
    for i in np.flatnonzero(rows).tolist():
        result.setdefault(words[i], []).append(i)
    return result


# Words and names


def mask_of_words(words: Sequence[str], *chosen: str) -> Mask:
    """Return a mask, shape (N,), read-only: True for each of N words that is among those chosen."""
    present = set(words)  # mostly one word, and then no loop over the rows
    if present <= set(chosen) or present.isdisjoint(chosen):
        mask = np.full(len(words), not present.isdisjoint(chosen), dtype=np.bool_)
    else:
        mask = np.array([word in chosen for word in words], dtype=np.bool_)
    mask.setflags(write=False)
    return mask


def check_words(labels: RowLabels, words: Mapping[str, Sequence[str]], count: int) -> None:
    """Refuse words and row numbers that are not one a row, unknown, or repeated.

    Args:
        labels: The rows, whose numbers are checked too.
        words: Words by attribute of `Measurements`; ``sets`` and ``kinds`` among them.
        count: The number of rows.

    Raises:
        MeasurementError: There are not ``count`` words or row numbers, a set or a kind does not
            exist, or a row number repeats.
    """
    for name, entries in {**words, "rows": labels.rows}.items():
        if len(entries) != count:
            raise MeasurementError(
                f"{labels.name}: '{name}' has {len(entries)} entries and should have {count}, "
                "one a row"
            )
    for column, allowed in (("set", SETS), ("kind", registry.names())):
        column_words = words[f"{column}s"]
        for word in set(column_words) - set(allowed):
            what = f"column '{column}': '{word}' is none of {choices(allowed)}."
            labels.fail(column_words.index(word), what)
    if len(set(labels.rows)) < count:
        repeated = Counter(labels.rows).most_common(1)[0][0]
        raise MeasurementError(
            f"{labels.name}: the row number {repeated} occurs more than once; each row needs its own"
        )


def check_joint_names(labels: RowLabels) -> None:
    """Refuse names of joints that repeat, or that are names of other columns.

    Raises:
        MeasurementError: There are such names; the message lists them.
    """
    counts = Counter(labels.joint_names)
    taken = [name for name, count in counts.items() if count > 1 or name in reserved()]
    if taken:
        raise MeasurementError(
            f"{labels.name}: joint names are unique and no other column's; given were "
            f"{choices(taken)}"
        )


# Numbers


def checked_numbers(
    labels: RowLabels,
    name: str,
    values: ArrayLike | None,
    tail: tuple[int, ...],
    rows: Mask,
    limits: tuple[float, float],
) -> Array | None:
    """Return a checked, read-only copy of an array.

    Args:
        labels: The N rows, for messages.
        name: The array's name, for messages; ``"sigma..."`` of a standard deviation.
        values: shape (N, *tail), in SI units; None: not given.
        tail: Shape of the entry of a row.
        rows: Which rows measure it, shape (N,).
        limits: Least and largest number of these rows.

    Returns:
        The array, NaN in other rows; None if no row measures it, or if it is a standard deviation
        that is not given.

    Raises:
        ArgumentError: The entries are not numbers.
        MeasurementError: The array is needed and missing, or of another shape; or a number of these rows is NaN or out
            of range.
    """
    if not rows.any() or (values is None and name.startswith("sigma")):
        return None
    if values is None:
        i = int(np.argmax(rows))
        labels.fail(i, f"a row of the kind '{labels.kinds[i]}' needs '{name}', and there are none")
    array = numbers(
        name, values, f"an array with an entry a row, shape {(len(rows), *tail)}"
    ).copy()
    shape = (len(rows), *tail)
    if array.shape != shape:
        raise MeasurementError(
            f"Measurements: '{name}' has shape {array.shape} and should have {shape}"
        )

    least, largest = limits
    in_range = (array >= least) & (array <= largest)
    each_row = rows.reshape(-1, *[1] * (array.ndim - 1))
    out_of_range = np.argwhere(~in_range & each_row)
    if out_of_range.size:
        at = out_of_range[0].tolist()
        what = labels.joint_names[at[1]] if name == "joints" else name
        labels.fail(
            at[0],
            f"'{what}' is {array[tuple(at)]:g}; in a row of the kind '{labels.kinds[at[0]]}' it is a "
            f"number from {least:g} to {largest:g}, in SI units. Correct it, or its unit.",
        )
    array[~rows] = np.nan
    return read_only(array)


def shared_by_pairs(labels: RowLabels, values: ArrayLike, pair_rows: Integers) -> Array:
    """Return readings that are the same in both rows of a pair, also if one row had none.

    Args:
        labels: The N rows, for messages.
        values: Readings, shape (N,), in SI units; NaN in at most one row of a pair.
        pair_rows: Indices of the two rows of each pair, from 0, shape (P, 2).

    Returns:
        The readings, shape (N,).

    Raises:
        MeasurementError: The rows of a pair have different readings.
    """
    result = np.array(values, dtype=np.float64)
    for pair in pair_rows:
        first, second = result[pair]
        if abs(first - second) > _AGREE_M:
            labels.fail(
                int(pair[0]),
                f"its pair has {first:.10g} m here and {second:.10g} m in row "
                f"{labels.rows[pair[1]]}; give it once, or the same",
            )
        result[pair] = second if np.isnan(first) else first
    return result


def checked_readings(
    labels: RowLabels, given: Mapping[str, ArrayLike | None], pair_rows: Integers
) -> dict[str, Array]:
    """Return checked, read-only copies of the readings that the registered kinds need.

    Args:
        labels: The N rows, for messages.
        given: Readings by the column's name, shape (N,) each, in SI units; None: not given.
        pair_rows: Indices of the two rows of each pair, from 0, shape (P, 2).

    Returns:
        The readings, NaN in rows that do not measure them; both rows of a pair have the pair's.

    Raises:
        MeasurementError: No registered kind has such a reading, or a number is missing or out of range.
    """
    registered = registry.readings()
    unknown = given.keys() - registered.keys()
    if unknown:
        raise MeasurementError(
            f"No kind of measurement reads {choices(unknown)}; register it first "
            "(calib.data.kinds.register)."
        )
    result: dict[str, Array] = {}
    for name, reading in registered.items():
        kinds = [kind for kind in map(registry.get, registry.names()) if reading in kind.readings]
        values = given.get(name)
        if values is not None and any(kind.paired for kind in kinds):
            values = shared_by_pairs(labels, values, pair_rows)
        rows = mask_of_words(labels.kinds, *(kind.name for kind in kinds))
        least = registry.SIGMAS[0] if reading.positive else -FARTHEST
        array = checked_numbers(labels, name, values, (), rows, (least, FARTHEST))
        if array is not None:
            result[name] = array
    return result


def check_rotations(labels: RowLabels, rotations: Array, rows: Mask) -> None:
    """Refuse measured orientations that are not rotation matrices.

    Args:
        labels: The N rows, for messages.
        rotations: Matrices, shape (N, 3, 3).
        rows: Which rows measure an orientation, shape (N,).

    Raises:
        MeasurementError: A matrix of these rows is not a rotation.
    """
    indices = np.flatnonzero(rows)
    wrong = indices[not_rotations(rotations[indices])]
    if wrong.size:
        what = "'rotations' holds no rotation; each is orthonormal with determinant 1"
        labels.fail(int(wrong[0]), what)


def check_torques(labels: RowLabels, torques: Array) -> None:
    """Refuse torques of a joint in some rows and not in others.

    Args:
        labels: The N rows, for messages.
        torques: shape (N, n) [Nm or N]; NaN where there is none.

    Raises:
        MeasurementError: A joint has torques in some rows only.
    """
    is_given = np.isfinite(torques)
    missing = np.argwhere(~is_given & is_given.any(axis=0))
    if missing.size:
        row, joint = missing[0].tolist()
        what = "has no torque here and has one in other rows; give all of them, or none"
        labels.fail(row, f"joint '{labels.joint_names[joint]}' {what}")


def checked_covariances(labels: RowLabels, values: ArrayLike | None, poses: Mask) -> Array | None:
    """Return a checked, read-only copy of the covariances of measured poses.

    Args:
        labels: The N rows, for messages.
        values: shape (N, 6, 6) [m^2, m rad, rad^2], NaN in rows without one; None: not given.
        poses: Which rows may have one, shape (N,).

    Returns:
        The covariances, symmetric to the last bit, NaN in other rows; None if no row has one.

    Raises:
        ArgumentError: The entries are not numbers.
        MeasurementError: Another shape, or a matrix that is zero, not symmetric or not positive definite, that lacks
            some of its numbers, or has a standard deviation that no instrument has.
    """
    if values is None:
        return None
    given = numbers("covariances", values, "of shape (N, 6, 6)")
    shape = (len(labels.rows), POSE, POSE)
    if given.shape != shape:
        raise MeasurementError(
            f"{labels.name}: 'covariances' has shape {given.shape} and should have {shape}"
        )
    with_one = ~np.isnan(given).all(axis=(1, 2)) & poses
    checked = checked_numbers(labels, "covariances", given, (POSE, POSE), with_one, _COVARIANCES)
    if checked is None:
        return None

    for i in np.flatnonzero(with_one).tolist():
        C = checked[i]
        if not np.any(C):
            labels.fail(i, "the covariance is zero; leave out the columns if it is not known")
        std = np.sqrt(np.maximum(np.diagonal(C), 0.0))
        if not np.all((std >= registry.SIGMAS[0]) & (std <= registry.SIGMAS[1])):
            allowed = f"{registry.SIGMAS[0]:g} to {registry.SIGMAS[1]:g}, in SI units"
            labels.fail(
                i,
                f"a standard deviation of the covariance is not from {allowed}. {_ENTRIES_ARE} Write numbers with an "
                "exponent, 1.234567e-08.",
            )
        correlation = C / np.outer(std, std)
        if np.max(np.abs(correlation - correlation.T)) > _SYMMETRIC:
            labels.fail(i, f"the covariance is not symmetric. {_ENTRIES_ARE}")
        if np.linalg.eigvalsh(0.5 * (correlation + correlation.T))[0] <= 0.0:
            labels.fail(
                i,
                f"the covariance is not positive definite. {_ENTRIES_ARE} Are all entries in this order, and written "
                "with six digits or more?",
            )
    return read_only(0.5 * (checked + checked.transpose(0, 2, 1)))


# Complete pairs and groups


def check_pairs(labels: RowLabels, pairs: Mapping[str, Sequence[int]], sets: Sequence[str]) -> None:
    """Check that each pair has two rows of one set.

    Args:
        labels: The rows, for messages.
        pairs: Indices of the rows of each pair, from 0, by the word that they share.
        sets: Set of each row.

    Raises:
        MeasurementError: A pair has another number of rows, or rows of two sets.
    """
    for word, indices in pairs.items():
        if len(indices) != 2 or sets[indices[0]] != sets[indices[1]]:
            fix = "a distance is between two rows of one set. Give each pair a word of its own."
            labels.fail_on(f"the pair '{word}'", indices, fix)


def check_groups(labels: RowLabels, kind: str, groups: Mapping[str, Sequence[int]]) -> None:
    """Check that groups have enough rows of a kind to determine their frames.

    Args:
        labels: The rows, for messages.
        kind: Name of the kind.
        groups: Indices of the rows of this kind, from 0, by group.

    Raises:
        MeasurementError: A group has fewer rows than `Kind.fewest`.
    """
    fewest = registry.get(kind).fewest
    for group, indices in groups.items():
        if len(indices) < fewest:
            fix = f"it takes {fewest} rows or more. Measure more, or correct the group's name."
            labels.fail_on(f"the group '{group}' of the kind '{kind}'", indices, fix)


def check_argument_types(given: object) -> None:
    """Refuse arguments of `Measurements` that are of another type.

    Args:
        given: The measurements, as they were given.

    Raises:
        ArgumentError: One of them is.
    """
    value = partial(getattr, given)
    for name in ("joint_names", "prismatic", "ignored", *WORD_COLUMNS):
        check_names(name, value(name))
    for name in ("rows", "unmeasured", "copies"):
        check_type(name, value(name), (Sequence, np.ndarray), "row numbers")
        for number in value(name):
            check_type(name, number, (int, np.integer), "whole numbers")
    check_mapping("readings", value("readings"))
    check_mapping("sigma", value("sigma"))
    for unit, std in value("sigma").items():
        numbers(f"sigma[{unit!r}]", std, "an array of standard deviations with an entry a row")
    for name in ("joints", "rotations", "distances", "torques", "covariances"):
        if value(name) is not None:
            numbers(name, value(name), "an array of numbers with an entry a row")
    check_type("references", value("references"), (References, type(None)), "References, or None")
    numbers("points", value("points"), "positions of shape (N, 3), [m]")
    if not np.ndim(value("points")):
        raise wrong_type("points", value("points"), "positions of shape (N, 3), [m]")


def check_reading(
    path: object, points: object, joint_names: object, joint_types: object, columns: object
) -> None:
    """Refuse arguments of `Measurements.read` that are of another type: ArgumentError, with the argument's name."""
    if not isinstance(path, Table):
        check_path("path", path)
    if joint_names is not None:
        check_names("joint_names", joint_names)
    if points is not None:
        check_path("points", points)
    for argument, mapping in (("joint_types", joint_types), ("columns", columns)):
        if mapping is not None and not isinstance(mapping, ColumnOptions):
            check_mapping(argument, mapping)
