"""Measurements: joint values and the target positions measured with them; CSV in and out."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import MeasurementError, choices
from calib.measure.columns import RESERVED, Layout
from calib.measure.table import Table
from calib.measure.values import DEFAULT_TARGET, SETS, Values
from calib.model.files import write_atomically
from calib.units import UNITS


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N rows: the joint values of the robot and the target position that was measured there.

    Attributes:
        joint_names: the order of the columns of ``joints``.
        joints: joint values, shape (N, n), [rad] or, for ``prismatic`` joints, [m]. Read-only.
        points: measured target positions in the measurement frame, shape (N, 3), [m]. Read-only.
        sets: ``"estimate"`` or ``"validate"`` per row; all ``"estimate"`` when not given.
        sigma: standard deviation of one coordinate, shape (N,), [m], read-only; or None.
        targets: the target's name per row; ``"target"`` when not given.
        groups: the set-up's name per row; ``""`` when not given.
        rows: the row numbers a person sees, unique; 1 to N when not given.
        source: the file's name, for messages.
        sha256: of the file's bytes; ``""`` when not from a file.
        ignored: the headers of the table's columns that were not used.
        prismatic: the names of those joints whose values are lengths.

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

    def __post_init__(self) -> None:
        """Copy the arrays, fill in what was not given, and check that all of it fits together."""
        fill = object.__setattr__
        joints, points = _read_only(self.joints), _read_only(self.points)
        fill(self, "joints", joints)
        fill(self, "points", points)
        if self.sigma is not None:
            fill(self, "sigma", _read_only(self.sigma))
        count = len(points) if points.ndim else 0
        fill(self, "joint_names", tuple(self.joint_names))
        fill(self, "sets", tuple(self.sets) or (SETS[0],) * count)
        fill(self, "targets", tuple(self.targets) or (DEFAULT_TARGET,) * count)
        fill(self, "groups", tuple(self.groups) or ("",) * count)
        fill(self, "rows", tuple(self.rows) or tuple(range(1, count + 1)))
        fill(self, "ignored", tuple(self.ignored))
        fill(self, "prismatic", tuple(self.prismatic))
        _check_shapes(self)
        _check_names(self)
        _check_values(self)

    @classmethod
    def read(
        cls,
        path: str | Path,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
    ) -> Measurements:
        """Read a table with units in its header; docs/data-format.md describes it.

        Args:
            path: a CSV file in UTF-8, separated by commas, semicolons or tabs.
            joint_names: the joints to read, each of which must have a column; None reads every
                column in a unit of angle that is not of an orientation.
            joint_types: a joint's URDF type by its name; a ``"prismatic"`` joint is in a unit of
                length, any other in one of angle.
            columns: names of the table to names of calib, ``{"J1": "shoulder_pan_joint"}``; with
                a unit, ``{"J1": "shoulder_pan_joint [deg]"}``, for a column that has none.

        Raises:
            MeasurementError: the table cannot be read; the text names the file, row and column.
        """
        table = Table.read(path)
        layout = Layout.find(table, joint_names, joint_types, columns)
        values = Values.read(table, layout)
        return cls(
            joint_names=tuple(column.name for column in layout.joints),
            joints=values.joints,
            points=values.points,
            sets=values.sets,
            sigma=values.sigma,
            targets=values.targets,
            groups=values.groups,
            rows=values.rows,
            source=table.source,
            sha256=table.sha256,
            ignored=layout.ignored,
            prismatic=layout.prismatic,
        )

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
        return self._in_set("estimate")

    @property
    def validation(self) -> NDArray[np.bool_]:
        """True for the rows held back to validate with, shape (N,), read-only."""
        return self._in_set("validate")

    def _in_set(self, name: str) -> NDArray[np.bool_]:
        """True for the rows of one set, read-only."""
        mask = np.array([word == name for word in self.sets], dtype=np.bool_)
        mask.setflags(write=False)
        return mask

    def select(self, mask: ArrayLike) -> Measurements:
        """The rows where ``mask``, of shape (N,) and bool, is True; they keep their row numbers.

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
        index = np.flatnonzero(chosen).tolist()
        return replace(
            self,
            joints=self.joints[index],
            points=self.points[index],
            sets=tuple(self.sets[i] for i in index),
            sigma=None if self.sigma is None else self.sigma[index],
            targets=tuple(self.targets[i] for i in index),
            groups=tuple(self.groups[i] for i in index),
            rows=tuple(self.rows[i] for i in index),
        )

    def joints_for(self, names: Sequence[str]) -> NDArray[np.float64]:
        """The values of these joints in this order, shape (N, len(names)), [rad] or [m], read-only.

        Raises:
            MeasurementError: there is no such joint in the table.
        """
        missing = [name for name in names if name not in self.joint_names]
        if missing:
            message = (
                f"{self.source or 'the measurements'}: no values of the joints {choices(missing)}. "
                f"The joints there are: {choices(self.joint_names, limit=30)}."
            )
            raise MeasurementError(message)
        return _read_only(self.joints[:, [self.joint_names.index(name) for name in names]])

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a CSV table in degrees and millimetres that `read` gives back to 1e-15, relative.

        Raises:
            FileError: the file exists and ``overwrite`` is False, or it cannot be written.
        """
        angle, length = UNITS["deg"], UNITS["mm"]
        units = [length if name in self.prismatic else angle for name in self.joint_names]
        columns: dict[str, Sequence[object]] = {"row": self.rows, "set": self.sets}
        if any(target != DEFAULT_TARGET for target in self.targets):
            columns["target"] = self.targets
        if any(self.groups):
            columns["group"] = self.groups
        for name, unit, values in zip(self.joint_names, units, self.joints.T, strict=True):
            columns[f"{name} [{unit.symbol}]"] = (values / unit.to_si).tolist()
        for name, values in zip("xyz", self.points.T, strict=True):
            columns[f"{name} [{length.symbol}]"] = (values / length.to_si).tolist()
        if self.sigma is not None:
            columns[f"sigma [{length.symbol}]"] = (self.sigma / length.to_si).tolist()
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))  # csv writes a float as its repr
        write_atomically(path, text.getvalue().encode(), overwrite=overwrite)


def _read_only(values: ArrayLike) -> NDArray[np.float64]:
    """A read-only float64 copy."""
    array_ = np.array(values, dtype=np.float64)
    array_.setflags(write=False)
    return array_


def _check_shapes(m: Measurements) -> None:
    """Refuse arrays and tuples that do not have one entry a row."""
    shapes = {"points": m.points.shape, "joints": m.joints.shape}
    count = m.points.shape[0] if m.points.ndim else 0
    wanted: dict[str, tuple[int, ...]] = {
        "points": (count, 3),
        "joints": (count, len(m.joint_names)),
    }
    if m.sigma is not None:
        shapes["sigma"], wanted["sigma"] = m.sigma.shape, (count,)
    for name in ("sets", "targets", "groups", "rows"):
        shapes[name], wanted[name] = (len(getattr(m, name)),), (count,)
    for name, shape in shapes.items():
        if shape != wanted[name]:
            message = (
                f"Measurements: '{name}' has shape {shape} and should have {wanted[name]}: "
                f"{count} rows of points, {len(m.joint_names)} joint names"
            )
            raise MeasurementError(message)


def _check_names(m: Measurements) -> None:
    """Refuse names and words that a table cannot hold or that mean nothing."""
    source = m.source or "Measurements"
    names = m.joint_names
    bad = [n for n in names if n in RESERVED or not _is_name(n) or names.count(n) > 1]
    if bad or not names:
        message = (
            f"{source}: joint names are unique, on one line, without blanks around them, and none "
            f"of {choices(RESERVED)}; given were {choices(bad or ['no names at all'])}"
        )
        raise MeasurementError(message)
    strange = [name for name in m.prismatic if name not in names]
    if strange:
        message = f"{source}: 'prismatic' names {choices(strange)}; the joints are {choices(names)}"
        raise MeasurementError(message)
    for row, word, target, group in zip(m.rows, m.sets, m.targets, m.groups, strict=True):
        if word not in SETS:
            message = f"{source}, row {row}: the set '{word}' is neither of {choices(SETS)}"
            raise MeasurementError(message)
        if not _is_name(target) or not (group == "" or _is_name(group)):
            message = (
                f"{source}, row {row}: target '{target}' and group '{group}' are names on one "
                "line, without blanks around them; only the group may be empty"
            )
            raise MeasurementError(message)


def _is_name(text: str) -> bool:
    """Whether a text is one line and not empty, without blanks around it."""
    return text != "" and text == text.strip() and len(text.splitlines()) == 1


def _check_values(m: Measurements) -> None:
    """Refuse numbers that are not finite, a sigma not above zero, a row number given twice."""
    source = m.source or "Measurements"
    broken = [row for row in m.rows if not isinstance(row, (int, np.integer))]
    if broken:
        message = (
            f"{source}: the row number {broken[0]!r} is no integer; row numbers are whole numbers"
        )
        raise MeasurementError(message)
    if len(set(m.rows)) < len(m.rows):
        twice = Counter(m.rows).most_common(1)[0][0]
        message = f"{source}: the row number {twice} is there twice; row numbers are unique"
        raise MeasurementError(message)
    for name, values in (("joints", m.joints), ("points", m.points), ("sigma", m.sigma)):
        if values is None:
            continue
        wrong = ~np.isfinite(values) if name != "sigma" else ~(np.isfinite(values) & (values > 0.0))
        if wrong.any():
            at = np.argwhere(wrong)[0]
            what = "positive and finite" if name == "sigma" else "finite"
            message = (
                f"{source}, row {m.rows[at[0]]}: '{name}' holds {values[tuple(at)]}; "
                f"every value is {what}"
            )
            raise MeasurementError(message)
