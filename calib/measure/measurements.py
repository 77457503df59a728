"""Measurements: joint values and what was measured of the target there; CSV in and out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import compress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.errors import MeasurementError, choices
from calib.kinds import Kind
from calib.measure import checks
from calib.measure.columns import DEFAULT_TARGET, SETS
from calib.measure.layout import Layout
from calib.measure.points_file import read_points
from calib.measure.table import Table
from calib.measure.table_text import table_text
from calib.measure.values import Values
from calib.model.files import write_atomically

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N rows: the joint values of the robot and what was measured of the target there.

    What a row measures is its kind, one of `calib.kinds`: ``point``, ``pose``, ``distance``, ``pair``, ``fixed``,
    ``plane``, or one that was registered. What it does not measure is NaN, whatever was given; an array of which
    nothing is left is None.

    Attributes:
        joint_names: the order of the columns of ``joints``.
        joints: joint values, shape (N, n), [rad] or, for ``prismatic`` joints, [m]. Read-only.
        points: measured target positions in the measurement frame, shape (N, 3), [m]. Read-only.
        sets: ``"estimate"`` or ``"validate"`` per row; all ``"estimate"`` when not given.
        sigma: standard deviation of one coordinate or length, shape (N,), [m], read-only; or None.
        targets: the target's name per row; ``"target"`` when not given.
        groups: the set-up's name per row; ``""`` when not given.
        rows: the row numbers a person sees, unique; 1 to N when not given.
        source: the file's name, for messages.
        sha256: of the file's bytes, ``"... + ..."`` of two files; ``""`` when not from a file.
        ignored: the headers of the table's columns that were not used.
        prismatic: the names of those joints whose values are lengths.
        kinds: the kind per row; all ``"point"`` when not given.
        rotations: measured R_frame_target, shape (N, 3, 3), read-only; None without poses.
        distances: measured distances, shape (N,), [m], read-only; None without. Both rows of a pair have it.
        sigma_angle: standard deviation of an orientation about one axis, shape (N,), [rad], read-only; or None.
        pairs: the word that two rows of the kind ``pair`` share; ``""`` in other rows.
        torques: torques (forces) that the drives put on the joints, positive along the axis, shape (N, n),
            [Nm] ([N]), read-only; NaN for joints without; or None.
        readings: what kinds from outside measure, shape (N,) each, in SI units, by the column's name, read-only.
        unmeasured: the numbers of the table's rows that are left out, for they hold no measurement.

    Raises:
        MeasurementError: a shape, a value or a word does not fit.
    """

    joint_names: tuple[str, ...]
    joints: NDArray[np.float64]
    points: NDArray[np.float64]
    sets: tuple[str, ...] = ()
    sigma: NDArray[np.float64] | None = None
    targets: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    rows: tuple[int, ...] = ()
    source: str = ""
    sha256: str = ""
    ignored: tuple[str, ...] = ()
    prismatic: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    rotations: NDArray[np.float64] | None = None
    distances: NDArray[np.float64] | None = None
    sigma_angle: NDArray[np.float64] | None = None
    pairs: tuple[str, ...] = ()
    torques: NDArray[np.float64] | None = None
    readings: Mapping[str, Array] = field(default_factory=dict)
    unmeasured: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Copy the arrays, fill in what was not given, and check that all of it fits together."""
        fill = object.__setattr__
        count = len(np.asarray(self.points))
        for name in ("joint_names", "prismatic", "ignored", "unmeasured"):
            fill(self, name, tuple(getattr(self, name)))
        fill(self, "rows", tuple(self.rows) or tuple(range(1, count + 1)))
        for name, word in _WORDS.items():
            fill(self, name, tuple(getattr(self, name)) or (word,) * count)
        self._check_words(count)
        if any(self.pairs):
            told = zip(self.paired.tolist(), self.pairs, strict=True)
            fill(self, "pairs", tuple(word if paired else "" for paired, word in told))
        for name, array in self._checked_arrays().items():
            fill(self, name, array)

    def _check_words(self, count: int) -> None:
        """Refuse words that are not allowed, and other than one of them a row."""
        words = {name: getattr(self, name) for name in _WORDS}
        for name, values in (*words.items(), ("rows", self.rows)):
            if len(values) != count:
                raise MeasurementError(
                    f"Measurements: '{name}' has {len(values)} entries and should have {count}, one a row"
                )
        checks.check_words(self._where, words)
        checks.check_row_numbers(self.source or "Measurements", self.rows)
        checks.check_joint_names(
            self.source or "Measurements",
            self.joint_names,
            self.prismatic,
            turned=bool(self.where(lambda kind: kind.orientation).any()),
            torques=self.torques is not None,
        )

    def _checked_arrays(self) -> dict[str, Any]:
        """The arrays, each with the rows whose kinds measure it."""
        where, n, read = self._where, len(self.joint_names), registry.readings()
        every = np.ones(len(self.rows), dtype=np.bool_)
        own = {name: self.where(_reads(one)) for name, one in read.items()}
        own["rotations"] = self.where(lambda kind: kind.orientation)
        specs: dict[str, tuple[Any, ...]] = {
            "joints": ((n,), every, checks.REACH, self.joint_names),
            "points": ((3,), self.positions, checks.REACH, "xyz"),
            "rotations": ((3, 3), own["rotations"]),
            "sigma": ((), every, checks.SIGMAS),
            "sigma_angle": ((), self.where(lambda kind: kind.angles > 0), checks.SIGMAS),
        }
        for name, one in read.items():
            least = checks.SIGMAS[0] if one.positive else -checks.FARTHEST
            specs[name] = ((), own[name], (least, checks.FARTHEST))
        given = {"distance": self.distances, **self.readings}
        strange = [name for name in given if name not in read]
        if strange:
            raise MeasurementError(
                f"No kind of measurement reads {choices(strange)}; register it first (calib.kinds.register)."
            )
        pairs = where.pairs(self.pairs)
        found: dict[str, Any] = {}
        for name, spec in specs.items():
            values = given.get(name) if name in read else getattr(self, name)
            if name in read and values is not None and pairs:
                values = checks.shared(where, values, pairs)
            found[name] = checks.numbers(where, name, values, *spec)
            if found[name] is None and name in own and own[name].any():
                checks.lacking(where, own[name], name)
        if found["rotations"] is not None:
            checks.check_rotations(where, found["rotations"], own["rotations"])
        for name, width in (("joints", n), ("points", 3)):
            if found[name] is None:
                found[name] = _read_only(np.full((len(every), width), np.nan))
        readings = {name: found.pop(name) for name in read}
        return {
            **found,
            "torques": checks.checked_torques(where, self.joint_names, self.torques),
            "distances": readings.pop("distance"),
            "readings": MappingProxyType({k: v for k, v in readings.items() if v is not None}),
        }

    @property
    def _where(self) -> checks.Where:
        """What messages say of a row."""
        return checks.Where(self.source, self.rows, self.kinds)

    def where(self, test: Callable[[Kind], bool]) -> NDArray[np.bool_]:
        """True for the rows of kinds that pass a test, shape (N,), read-only."""
        return _mask(self.kinds, *(n for n in registry.names() if test(registry.get(n))))

    def __reduce__(self) -> tuple[Any, ...]:
        """To another process and back: a read-only mapping travels as a dict."""
        values = {f: getattr(self, f) for f in self.__dataclass_fields__}
        return _measurements, ({**values, "readings": dict(self.readings)},)

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
        values = Values.read(table, layout)
        source, sha256 = table.source, table.sha256
        if elsewhere is not None:
            values = values.with_points(elsewhere, table.source, named="point" in layout.words)
            source, sha256 = f"{source} + {elsewhere.source}", f"{sha256} + {elsewhere.sha256}"
        given = {f.name: getattr(values, f.name) for f in fields(values) if f.name != "names"}
        given["readings"] = {n: v for n, v in values.readings.items() if n != "distance"}
        measurements = cls(
            **given,
            joint_names=layout.joint_names,
            distances=values.readings.get("distance"),
            source=source,
            sha256=sha256,
            ignored=layout.ignored,
            prismatic=layout.prismatic,
        )
        words = {name: getattr(measurements, name) for name in _WORDS}
        checks.check_whole(measurements._where, words)
        return measurements

    def __repr__(self) -> str:
        """In one line, such as ``Measurements(35 rows of 6 joints from ur3_leica.csv)``."""
        where = f" from {self.source}" if self.source else ""
        return f"Measurements({len(self)} rows of {len(self.joint_names)} joints{where})"

    def __len__(self) -> int:
        """The number of rows, N."""
        return len(self.points)

    @property
    def estimation(self) -> NDArray[np.bool_]:
        """True for the rows to estimate from, shape (N,), read-only."""
        return _mask(self.sets, "estimate")

    @property
    def validation(self) -> NDArray[np.bool_]:
        """True for the rows held back to validate with, shape (N,), read-only."""
        return _mask(self.sets, "validate")

    def of_kind(self, *kinds: str) -> NDArray[np.bool_]:
        """True for the rows of these kinds, shape (N,), read-only."""
        return _mask(self.kinds, *kinds)

    def reading(self, name: str) -> Array:
        """What stands in a column that some kind reads, such as ``"distance"``, shape (N,), in SI units."""
        found = self.distances if name == "distance" else self.readings.get(name)
        return np.full(len(self), np.nan) if found is None else found

    @property
    def paired(self) -> NDArray[np.bool_]:
        """True for the rows of which two give one measurement, shape (N,), read-only."""
        return self.where(lambda kind: kind.paired)

    @property
    def positions(self) -> NDArray[np.bool_]:
        """True for the rows that measure a position, shape (N,), read-only."""
        return self.where(lambda kind: kind.position)

    @property
    def pair_rows(self) -> NDArray[np.intp]:
        """The two rows of each pair, from 0, shape (P, 2), read-only; pairs that have lost a row are left out."""
        both = [rows for rows in self._where.pairs(self.pairs).values() if len(rows) == 2]
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
        """The rows where ``mask``, of shape (N,) and bool, is True; they keep their row numbers.

        A pair may lose one of its rows.

        Raises:
            MeasurementError: the mask has another shape or type.
        """
        chosen = np.asarray(mask)
        if chosen.dtype != np.bool_ or chosen.shape != (len(self),):
            raise MeasurementError(
                f"select was given an array of shape {chosen.shape} and type {chosen.dtype}; it "
                f"takes one bool for each of the {len(self)} rows, shape ({len(self)},)"
            )
        here = chosen.tolist()
        left: dict[str, Any] = {
            name: tuple(compress(getattr(self, name), here)) for name in (*_WORDS, "rows")
        }
        for name in _ARRAYS:
            values = getattr(self, name)
            left[name] = None if values is None else values[chosen]
        left["readings"] = {name: values[chosen] for name, values in self.readings.items()}
        return replace(self, **left)

    def joints_for(self, names: Sequence[str]) -> NDArray[np.float64]:
        """The values of these joints in this order, shape (N, len(names)), [rad] or [m], read-only.

        Raises:
            MeasurementError: there is no such joint in the table.
        """
        return _read_only(self.joints[:, self._index(names)])

    def _index(self, names: Sequence[str]) -> list[int]:
        """Where these joints stand among ``joint_names``."""
        where = {name: i for i, name in enumerate(self.joint_names)}
        missing = [name for name in names if name not in where]
        if missing:
            raise MeasurementError(
                f"{self.source or 'the measurements'}: no values of the joints {choices(missing)}. "
                f"The joints there are: {choices(self.joint_names, limit=30)}."
            )
        return [where[name] for name in names]

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a CSV table in degrees and millimetres that `read` gives back, see `calib.measure.table_text`.

        Raises:
            FileError: the file exists and ``overwrite`` is False, or it cannot be written.
        """
        kinds = [registry.get(kind) for kind in sorted(set(self.kinds))]
        words: dict[str, Sequence[object]] = {"row": self.rows, "set": self.sets}
        if len(kinds) > 1 or any(not k.size or (k.position and k.readings) for k in kinds):
            words["kind"] = self.kinds
        if set(self.targets) - {DEFAULT_TARGET}:
            words["target"] = self.targets
        words |= {n: w for n, w in (("group", self.groups), ("pair", self.pairs)) if any(w)}
        read = {
            one.name: (one.quantity, self.reading(one.name)) for one in registry.readings().values()
        }
        text = table_text(
            words,
            joints=[
                (n, n in self.prismatic, v)
                for n, v in zip(self.joint_names, self.joints.T, strict=True)
            ],
            torques=None if self.torques is None else self.torques.T,
            points=self.points if self.positions.any() or not len(self) else None,
            rotations=self.rotations,
            readings={name: one for name, one in read.items() if np.isfinite(one[1]).any()},
            sigma=self.sigma,
            sigma_angle=self.sigma_angle,
        )
        write_atomically(path, text.encode(), overwrite=overwrite)


#: The words of a row, by the attribute, and what stands for them where they are not given.
_WORDS = {"sets": SETS[0], "targets": DEFAULT_TARGET, "groups": "", "kinds": "point", "pairs": ""}


def _reads(one: registry.Reading) -> Callable[[Kind], bool]:
    """Whether a kind has this reading."""
    return lambda kind: one in kind.readings


#: The arrays with an entry a row.
_ARRAYS = ("joints", "points", "sigma", "rotations", "distances", "sigma_angle", "torques")


def _measurements(values: dict[str, Any]) -> Measurements:
    """Measurements from their values by name, see `Measurements.__reduce__`."""
    return Measurements(**values)


def _read_only(values: ArrayLike) -> NDArray[np.float64]:
    """A read-only float64 copy."""
    array_ = np.array(values, dtype=np.float64)
    array_.setflags(write=False)
    return array_


def _mask(words: Sequence[str], *wanted: str) -> NDArray[np.bool_]:
    """True where a word is one of those wanted, read-only."""
    there = set(words)  # mostly one
    if there <= set(wanted) or there.isdisjoint(wanted):
        mask = np.full(len(words), not there.isdisjoint(wanted), dtype=np.bool_)
    else:
        mask = np.array([word in wanted for word in words], dtype=np.bool_)
    mask.setflags(write=False)
    return mask
