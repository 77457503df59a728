"""Measurements: joint values and what was measured of the target there; CSV in and out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.errors import MeasurementError, choices
from calib.measure.checks import (
    check_names,
    check_shapes,
    check_values,
    check_whole,
    share_distances,
    two_rows,
)
from calib.measure.columns import DEFAULT_TARGET, SETS
from calib.measure.kinds import KINDS, LENGTHS, POSITIONS
from calib.measure.layout import Layout
from calib.measure.points_file import Points, match_points, read_points, unmeasured_points
from calib.measure.table import Table
from calib.measure.table_text import table_text
from calib.measure.values import Values
from calib.model.files import write_atomically


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N rows: the joint values of the robot and what was measured of the target there.

    What a row measures is its kind, one of `KINDS`:

    - ``point``: the position of the target. ``pose``: its position and orientation.
    - ``distance``: its distance to an anchor, one point for each group.
    - ``pair``: the distance between the targets of the two rows that share a word.
    - ``fixed``: nothing; the target sits at one unknown point for each group.
    - ``plane``: nothing; the target touches one unknown plane for each group.

    What a row's kind does not measure is NaN, whatever was given; an array of which nothing is left is None.

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
    unmeasured: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Copy the arrays, fill in what was not given, and check that all of it fits together."""
        fill = object.__setattr__
        for name in ("joints", "points", *_ARRAYS):
            values = getattr(self, name)
            fill(self, name, None if values is None else _read_only(values))
        count = len(self.points) if self.points.ndim else 0
        fill(self, "joint_names", tuple(self.joint_names))
        fill(self, "sets", tuple(self.sets) or (SETS[0],) * count)
        fill(self, "targets", tuple(self.targets) or (DEFAULT_TARGET,) * count)
        fill(self, "groups", tuple(self.groups) or ("",) * count)
        fill(self, "rows", tuple(self.rows) or tuple(range(1, count + 1)))
        fill(self, "ignored", tuple(self.ignored))
        fill(self, "unmeasured", tuple(self.unmeasured))
        fill(self, "prismatic", tuple(self.prismatic))
        fill(self, "kinds", tuple(self.kinds) or (KINDS[0],) * count)
        fill(self, "pairs", tuple(self.pairs) or ("",) * count)
        check_shapes(self)
        check_names(self)
        for name, kinds in _MEASURED_BY.items():
            fill(self, name, self._only(getattr(self, name), *kinds))
        if any(self.pairs):
            pairs = zip(self.kinds, self.pairs, strict=True)
            fill(self, "pairs", tuple(word if kind == "pair" else "" for kind, word in pairs))
        shared = share_distances(self)
        fill(self, "distances", None if shared is None else _read_only(shared))
        check_values(self)

    def _only(self, values: NDArray[np.float64] | None, *kinds: str) -> NDArray[np.float64] | None:
        """The values with NaN in the rows of other kinds; of an optional array None when no row is left."""
        rows = self.of_kind(*kinds)
        if values is None or rows.all():
            return values
        if not rows.any() and values is not self.points:
            return None
        kept = values.copy()
        kept[~rows] = np.nan
        return _read_only(kept)

    @classmethod
    def read(
        cls,
        path: str | Path,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
        kind: str | None = None,
        points: str | Path | None = None,
        points_unit: str | None = None,
    ) -> Measurements:
        """Read a table with units in its header; docs/data-format.md describes it.

        Args:
            path: a CSV file in UTF-8, separated by commas, semicolons or tabs.
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
        table = Table.read(path)
        layout = Layout.find(
            table, joint_names, joint_types, columns, kind, points_elsewhere=elsewhere is not None
        )
        values = Values.read(table, layout)
        positions, source, sha256 = values.points, table.source, table.sha256
        if elsewhere is not None:
            values = _measured(elsewhere, table, layout, values)
            positions = _located(elsewhere, table, layout, values)
            source, sha256 = f"{source} + {elsewhere.source}", f"{sha256} + {elsewhere.sha256}"
        measurements = cls(
            joint_names=layout.joint_names,
            joints=values.joints,
            points=positions,
            sets=values.sets,
            sigma=values.sigma,
            targets=values.targets,
            groups=values.groups,
            rows=values.rows,
            source=source,
            sha256=sha256,
            ignored=layout.ignored,
            prismatic=layout.prismatic,
            kinds=values.kinds,
            rotations=values.rotations,
            distances=values.distances,
            sigma_angle=values.sigma_angle,
            pairs=values.pairs,
            torques=values.torques,
            unmeasured=values.unmeasured,
        )
        check_whole(measurements)
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

    def reading(self, name: str) -> NDArray[np.float64]:
        """What stands in a column that some kind reads, such as ``"distance"``, shape (N,), in SI units."""
        assert name == "distance"
        return np.full(len(self), np.nan) if self.distances is None else self.distances

    @property
    def paired(self) -> NDArray[np.bool_]:
        """True for the rows of which two give one measurement, shape (N,), read-only."""
        return self.of_kind(*(name for name in registry.names() if registry.get(name).paired))

    @property
    def pair_rows(self) -> NDArray[np.intp]:
        """The two rows of each pair, from 0, shape (P, 2), read-only; pairs that have lost a row are left out."""
        rows = np.array(list(two_rows(self).values()), dtype=np.intp).reshape(-1, 2)
        rows.setflags(write=False)
        return rows

    def select(self, mask: ArrayLike) -> Measurements:
        """The rows where ``mask``, of shape (N,) and bool, is True; they keep their row numbers.

        A pair may lose one of its rows.

        Raises:
            MeasurementError: the mask has another shape or type.
        """
        chosen = np.asarray(mask)
        if chosen.dtype != np.bool_ or chosen.shape != (len(self),):
            message = (
                f"select was given an array of shape {chosen.shape} and type {chosen.dtype}; it "
                f"takes one bool for each of the {len(self)} rows, shape ({len(self)},)"
            )
            raise MeasurementError(message)
        here = chosen.tolist()

        def words(values: Sequence[str]) -> tuple[str, ...]:
            """The chosen of some words."""
            return tuple(compress(values, here))

        def numbers(values: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
            """The chosen of some numbers."""
            return None if values is None else values[chosen]

        return replace(
            self,
            joints=self.joints[chosen],
            points=self.points[chosen],
            sets=words(self.sets),
            sigma=numbers(self.sigma),
            targets=words(self.targets),
            groups=words(self.groups),
            rows=tuple(compress(self.rows, here)),
            kinds=words(self.kinds),
            rotations=numbers(self.rotations),
            distances=numbers(self.distances),
            sigma_angle=numbers(self.sigma_angle),
            pairs=words(self.pairs),
            torques=numbers(self.torques),
        )

    def joints_for(self, names: Sequence[str]) -> NDArray[np.float64]:
        """The values of these joints in this order, shape (N, len(names)), [rad] or [m], read-only.

        Raises:
            MeasurementError: there is no such joint in the table.
        """
        return _read_only(self.joints[:, self._index(names)])

    def torques_for(self, names: Sequence[str]) -> NDArray[np.float64] | None:
        """The torques of these joints in this order, shape (N, len(names)), [Nm] or [N]; None without any.

        Raises:
            MeasurementError: there is no such joint in the table.
        """
        index = self._index(names)
        return None if self.torques is None else _read_only(self.torques[:, index])

    def _index(self, names: Sequence[str]) -> list[int]:
        """Where these joints stand among ``joint_names``."""
        where = {name: i for i, name in enumerate(self.joint_names)}
        missing = [name for name in names if name not in where]
        if missing:
            message = (
                f"{self.source or 'the measurements'}: no values of the joints {choices(missing)}. "
                f"The joints there are: {choices(self.joint_names, limit=30)}."
            )
            raise MeasurementError(message)
        return [where[name] for name in names]

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a CSV table in degrees and millimetres, see `calib.measure.table_text`.

        Raises:
            FileError: the file exists and ``overwrite`` is False, or it cannot be written.
        """
        write_atomically(path, table_text(self).encode(), overwrite=overwrite)


_ARRAYS = ("sigma", "rotations", "distances", "sigma_angle", "torques")

# Which kinds of rows have a number here; in others it is NaN.
_MEASURED_BY: Mapping[str, tuple[str, ...]] = {
    "points": POSITIONS,
    "rotations": ("pose",),
    "distances": LENGTHS,
    "sigma_angle": ("pose",),
}


def _measured(elsewhere: Points, table: Table, layout: Layout, values: Values) -> Values:
    """The rows without those whose points are still to be measured."""
    if "point" not in layout.words:
        return values
    at = [i for i, kind in enumerate(values.kinds) if kind in POSITIONS]
    missing = unmeasured_points(elsewhere, [values.names[i] for i in at])
    return values.without([at[k] for k in missing], table.source) if missing else values


def _located(
    elsewhere: Points, table: Table, layout: Layout, values: Values
) -> NDArray[np.float64]:
    """The points of a file of points in the rows that they belong to, shape (N, 3), [m]; NaN in others."""
    at = [i for i, kind in enumerate(values.kinds) if kind in POSITIONS]
    names = [values.names[i] for i in at] if "point" in layout.words else None
    positions = np.full((len(values.kinds), 3), np.nan)
    positions[at] = match_points(elsewhere, table.source, [values.rows[i] for i in at], names)
    return positions


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
