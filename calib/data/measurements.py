"""Measurements: joint values and what was measured of the target there; CSV in and out."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import compress
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.data.kinds as registry
from calib.data.columns import COMMON, DEFAULT_TARGET, POINT, QUATERNION, SETS, TORQUE, reserved
from calib.data.geometry import FARTHEST, not_rotations, to_quaternions
from calib.data.kinds import SIGMAS, Kind
from calib.data.layout import Layout
from calib.data.points_file import read_points
from calib.data.table import Table
from calib.data.values import read_values
from calib.errors import MeasurementError, choices
from calib.files import csv_bytes, write_atomically
from calib.robot.robot import read_only
from calib.units import UNITS, Array, Mask, Quantity

#: The words of a row, by the attribute, and what stands for them where they are not given.
_WORDS = {"sets": SETS[0], "targets": DEFAULT_TARGET, "groups": "", "kinds": "point", "pairs": ""}

#: The arrays with an entry a row.
_ARRAYS = ("joints", "points", "sigma", "rotations", "distances", "sigma_angle", "torques")

# Two rows that share a distance have it to all digits of a table [m].
_AGREE_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N rows: the joint values of the robot and what was measured of the target there.

    What a row measures is its kind, one of `calib.data.kinds`: ``point``, ``pose``, ``distance``, ``pair``, ``fixed``,
    ``plane``, or one that was registered. What it does not measure is NaN, whatever was given; an array of which
    nothing is left is None. Arrays are read-only; words are one a row.

    Raises:
        MeasurementError: a shape, a value or a word does not fit.
    """

    joint_names: tuple[str, ...]  #: The order of the columns of ``joints``.
    joints: Array  #: Joint values, shape (N, n), [rad] or, for ``prismatic`` joints, [m].
    points: Array  #: Measured positions of the targets in the measurement frame, shape (N, 3), [m].
    #: ``"estimate"`` or ``"validate"``; all ``"estimate"`` when not given.
    sets: tuple[str, ...] = ()
    sigma: Array | None = None  #: Standard deviation of one coordinate or length, shape (N,), [m].
    targets: tuple[str, ...] = ()  #: The target's name; ``"target"`` when not given.
    groups: tuple[str, ...] = ()  #: The set-up's name; ``""`` when not given.
    rows: tuple[int, ...] = ()  #: The row numbers a person sees, unique; 1 to N when not given.
    source: str = ""  #: The file's name, for messages.
    sha256: str = ""  #: Of the file's bytes, ``"... + ..."`` of two files.
    ignored: tuple[str, ...] = ()  #: The headers of the table's columns that were not used.
    prismatic: tuple[str, ...] = ()  #: The names of those joints whose values are lengths.
    kinds: tuple[str, ...] = ()  #: All ``"point"`` when not given.
    rotations: Array | None = None  #: Measured R_frame_target, shape (N, 3, 3).
    distances: Array | None = None  #: Shape (N,), [m]; both rows of a pair have it.
    sigma_angle: Array | None = None  #: Of an orientation about one axis, shape (N,), [rad].
    pairs: tuple[str, ...] = ()  #: The word that two rows of a paired kind share; ``""`` in others.
    #: What drives put on the joints, positive along the axis, shape (N, n), [Nm] ([N]); NaN for joints without.
    torques: Array | None = None
    #: What kinds from outside measure, shape (N,) each, in SI units, by the column's name.
    readings: Mapping[str, Array] = field(default_factory=dict)
    unmeasured: tuple[int, ...] = ()  #: The numbers of rows left out, for they hold no measurement.
    copies: tuple[int, ...] = ()  #: Those of rows left out by `without_copies`.

    def __post_init__(self) -> None:
        """Copy the arrays, fill in what was not given, and check that all of it fits together."""
        fill, count = partial(object.__setattr__, self), len(np.asarray(self.points))
        for name in ("joint_names", "prismatic", "ignored", "unmeasured", "copies"):
            fill(name, tuple(getattr(self, name)))
        fill("rows", tuple(self.rows) or tuple(range(1, count + 1)))
        for name, word in _WORDS.items():
            fill(name, tuple(getattr(self, name)) or (word,) * count)
        self._check_words(count)
        if any(self.pairs):
            told = zip(self.paired.tolist(), self.pairs, strict=True)
            fill("pairs", tuple(word if paired else "" for paired, word in told))
        n, every = len(self.joint_names), np.ones(count, dtype=np.bool_)
        turned, angled = self.where(lambda k: k.orientation), self.where(lambda k: k.angles > 0)
        reach, readings = (-FARTHEST, FARTHEST), self._checked_readings()
        for name, tail, told_by, limits in (
            ("joints", (n,), every, reach),
            ("points", (3,), self.positions, reach),
            ("rotations", (3, 3), turned, reach),
            ("sigma", (), every, SIGMAS),
            ("sigma_angle", (), angled, SIGMAS),
        ):
            array = self._numbers(name, getattr(self, name), tail, told_by, limits)
            if array is None and name in ("joints", "points"):
                array = read_only(np.full((count, *tail), np.nan))
            fill(name, array)
        if self.rotations is not None:
            for i in np.flatnonzero(turned)[not_rotations(self.rotations[turned])]:
                what = "'rotations' holds no rotation; each is orthonormal with determinant 1"
                self._fail(int(i), what)
        if self.torques is not None:
            fill("torques", read_only(self.torques))
            there = np.isfinite(self.torques)
            for i, k in np.argwhere(~there & there.any(axis=0)):
                what = "has no torque here and has one in other rows; give all of them, or none"
                self._fail(int(i), f"joint '{self.joint_names[k]}' {what}")
        fill("distances", readings.pop("distance", None))
        fill("readings", MappingProxyType(readings))

    def _fail(self, row: int, what: str) -> NoReturn:
        """Refuse a row, from 0."""
        raise MeasurementError(f"{self.source or 'Measurements'}, row {self.rows[row]}: {what}")

    def _check_words(self, count: int) -> None:
        """Refuse words that are not allowed, row numbers and names of joints that are not unique."""
        source = self.source or "Measurements"
        for name in (*_WORDS, "rows"):
            number = len(getattr(self, name))
            if number != count:
                raise MeasurementError(
                    f"{source}: '{name}' has {number} entries and should have {count}, one a row"
                )
        for name, allowed in (("set", SETS), ("kind", registry.names())):
            words = getattr(self, f"{name}s")
            for word in set(words) - set(allowed):
                what = f"column '{name}': '{word}' is none of {choices(allowed)}."
                self._fail(words.index(word), what)
        if len(set(self.rows)) < count:
            twice = Counter(self.rows).most_common(1)[0][0]
            raise MeasurementError(
                f"{source}: the row number {twice} stands there twice; each row has its own"
            )
        taken = [n for n, k in Counter(self.joint_names).items() if k > 1 or n in reserved()]
        if taken:
            raise MeasurementError(
                f"{source}: joint names are unique and no other column's; given were {choices(taken)}"
            )

    def _numbers(
        self,
        name: str,
        values: ArrayLike | None,
        tail: tuple[int, ...],
        told: Mask,
        limits: tuple[float, float],
    ) -> Array | None:
        """A read-only copy of an array (N, *tail), NaN in rows that do not measure it; None if none is left."""
        if not told.any() or (values is None and name.startswith("sigma")):
            return None
        if values is None:
            i = int(np.argmax(told))
            self._fail(i, f"a row of the kind '{self.kinds[i]}' needs '{name}', and there are none")
        array = np.array(values, dtype=np.float64)
        if array.shape != (len(told), *tail):
            raise MeasurementError(
                f"Measurements: '{name}' has shape {array.shape} and should have {(len(told), *tail)}"
            )
        good = (array >= limits[0]) & (array <= limits[1])
        for at in np.argwhere(~good & told.reshape(-1, *(1 for _ in tail)))[:1].tolist():
            what = self.joint_names[at[1]] if name == "joints" else name
            self._fail(
                at[0],
                f"'{what}' is {array[tuple(at)]:g}; in a row of the kind '{self.kinds[at[0]]}' it is a number from "
                f"{limits[0]:g} to {limits[1]:g}, in SI units. Correct it, or its unit.",
            )
        array[~told] = np.nan
        return read_only(array)

    def _checked_readings(self) -> dict[str, Array]:
        """What kinds read in columns of their own, by the column's name; of a pair both rows have it."""
        given, read = {"distance": self.distances, **self.readings}, registry.readings()
        strange = given.keys() - read.keys()
        if strange:
            raise MeasurementError(
                f"No kind of measurement reads {choices(strange)}; register it first (calib.data.kinds.register)."
            )
        found: dict[str, Array] = {}
        for name, one in read.items():
            values = given.get(name)
            if values is not None:
                values = np.array(values, dtype=np.float64)
                for pair in self.pair_rows:
                    first, second = values[pair]
                    if abs(first - second) > _AGREE_M:
                        what = f"its pair has {first:.10g} m here and {second:.10g} m in row {self.rows[pair[1]]}"
                        self._fail(int(pair[0]), f"{what}; give it once, or the same")
                    values[pair] = second if np.isnan(first) else first
            least = SIGMAS[0] if one.positive else -FARTHEST
            own = self.of_kind(*(k for k in registry.names() if one in registry.get(k).readings))
            array = self._numbers(name, values, (), own, (least, FARTHEST))
            if array is not None:
                found[name] = array
        return found

    def _check_whole(self) -> None:
        """Refuse a table without rows to estimate from, pairs of other than two rows, groups of too few."""
        if not self.estimation.any():
            raise MeasurementError(
                f"{self.source}, column 'set': no measured row is 'estimate', all {len(self)} are 'validate'. Mark "
                "those to estimate from, or remove the column."
            )

        def refuse(what: str, at: Sequence[int], fix: str) -> NoReturn:
            """Name the rows, from 0, that do not make a whole."""
            rows = ", ".join(str(self.rows[i]) for i in at[:8])
            many = "s" * (len(at) > 1)
            raise MeasurementError(f"{self.source}: {what} stands in row{many} {rows}; {fix}")

        for word, at in self._by_word(self.pairs, self.paired).items():
            if len(at) != 2 or self.sets[at[0]] != self.sets[at[1]]:
                fix = "a distance is between two rows of one set. Give each pair a word of its own."
                refuse(f"the pair '{word}'", at, fix)
        for kind in set(self.kinds):
            fewest = registry.get(kind).fewest
            for group, at in self._by_word(self.groups, self.of_kind(kind)).items():
                if len(at) < fewest:
                    fix = f"it takes {fewest} rows or more. Measure more, or correct the group's name."
                    refuse(f"the group '{group}' of the kind '{kind}'", at, fix)

    @staticmethod
    def _by_word(words: Sequence[str], chosen: Mask) -> dict[str, list[int]]:
        """The chosen rows, from 0, by a word of theirs."""
        found: dict[str, list[int]] = {}
        for i in np.flatnonzero(chosen).tolist():
            found.setdefault(words[i], []).append(i)
        return found

    def where(self, test: Callable[[Kind], bool]) -> Mask:
        """True for the rows of kinds that pass a test, shape (N,), read-only."""
        return _mask(self.kinds, *(n for n in registry.names() if test(registry.get(n))))

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back: a read-only mapping travels as a dict."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return partial(Measurements, **{**values, "readings": dict(self.readings)}), ()

    @classmethod
    def read(
        cls,
        path: str | Path | Table,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
        kind: str | None = None,
        points: str | Path | None = None,
        points_unit: str | None = None,
    ) -> Measurements:
        """Read a table with units in its header; docs/data-format.md describes it.

        Args:
            path: a CSV file in UTF-8, separated by commas, semicolons or tabs; or one that was read already.
            joint_names: the joints to read, each of which must have a column; None reads every
                column in a unit of angle that is not of an orientation.
            joint_types: a joint's URDF type by its name; a ``"prismatic"`` joint is in a unit of
                length, any other in one of angle.
            columns: names of the table to names of calib, ``{"J1": "shoulder_pan_joint"}``; with
                a unit, ``{"J1": "shoulder_pan_joint [deg]"}``, for a column that has none; ``"-"``
                leaves a column out; several columns may be mapped to ``"group"``.
            kind: the kind of all rows; None takes it from a column ``kind``, else from the columns
                that there are.
            points: a list of measured points, such as laser tracker programs write, see `read_points`: the
                table's column ``point`` names the point of each row; without one they are in its order.
            points_unit: the unit of that list, where it names none.

        Raises:
            MeasurementError: the table cannot be read; the text names the file, row and column.
        """
        elsewhere = None if points is None else read_points(points, points_unit)
        table = path if isinstance(path, Table) else Table.read(path)
        layout = Layout.find(
            table, joint_names, joint_types, columns, kind, points_elsewhere=elsewhere is not None
        )
        measurements = cls(**read_values(table, layout, elsewhere))
        measurements._check_whole()
        return measurements

    def __repr__(self) -> str:
        """In one line, such as ``Measurements(35 rows of 6 joints from ur3_leica.csv)``."""
        where = f" from {self.source}" if self.source else ""
        return f"Measurements({len(self)} rows of {len(self.joint_names)} joints{where})"

    def __len__(self) -> int:
        """The number of rows, N."""
        return len(self.points)

    @property
    def estimation(self) -> Mask:
        """True for the rows to estimate from, shape (N,), read-only."""
        return _mask(self.sets, "estimate")

    @property
    def validation(self) -> Mask:
        """True for the rows held back to validate with, shape (N,), read-only."""
        return _mask(self.sets, "validate")

    def of_kind(self, *kinds: str) -> Mask:
        """True for the rows of these kinds, shape (N,), read-only."""
        return _mask(self.kinds, *kinds)

    def reading(self, name: str) -> Array:
        """What stands in a column that some kind reads, such as ``"distance"``, shape (N,), in SI units."""
        found = self.distances if name == "distance" else self.readings.get(name)
        return np.full(len(self), np.nan) if found is None else found

    @property
    def paired(self) -> Mask:
        """True for the rows of which two give one measurement, shape (N,), read-only."""
        return self.where(lambda kind: kind.paired)

    @property
    def positions(self) -> Mask:
        """True for the rows that measure a position, shape (N,), read-only."""
        return self.where(lambda kind: kind.position)

    @property
    def pair_rows(self) -> NDArray[np.intp]:
        """The two rows of each pair, from 0, shape (P, 2), read-only; pairs that have lost a row are left out."""
        both = [at for at in self._by_word(self.pairs, self.paired).values() if len(at) == 2]
        pairs = np.array(both, dtype=np.intp).reshape(-1, 2)
        pairs.setflags(write=False)
        return pairs

    @staticmethod
    def columns_of(kind: Kind, measured: Array) -> dict[str, Any]:
        """The arguments of `Measurements` that hold what rows of one kind measure, shape (n, k), see `Kind`."""
        found: dict[str, Any] = {"points": np.full((len(measured), 3), np.nan)}
        if kind.position:
            found["points"] = measured[:, :3]
        if kind.orientation:
            found["rotations"] = measured[:, 3:12].reshape(-1, 3, 3)
        own = measured[:, kind.size - len(kind.readings) :].T
        read = {one.name: values for one, values in zip(kind.readings, own, strict=True)}
        return {**found, "distances": read.pop("distance", None), "readings": read}

    def select(self, mask: ArrayLike) -> Measurements:
        """The rows where ``mask``, shape (N,), is True, with their numbers; a pair may lose one of its rows."""
        chosen = np.asarray(mask, dtype=np.bool_)
        here = chosen.tolist()
        left: dict[str, Any] = {
            name: tuple(compress(getattr(self, name), here)) for name in (*_WORDS, "rows")
        }
        for name in _ARRAYS:
            values = getattr(self, name)
            left[name] = None if values is None else values[chosen]
        left["readings"] = {name: values[chosen] for name, values in self.readings.items()}
        return replace(self, **left)

    def without_copies(self) -> Measurements:
        """Without rows that are another one to the last digit, joint values and measurement, as no repeats are."""
        arrays = (self.joints, self.points, self.rotations, self.distances, *self.readings.values())
        numbers = np.hstack([a.reshape(len(self), -1) for a in arrays if a is not None])
        words = zip(self.kinds, self.groups, self.targets, strict=True)
        every = [(*own, row.tobytes()) for own, row in zip(words, numbers, strict=True)]
        first = {key: i for i, key in reversed([*enumerate(every)])}
        copy = np.array([first[key] < i for i, key in enumerate(every)]) & ~self.paired
        copy &= self.where(lambda kind: kind.size > 0)
        copies = tuple(compress(self.rows, copy.tolist()))
        return replace(self.select(~copy), copies=copies) if copies else self

    def joints_for(self, names: Sequence[str]) -> Array:
        """The values of these joints in this order, shape (N, len(names)), [rad] or [m], read-only.

        Raises:
            MeasurementError: there is no such joint in the table.
        """
        where = {name: i for i, name in enumerate(self.joint_names)}
        missing = [name for name in names if name not in where]
        if missing:
            raise MeasurementError(
                f"{self.source or 'the measurements'}: no values of the joints {choices(missing)}. "
                f"The joints there are: {choices(self.joint_names, limit=30)}."
            )
        return read_only(self.joints[:, [where[name] for name in names]])

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a CSV table in degrees and millimetres that `read` gives back.

        Numbers come back to the last bit where they came from a table in these units, to 1e-15 of them where not, as
        for hardly any number of radians are there degrees that are it exactly. Orientations come back to 1e-15.

        Raises:
            FileError: the file exists and ``overwrite`` is False, or it cannot be written.
        """
        columns: dict[str, Sequence[object]] = {
            "row": self.rows,
            "set": self.sets,
            **({"kind": self.kinds} if set(self.kinds) - {"point"} else {}),
            **({"target": self.targets} if set(self.targets) - {DEFAULT_TARGET} else {}),
            **{n: w for n, w in (("group", self.groups), ("pair", self.pairs)) if any(w)},
        }

        def add(name: str, quantity: Quantity | None, values: Array | None) -> None:
            """Add a column of numbers if there are any; its cells are empty where nothing was measured."""
            if values is None or (len(values) and np.isnan(values).all()):
                return
            unit = "" if quantity is None else COMMON[quantity]
            to_si = UNITS[unit].to_si if unit else 1.0
            written = values / to_si
            plain = np.array([float(f"{number:.15g}") for number in written])  # as a table had it
            written = np.where(plain * to_si == values, plain, written).tolist()
            cells = ["" if math.isnan(number) else number for number in written]
            columns[f"{name} [{unit}]" if unit else name] = cells

        for i, name in enumerate(self.joint_names):
            slides = name in self.prismatic
            add(name, "length" if slides else "angle", self.joints[:, i])
            if self.torques is not None:
                add(name + TORQUE, "force" if slides else "torque", self.torques[:, i])
        for i, name in enumerate(POINT):
            add(name, "length", self.points[:, i])
        if self.rotations is not None:
            for name, part in zip(QUATERNION, to_quaternions(self.rotations).T, strict=True):
                add(name, None, part)
        for one in registry.readings().values():
            add(one.name, one.quantity, self.reading(one.name) if len(self) else None)
        add("sigma", "length", self.sigma)
        add("sigma_angle", "angle", self.sigma_angle)
        rows = [columns, *zip(*columns.values(), strict=True)]
        write_atomically(path, csv_bytes(rows), overwrite=overwrite)


def _mask(words: Sequence[str], *wanted: str) -> Mask:
    """True where a word is one of those wanted, read-only."""
    there = set(words)  # mostly one
    if there <= set(wanted) or there.isdisjoint(wanted):
        mask = np.full(len(words), not there.isdisjoint(wanted), dtype=np.bool_)
    else:
        mask = np.array([word in wanted for word in words], dtype=np.bool_)
    mask.setflags(write=False)
    return mask
