"""What must hold of `Measurements`: shapes, names, values; and, of a whole table, pairs and groups."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, choices
from calib.measure.columns import QUATERNION, RESERVED, SETS, TORQUE
from calib.measure.kinds import FEWEST, KINDS, LENGTHS, POSITIONS
from calib.measure.orientation import no_rotation

# No instrument is better or worse than this [m or rad], and squares beyond it leave the range of numbers.
SIGMAS = (1e-15, 1e6)

# Beyond this [m or rad] doubles are further apart than what calib computes to, and no robot gets there.
FARTHEST = 1e6

# Two rows that share a distance have it to all digits of a table.
AGREE_M = 1e-9


class _Rows(Protocol):
    """What is looked at: fields of `Measurements`, which imports this module."""

    @property
    def source(self) -> str: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def prismatic(self) -> tuple[str, ...]: ...
    @property
    def sets(self) -> tuple[str, ...]: ...
    @property
    def targets(self) -> tuple[str, ...]: ...
    @property
    def groups(self) -> tuple[str, ...]: ...
    @property
    def kinds(self) -> tuple[str, ...]: ...
    @property
    def pairs(self) -> tuple[str, ...]: ...
    @property
    def rows(self) -> tuple[int, ...]: ...
    @property
    def joints(self) -> NDArray[np.float64]: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def rotations(self) -> NDArray[np.float64] | None: ...
    @property
    def distances(self) -> NDArray[np.float64] | None: ...
    @property
    def torques(self) -> NDArray[np.float64] | None: ...
    def of_kind(self, *kinds: str) -> NDArray[np.bool_]: ...
    def __len__(self) -> int: ...


def check_shapes(m: _Rows) -> None:
    """Refuse arrays and tuples that do not have one entry a row.

    Raises:
        MeasurementError: with the shape there is and the one wanted.
    """
    count = m.points.shape[0] if m.points.ndim else 0
    n = len(m.joint_names)
    shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}
    expected: tuple[tuple[str, tuple[int, ...]], ...] = (
        ("points", (count, 3)),
        ("joints", (count, n)),
        ("sigma", (count,)),
        ("rotations", (count, 3, 3)),
        ("distances", (count,)),
        ("sigma_angle", (count,)),
        ("torques", (count, n)),
    )
    for name, wanted in expected:
        values = getattr(m, name)
        if values is not None:
            shapes[name] = (values.shape, wanted)
    for name in ("sets", "targets", "groups", "rows", "kinds", "pairs"):
        shapes[name] = ((len(getattr(m, name)),), (count,))
    for name, (shape, right) in shapes.items():
        if shape != right:
            message = (
                f"Measurements: '{name}' has shape {shape} and should have {right}: "
                f"{count} rows of points, {n} joint names"
            )
            raise MeasurementError(message)


def check_names(m: _Rows) -> None:
    """Refuse names and words that a table cannot hold or that mean nothing.

    Raises:
        MeasurementError: with the names and, for words, the row.
    """
    source = m.source or "Measurements"
    names = m.joint_names
    taken = (*RESERVED, *(QUATERNION if "pose" in m.kinds else ()))
    if m.torques is not None:
        taken += tuple(name + TORQUE for name in names)
    counts = Counter(names)
    bad = [n for n in names if n in taken or not is_name(n) or counts[n] > 1]
    if bad or not names:
        message = (
            f"{source}: joint names are unique, on one line, without blanks around them, and none "
            f"of {choices(taken, limit=30)}; given were {choices(bad or ['no names at all'])}"
        )
        raise MeasurementError(message)
    strange = [name for name in m.prismatic if name not in names]
    if strange:
        message = f"{source}: 'prismatic' names {choices(strange)}; the joints are {choices(names)}"
        raise MeasurementError(message)
    _check_words(m, source)


def _check_words(m: _Rows, source: str) -> None:
    """Refuse words that are not allowed; each different one is looked at once, for there may be a million rows."""
    strange = {word for word in set(m.sets) if word not in SETS}
    no_targets = {target for target in set(m.targets) if not is_name(target)}
    no_groups = {group for group in set(m.groups) if not (group == "" or is_name(group))}
    unknown = {kind for kind in set(m.kinds) if kind not in KINDS}
    pairs = "pair" in m.kinds
    if not (strange or no_targets or no_groups or unknown or pairs):
        return
    for row, word, target, group in zip(m.rows, m.sets, m.targets, m.groups, strict=True):
        if word in strange:
            message = f"{source}, row {row}: the set '{word}' is neither of {choices(SETS)}"
            raise MeasurementError(message)
        if target in no_targets or group in no_groups:
            message = (
                f"{source}, row {row}: target {target!r} and group {group!r} are names on one "
                "line, without blanks around them; only the group may be empty"
            )
            raise MeasurementError(message)
    for row, kind, pair in zip(m.rows, m.kinds, m.pairs, strict=True):
        if kind in unknown:
            message = f"{source}, row {row}: the kind '{kind}' is none of {choices(KINDS)}"
            raise MeasurementError(message)
        if kind == "pair" and not is_name(pair):
            message = (
                f"{source}, row {row}: the pair '{pair}' is a word on one line, without blanks "
                "around it, that two rows of the kind 'pair' share"
            )
            raise MeasurementError(message)


def is_name(text: str) -> bool:
    """Whether a text is one line and not empty, without blanks around it, such as a text file can hold."""
    return text != "" and text == text.strip() and len(text.splitlines()) == 1 and "\0" not in text


def check_values(m: _Rows) -> None:
    """Refuse numbers that are not finite where the kind of row measures them, and row numbers given twice.

    Raises:
        MeasurementError: with the row and the value.
    """
    source = m.source or "Measurements"
    strange = set(map(type, m.rows)) - {int}
    broken = [row for row in m.rows if strange and not isinstance(row, (int, np.integer))]
    if broken:
        message = (
            f"{source}: the row number {broken[0]!r} is no integer; row numbers are whole numbers"
        )
        raise MeasurementError(message)
    if len(set(m.rows)) < len(m.rows):
        twice = Counter(m.rows).most_common(1)[0][0]
        message = f"{source}: the row number {twice} is there twice; row numbers are unique"
        raise MeasurementError(message)
    every = np.ones(len(m), dtype=np.bool_)
    _check_numbers(m, "joints", every)
    _check_numbers(m, "points", m.of_kind(*POSITIONS))
    _check_numbers(m, "sigma", every, positive=True)
    _check_numbers(m, "sigma_angle", m.of_kind("pose"), positive=True)
    _check_sigmas(m, "sigma", "m", every)
    _check_sigmas(m, "sigma_angle", "rad", m.of_kind("pose"))
    _check_numbers(m, "distances", m.of_kind(*LENGTHS), positive=True)
    _check_reach(m)
    _check_rotations(m)
    _check_torques(m)


def _check_reach(m: _Rows) -> None:
    """Refuse joint values, points and distances so large that their digits no longer tell a position."""
    names = {"joints": m.joint_names, "points": "xyz", "distances": None}
    for name, columns in names.items():
        values = getattr(m, name)
        if values is None:
            continue
        wrong = np.argwhere(np.abs(values) > FARTHEST)  # what a row's kind does not use may be NaN
        if len(wrong):
            at = tuple(int(i) for i in wrong[0])
            what = columns[at[1]] if columns else "distance"
            unit = "rad" if name == "joints" and what not in m.prismatic else "m"
            message = (
                f"{m.source or 'Measurements'}, row {m.rows[at[0]]}: '{what}' is {values[at]:g} {unit}; no robot gets "
                f"beyond {FARTHEST:g} {unit}. Correct the value, or its unit."
            )
            raise MeasurementError(message)


def _check_numbers(m: _Rows, name: str, rows: NDArray[np.bool_], *, positive: bool = False) -> None:
    """Refuse values that are not finite, or not positive, in these rows."""
    values = getattr(m, name)
    if values is None:
        return
    good = np.isfinite(values) & (values > 0.0) if positive else np.isfinite(values)
    wrong = ~good & rows.reshape((-1,) + (1,) * (values.ndim - 1))
    if wrong.any():
        at = tuple(int(i) for i in np.argwhere(wrong)[0])
        what = "positive and finite" if positive else "finite"
        where = f"{m.source or 'Measurements'}, row {m.rows[at[0]]}"
        kind = "" if m.kinds[at[0]] == "point" else f" in a row of the kind '{m.kinds[at[0]]}'"
        message = f"{where}: '{name}' holds {values[at]}; every value{kind} is {what}"
        raise MeasurementError(message)


def _check_sigmas(m: _Rows, name: str, unit: str, rows: NDArray[np.bool_]) -> None:
    """Refuse standard deviations that no instrument has."""
    values = getattr(m, name)
    if values is None:
        return
    wrong = np.flatnonzero(rows & ~((values >= SIGMAS[0]) & (values <= SIGMAS[1])))
    if wrong.size:
        i = int(wrong[0])
        message = (
            f"{m.source or 'Measurements'}, row {m.rows[i]}: '{name}' is {values[i]:g} {unit}; no instrument has one "
            f"below {SIGMAS[0]:g} or above {SIGMAS[1]:g} {unit}. Correct it, or leave the column out: the noise is "
            "found from the data."
        )
        raise MeasurementError(message)


def _check_rotations(m: _Rows) -> None:
    """Refuse matrices that are no rotations, and poses without any."""
    poses = np.flatnonzero(m.of_kind("pose"))
    for needed, rows, name in (
        (m.rotations, poses, "rotations"),
        (m.distances, np.flatnonzero(m.of_kind(*LENGTHS)), "distances"),
    ):
        if rows.size and needed is None:
            i = int(rows[0])
            message = (
                f"{m.source or 'Measurements'}, row {m.rows[i]}: a row of the kind '{m.kinds[i]}' "
                f"needs '{name}', and there are none"
            )
            raise MeasurementError(message)
    if m.rotations is None:
        return
    wrong = poses[no_rotation(m.rotations[poses])]
    if wrong.size:
        message = (
            f"{m.source or 'Measurements'}, row {m.rows[wrong[0]]}: 'rotations' holds a matrix that "
            "is no rotation; each is orthonormal with determinant 1"
        )
        raise MeasurementError(message)


def _check_torques(m: _Rows) -> None:
    """Refuse a joint that has a torque in some rows only."""
    if m.torques is None:
        return
    there = np.isfinite(m.torques)
    for name, column in zip(m.joint_names, there.T, strict=True):
        if column.any() and not column.all():
            row = m.rows[int(np.argmin(column))]
            message = (
                f"{m.source or 'Measurements'}, row {row}: joint '{name}' has no torque here and has "
                "one in other rows; give all of them, or none of the joint (NaN)"
            )
            raise MeasurementError(message)


def share_distances(m: _Rows) -> NDArray[np.float64] | None:
    """The distances with each one that stands in one row of a pair copied into the other, shape (N,), [m].

    Raises:
        MeasurementError: the two rows of a pair have different distances.
    """
    if m.distances is None or "pair" not in m.kinds:
        return m.distances
    distances = np.array(m.distances)
    for word, (first, second) in two_rows(m).items():
        one, other = distances[first], distances[second]
        if abs(one - other) > AGREE_M:
            message = (
                f"{m.source or 'Measurements'}: the pair '{word}' has the distance {one * 1e3:.10g} mm "
                f"in row {m.rows[first]} and {other * 1e3:.10g} mm in row {m.rows[second]}; give it "
                "once, or the same"
            )
            raise MeasurementError(message)
        distances[first] = other if np.isnan(one) else one
        distances[second] = one if np.isnan(other) else other
    return distances


def two_rows(m: _Rows) -> dict[str, tuple[int, int]]:
    """The two rows of each pair, from 0, by its word; pairs that have lost a row are left out."""
    return {
        word: (at[0], at[1]) for word, at in _by_word(m, "pair", m.pairs).items() if len(at) == 2
    }


def _by_word(m: _Rows, kind: str, words: Sequence[str]) -> dict[str, list[int]]:
    """The rows of one kind, from 0, by a word of theirs."""
    found: dict[str, list[int]] = {}
    if kind not in m.kinds:
        return found
    for i, (each, word) in enumerate(zip(m.kinds, words, strict=True)):
        if each == kind:
            found.setdefault(word, []).append(i)
    return found


def check_whole(m: _Rows) -> None:
    """Refuse, in a table as it was read, pairs of other than two rows and groups with too few.

    A selection of rows may have both.

    Raises:
        MeasurementError: with the word or the group, and its rows.
    """
    for word, at in _by_word(m, "pair", m.pairs).items():
        where = f"{m.source}: the pair '{word}' stands in {_name_rows(m, at)}"
        if len(at) != 2:
            message = f"{where}; a distance is between two rows. Give each pair a word of its own."
            raise MeasurementError(message)
        if m.sets[at[0]] != m.sets[at[1]]:
            message = f"{where}, one 'estimate', one 'validate'. Put both into one set."
            raise MeasurementError(message)
    _check_groups(m, FEWEST)


def _check_groups(m: _Rows, fewest: Mapping[str, int]) -> None:
    """Refuse groups whose unknown point or plane fits whatever the robot does."""
    for kind, count in fewest.items():
        for group, at in _by_word(m, kind, m.groups).items():
            if len(at) < count:
                message = (
                    f"{m.source}: the group '{group}' of the kind '{kind}' stands in {_name_rows(m, at)}"
                    f"; it takes {count} rows or more to say anything of the robot. Measure more, "
                    "correct the group's name, or remove it."
                )
                raise MeasurementError(message)


def _name_rows(m: _Rows, at: Sequence[int]) -> str:
    """These rows, from 0, by their numbers."""
    numbers = [str(m.rows[i]) for i in at[:8]] + (["..."] if len(at) > 8 else [])
    return f"row {numbers[0]} only" if len(at) == 1 else f"rows {', '.join(numbers)}"
