"""Measurements: joint values and what was measured of the target there; CSV in and out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.data.kinds as registry
from calib.basics.arguments import check_names, mask_of_rows, numbers
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS, residual_unit
from calib.basics.files import csv_bytes, write_atomically
from calib.basics.frames import Frame, Library, frame_of, table_of_frame
from calib.basics.tables import Table
from calib.basics.units import Quantity, split_header
from calib.basics.values import ReadOnlyMapping, Value, one_line
from calib.data.checks import (
    RowLabels,
    by_word,
    check_argument_types,
    check_groups,
    check_joint_names,
    check_pairs,
    check_reading,
    check_rotations,
    check_torques,
    check_words,
    checked_covariances,
    checked_numbers,
    checked_readings,
    mask_of_words,
)
from calib.data.columns import (
    BOARD_POINT,
    COMMON,
    COVARIANCE,
    MOVE,
    POINT,
    REFERENCE,
    TORQUE,
    WORD_COLUMNS,
    cells_of,
)
from calib.data.forms.column_options import ColumnsInput
from calib.data.forms.flange_poses import with_flange_joints
from calib.data.forms.orientations import QUATERNION
from calib.data.forms.servo_columns import with_servo_angles
from calib.data.kinds import SIGMAS, Kind
from calib.data.layout import Layout
from calib.data.points_file import read_points
from calib.data.references import (
    References,
    check_stations,
    read_references,
    split_references,
)
from calib.data.values import read_values, with_joints_missing
from calib.errors import MeasurementError, choices, did_you_mean
from calib.numerics.geometry import FARTHEST, to_quaternions
from calib.numerics.moves import SAME_POSE, last_moves
from calib.robot.flange import is_flange_robot

#: Attributes that are arrays with an entry a row.
_ARRAYS = (
    "joints",
    "points",
    "rotations",
    "distances",
    "torques",
    "board_points",
    "covariances",
    "moves",
    "without_joint",
)

#: Attributes that map names to arrays with an entry a row.
_MAPPINGS = ("sigma", "readings")

#: Headers of columns of words.
_WORD_HEADERS = frozenset(name for name, _ in WORD_COLUMNS.values())

#: Least and largest coordinate, joint value or reading [m or rad].
_REACH = (-FARTHEST, FARTHEST)


@dataclass(frozen=True, slots=True, eq=False)
class Measurements(Value):
    """N rows: the joint values of the robot and what was measured of the target there.

    What a row measures is its kind, one of `calib.data.kinds`: ``point``, ``pose``, ``distance``, ``pair``, ``fixed``,
    ``plane``, ``pixel``, or one that was registered. What it does not measure is NaN, whatever was given; an array that
    is NaN in all rows is None. Arrays are read-only. Words are one a row.

    Raises:
        MeasurementError: A shape, a value or a word does not fit.
    """

    #: Names of the n joints, the columns of ``joints``.
    joint_names: tuple[str, ...]
    #: Joint values, shape (N, n), [rad] or, for ``prismatic`` joints, [m].
    joints: Array
    #: Measured positions of the targets in the measurement frame, shape (N, 3), [m].
    points: Array
    #: ``"estimate"`` or ``"validate"``; all ``"estimate"`` when not given.
    sets: tuple[str, ...] = ()
    #: Standard deviation of one scalar by its unit, shape (N,) each: ``"m"`` of a coordinate or length [m], ``"rad"``
    #: of an orientation about one axis [rad], ``"px"`` of an image coordinate [px]; empty: not given.
    sigma: Mapping[str, Array] = field(default_factory=dict)
    #: Names of the targets; ``"target"`` when not given.
    targets: tuple[str, ...] = ()
    #: Names of the stations, each with a measurement frame of its own; ``""`` when not given.
    groups: tuple[str, ...] = ()
    #: Row numbers as the table has them, unique; 1 to N when not given.
    rows: tuple[int, ...] = ()
    #: The file's name, for messages.
    source: str = ""
    #: Hash of the file's bytes, ``"... + ..."`` of two files.
    sha256: str = ""
    #: Headers of the table's columns that are not used.
    ignored: tuple[str, ...] = ()
    #: Names of the joints whose values are lengths.
    prismatic: tuple[str, ...] = ()
    #: Names of the kinds; all ``"point"`` when not given.
    kinds: tuple[str, ...] = ()
    #: Measured R_frame_target, shape (N, 3, 3); None: no orientation is measured.
    rotations: Array | None = None
    #: Measured distances, shape (N,), [m]; both rows of a pair have it. None: none is measured.
    distances: Array | None = None
    #: The word that both rows of a pair share; ``""`` in other rows.
    pairs: tuple[str, ...] = ()
    #: Torques (forces) of the drives on the joints, positive along the joint's axis, shape (N, n), [Nm] ([N]); NaN for
    #: joints without; None: not given.
    torques: Array | None = None
    #: Readings of registered kinds by the column's name, shape (N,) each, in SI units.
    readings: Mapping[str, Array] = field(default_factory=dict)
    #: Row numbers left out because they hold no measurement, as the table has them; the moves of the others count them.
    unmeasured: tuple[int, ...] = ()
    #: Row numbers left out by `without_copies`, as the table has them.
    copies: tuple[int, ...] = ()
    #: Names of the joints whose readings were brought back into the limits by `calib.data.whole_turns.brought_back`.
    turned: tuple[str, ...] = ()
    #: Pictures whose corners were numbered from the other end of a board that looks the same from both.
    other_end: tuple[str, ...] = ()
    #: Unit in which the file gave joint values and points, by the column's name: ``{"joint_1": "deg", "x": "mm"}``;
    #: empty without a file.
    units: Mapping[str, str] = field(default_factory=dict)
    #: Convention in which the table gave the orientations, one of `calib.data.forms.orientations.CONVENTIONS`; empty
    #: if it gave none.
    orientation: str = ""
    #: Names of the directions that the poses were approached from; ``""`` when not given.
    approaches: tuple[str, ...] = ()
    #: Names of the pictures in which corners of boards were found; ``""`` when not given.
    images: tuple[str, ...] = ()
    #: Names of the corners on their boards, such as ``"17"``; ``""`` when not given.
    corners: tuple[str, ...] = ()
    #: Positions of the corners as designed, each in its board's frame, shape (N, 3), [m]; None: no row is an image.
    board_points: Array | None = None
    #: Covariance of the errors of measured poses, shape (N, 6, 6): of the position [m] and of the rotation vector from
    #: the true orientation to the measured one [rad], along the measurement frame's axes; NaN in rows without one.
    #: None: no row has one.
    covariances: Array | None = None
    #: Last move of each joint before the row, shape (N, n), [rad] or [m], see `calib.numerics.moves.last_moves`; 0
    #: where it is not known. None: their joint values tell, as the rows are in the order of their measurement.
    moves: Array | None = None
    #: True where a row has no value of a joint, and ``joints`` has the value of an earlier row, shape (N, n): the row's
    #: chain does not have it. None: every row has all.
    without_joint: Mask | None = None
    #: Readings of targets that stand still, which are no rows of a fit; None: there are none.
    references: References | None = None

    def __post_init__(self) -> None:
        """Copy the arrays, fill in what was not given, and check that all of it fits together."""
        check_argument_types(self)
        fill = partial(object.__setattr__, self)
        count = len(np.asarray(self.points))
        for name in (
            "joint_names",
            "prismatic",
            "ignored",
            "unmeasured",
            "copies",
            "turned",
            "other_end",
        ):
            fill(name, tuple(getattr(self, name)))
        fill("rows", tuple(self.rows) or tuple(range(1, count + 1)))
        for name, (_, word) in WORD_COLUMNS.items():
            fill(name, tuple(getattr(self, name)) or (word,) * count)
        # A joint at its stop is seen from itself.
        of_joint = self.where(lambda kind: kind.of_joint).tolist()
        if any(of_joint):
            named = zip(of_joint, self.targets, self.groups, strict=True)
            fill("groups", tuple(target if stops else group for stops, target, group in named))
        labels = self._labels()
        check_words(labels, {name: getattr(self, name) for name in WORD_COLUMNS}, count)
        check_joint_names(labels)
        if any(self.pairs):
            words = zip(self.paired.tolist(), self.pairs, strict=True)
            fill("pairs", tuple(word if is_paired else "" for is_paired, word in words))
        given = {"distance": self.distances, **self.readings}
        readings = checked_readings(labels, given, self.pair_rows)
        fill("distances", readings.pop("distance", None))
        fill("readings", ReadOnlyMapping(readings))
        fill("units", ReadOnlyMapping(self.units))
        if self.references is not None and not {*self.rows} <= {*self.references.sequence}:
            raise MeasurementError(
                f"{labels.name}: the sequence of the references must have all row numbers of the poses."
            )

        is_oriented = self.where(lambda kind: kind.orientation)
        for name, tail, rows in (
            ("joints", (len(self.joint_names),), np.ones(count, dtype=np.bool_)),
            ("points", (3,), self.positions),
            ("rotations", (3, 3), is_oriented),
            ("board_points", (3,), self.is_image),
        ):
            array = checked_numbers(labels, name, getattr(self, name), tail, rows, _REACH)
            if array is None and name in ("joints", "points"):
                array = read_only(np.full((count, *tail), np.nan))
            fill(name, array)
        moves = last_moves(self.joints) if self.moves is None else self.moves
        every_row = np.ones(count, dtype=np.bool_)
        fill(
            "moves",
            checked_numbers(labels, "moves", moves, (len(self.joint_names),), every_row, _REACH),
        )
        if self.without_joint is not None:
            flags = np.array(self.without_joint, dtype=np.bool_)
            if flags.shape != self.joints.shape:
                raise MeasurementError(
                    f"Measurements: 'without_joint' has shape {flags.shape} and should have {self.joints.shape}"
                )
            flags.setflags(write=False)
            fill("without_joint", flags if flags.any() else None)
        if self.rotations is not None:
            check_rotations(labels, self.rotations, is_oriented)
        if self.torques is not None:
            fill("torques", read_only(numbers("torques", self.torques, "of shape (N, n)")))
            check_torques(labels, self.torques)
        poses = self.where(lambda kind: kind.may_have_covariance)
        fill("covariances", checked_covariances(labels, self.covariances, poses))

        sigma = {}
        for symbol, values in self.sigma.items():
            unit = residual_unit(symbol)
            has_unit = self.where(lambda kind, symbol=symbol: symbol in kind.units)  # type: ignore[misc]
            std = checked_numbers(labels, unit.sigma_name, values, (), has_unit, SIGMAS)
            if std is not None:
                sigma[symbol] = std
        fill("sigma", ReadOnlyMapping(sigma))

    def _labels(self) -> RowLabels:
        """Return the names of rows, kinds and joints, for the messages of checks."""
        return RowLabels(self.source, self.rows, self.kinds, self.joint_names)

    # Reading

    @classmethod
    def read(
        cls,
        path: str | Path | Table,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: ColumnsInput = None,
        kind: str | None = None,
        points: str | Path | None = None,
        points_unit: str | None = None,
        *,
        needs_all_joints: bool = True,
    ) -> Measurements:
        """Read a table with units in its header; docs/data-format.md describes it.

        Args:
            path: A CSV file in UTF-8, separated by commas, semicolons or tabs, or a sheet of an
                Excel file, ``"table.xlsx#Sheet"``; or one that was read already.
            joint_names: The joints to read, by calib's names (after ``columns``); each must have a
                column. None: every column in a unit of angle that is not of an orientation.
            joint_types: A joint's URDF type by its name; a ``"prismatic"`` joint is in a unit of
                length, any other in one of angle. None: the units of the columns tell.
            columns: Mapping from names of the table to names of calib,
                ``{"J1": "shoulder_pan_joint"}``; with a unit,
                ``{"J1": "shoulder_pan_joint [deg]"}``, for a column that has none; to ``"-"`` to
                leave a column out. Several columns may be mapped to ``"group"``. A
                `ColumnOptions` says besides the brand that names the others, the convention of
                orientations, the unit of joints and what the numbers of servos mean. None: no column is renamed.
            kind: The kind of all rows. None: from the column ``kind``, else from the columns there
                are: ``pose`` with an orientation, ``distance`` or ``pair`` with a distance and no
                position, else ``point``.
            points: A list of measured points, such as laser tracker programs write, see
                `read_points`: the table's column ``point`` names the point of each row; without
                one they are in the order of the rows. None: the table has the positions.
            points_unit: Unit of that list, ``"mm"``; None: the list names it.
            needs_all_joints: Whether each row must have a value of each joint; False for a robot of several chains,
                whose rows need those of their own chain; the others need no column either.

        Returns:
            The measured rows, in SI units; in the order of their measurement if the table has a column ``order``, else
            as in the table.

        Raises:
            ArgumentError: An argument of another type.
            MeasurementError: The table cannot be read; the text names the file, row and column.
        """
        check_reading(path, points, joint_names, joint_types, columns)
        elsewhere = None if points is None else read_points(points, points_unit)
        table = path if isinstance(path, Table) else Table.read(path)
        table, of_references = split_references(table, columns, joint_names or ())
        if is_flange_robot(joint_names or ()):
            table, columns = with_flange_joints(table, columns)
        else:
            table, columns = with_servo_angles(table, columns)
        references: References | None = None
        if of_references is not None:
            references, elsewhere = read_references(
                table, of_references, columns, joint_names or (), elsewhere
            )
        layout = Layout.find(
            table,
            joint_names,
            joint_types,
            columns,
            kind,
            points_elsewhere=elsewhere is not None,
            needs_all_joints=needs_all_joints,
        )
        values = read_values(
            table, layout, elsewhere, as_measured=True, needs_all_joints=needs_all_joints
        )
        if joint_names is not None and not needs_all_joints:
            values |= with_joints_missing(values, joint_names, joint_types or {})
        if references is not None:
            references = references.among(values["rows"])
        measurements = cls(**values, references=references)
        if not measurements.estimation.any():
            raise MeasurementError(
                f"{measurements.source}, column 'set': no measured row is 'estimate', all "
                f"{len(measurements)} are 'validate'. Mark those to estimate from, or remove the column."
            )
        labels = measurements._labels()
        pairs = by_word(measurements.pairs, measurements.paired)
        check_pairs(labels, pairs, measurements.sets)
        for name in set(measurements.kinds):
            check_groups(labels, name, by_word(measurements.groups, measurements.of_kind(name)))
        if references is not None:
            seen = by_word(measurements.groups, measurements.positions)
            check_stations(references, tuple(seen), measurements.source)
        return measurements

    @classmethod
    def of(
        cls,
        frame: Frame,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: ColumnsInput = None,
        kind: str | None = None,
        points: str | Path | None = None,
        points_unit: str | None = None,
        *,
        needs_all_joints: bool = True,
    ) -> Measurements:
        """Read a frame as a table file is read: the same names of columns, units and options.

        Args:
            frame: A frame of pandas or polars, a table of pyarrow, or a dict of columns, by headers with their units:
                ``{"joint_1 [deg]": [...], "x [mm]": [...]}``. Missing values are empty cells.
            joint_names: As of `read`.
            joint_types: As of `read`.
            columns: As of `read`.
            kind: As of `read`.
            points: As of `read`.
            points_unit: As of `read`.
            needs_all_joints: As of `read`.

        Returns:
            The measured rows, in SI units; ``source`` is the name of the frame's class.

        Raises:
            ArgumentError: An argument of another type.
            MeasurementError: The frame cannot be read; the text names row and column.
        """
        table = table_of_frame(frame)
        return cls.read(
            table,
            joint_names,
            joint_types,
            columns,
            kind,
            points,
            points_unit,
            needs_all_joints=needs_all_joints,
        )

    @classmethod
    def joined(cls, tables: Sequence[Measurements]) -> Measurements:
        """Put tables of the same joints one below the other, in the order in which they were measured.

        Args:
            tables: One or more, without references. Each row keeps the last moves of its own table.

        Returns:
            All rows, numbered from 1; what a table does not measure is NaN in its rows.
        """
        if len(tables) == 1:
            return tables[0]
        counts = [len(table) for table in tables]

        def stacked(values: Sequence[Array | Mask | None]) -> Array | None:
            """Return an array of all tables, one below the other, NaN where one has none; None if all have none."""
            known = [array for array in values if array is not None]
            if not known:
                return None
            empty = np.zeros(1, dtype=known[0].dtype)[0] if known[0].dtype == np.bool_ else np.nan
            pairs = zip(values, counts, strict=True)
            return np.concatenate(
                [
                    np.full((count, *known[0].shape[1:]), empty) if array is None else array
                    for array, count in pairs
                ]
            )

        values: dict[str, Any] = {
            name: stacked([getattr(table, name) for table in tables]) for name in _ARRAYS
        }
        for name in _MAPPINGS:
            keys = dict.fromkeys(key for table in tables for key in getattr(table, name))
            values[name] = {
                key: stacked([getattr(table, name).get(key) for table in tables]) for key in keys
            }
        for name in WORD_COLUMNS:
            values[name] = tuple(word for table in tables for word in getattr(table, name))
        return cls(joint_names=tables[0].joint_names, prismatic=tables[0].prismatic, **values)

    @staticmethod
    def columns_of(kind: Kind, measured: Array) -> dict[str, Any]:
        """Return what rows of one kind measure as arguments of `Measurements`.

        Args:
            kind: The kind of the rows.
            measured: Measured numbers, shape (n, k), in the order of `Kind`, in SI units.

        Returns:
            ``points``, ``rotations`` if the kind measures them, ``distances`` and ``readings``.
        """
        result: dict[str, Any] = {"points": np.full((len(measured), 3), np.nan)}
        if kind.position:
            result["points"] = measured[:, :3]
        if kind.orientation:
            result["rotations"] = measured[:, 3:12].reshape(-1, 3, 3)
        first = kind.size - len(kind.readings)
        readings = {r.name: measured[:, first + k] for k, r in enumerate(kind.readings)}
        result["distances"] = readings.pop("distance", None)
        result["readings"] = readings
        return result

    # Views

    def __repr__(self) -> str:
        """Return one line, such as ``Measurements(35 rows of 6 joints from ur3_leica.csv)``."""
        origin = f" from {self.source}" if self.source else ""
        return one_line(
            "Measurements", f"{len(self)} rows of {len(self.joint_names)} joints{origin}"
        )

    def __len__(self) -> int:
        """Return the number of rows, N."""
        return len(self.points)

    @property
    def estimation(self) -> Mask:
        """True for the rows to estimate from, shape (N,), read-only."""
        return mask_of_words(self.sets, "estimate")

    @property
    def validation(self) -> Mask:
        """True for the validation rows, shape (N,), read-only."""
        return mask_of_words(self.sets, "validate")

    @property
    def paired(self) -> Mask:
        """True for the rows of paired kinds, two of which give one measurement, shape (N,), read-only."""
        return self.where(lambda kind: kind.paired)

    @property
    def positions(self) -> Mask:
        """True for the rows that measure a position, shape (N,), read-only."""
        return self.where(lambda kind: kind.position)

    @property
    def is_image(self) -> Mask:
        """True for the rows that are points of a board in images, shape (N,), read-only."""
        return self.where(lambda kind: kind.is_image)

    @property
    def pair_rows(self) -> NDArray[np.intp]:
        """Indices, from 0, of the two rows of each pair, shape (P, 2), read-only.

        A pair that lost one of its rows to a selection is left out.
        """
        by_pair = by_word(self.pairs, self.paired).values()
        complete = [indices for indices in by_pair if len(indices) == 2]
        pairs = np.array(complete, dtype=np.intp).reshape(-1, 2)
        pairs.setflags(write=False)
        return pairs

    @property
    def stated_sigma(self) -> dict[str, Array]:
        """Standard deviation of one scalar by its unit, shape (N,) each, as ``sigma``.

        In rows with one of ``covariances`` it is theirs, rms over the axes.
        """
        result = dict(self.sigma)
        if self.covariances is None:
            return result
        variances = np.diagonal(self.covariances, axis1=1, axis2=2)
        for symbol, of_unit in (("m", variances[:, :3]), ("rad", variances[:, 3:])):
            std = np.sqrt(np.mean(of_unit, axis=1))
            of_others = self.sigma.get(symbol, np.full(len(std), np.nan))
            result[symbol] = read_only(np.where(np.isfinite(std), std, of_others))
        return result

    def where(self, test: Callable[[Kind], bool]) -> Mask:
        """Mark the rows whose kind passes a test, such as ``lambda kind: kind.position``.

        Args:
            test: True for the kinds of the rows to mark.

        Returns:
            True for these rows, shape (N,), read-only.
        """
        return mask_of_words(self.kinds, *(n for n in registry.names() if test(registry.get(n))))

    def of_kind(self, *kinds: str) -> Mask:
        """Mark the rows of kinds, by their names; shape (N,), read-only."""
        return mask_of_words(self.kinds, *kinds)

    def reading(self, name: str) -> Array:
        """Return the values of a reading column.

        Args:
            name: Name of the reading of a kind, such as ``"distance"``.

        Returns:
            The values, shape (N,), in SI units; NaN in rows that do not measure it.

        Raises:
            MeasurementError: No registered kind has such a reading.
        """
        if name not in registry.readings():
            raise MeasurementError(
                f"There is no reading '{name}'; kinds of measurement read {choices(registry.readings())}."
            )
        values = self.distances if name == "distance" else self.readings.get(name)
        return np.full(len(self), np.nan) if values is None else values

    def joints_for(self, names: Sequence[str]) -> Array:
        """Return the values of joints.

        Args:
            names: Names of m joints, in the order wanted.

        Returns:
            Joint values, shape (N, m), [rad] or [m], read-only.

        Raises:
            ArgumentError: The names are not a sequence of texts.
            MeasurementError: The table lacks one of the joints.
        """
        return read_only(self.joints[:, self._columns_of_joints(names)])

    def moves_for(self, names: Sequence[str]) -> Array:
        """Return the last moves of joints before the rows, as `joints_for` their values: shape (N, m), read-only."""
        assert self.moves is not None
        return read_only(self.moves[:, self._columns_of_joints(names)])

    def check_joints_of(self, names: Sequence[str], rows: Mask) -> None:
        """Refuse rows that lack a value of a joint that they need.

        Args:
            names: Names of the joints.
            rows: The rows that need them, shape (N,).

        Raises:
            MeasurementError: A row lacks one; the text names row and column.
        """
        if self.without_joint is None:
            return
        columns = self._columns_of_joints(names)
        lacking = np.argwhere(self.without_joint[:, columns] & rows[:, None])
        if len(lacking):
            row, column = lacking[0].tolist()
            name = names[column]
            what, fix = "the cell is empty", "Fill in its value"
            if self.without_joint[:, columns[column]].all():
                header = f"{name} [{COMMON['length' if name in self.prismatic else 'angle']}]"
                similar = did_you_mean(name, [split_header(label)[0] for label in self.ignored])
                what = f"no row has a value{similar}"
                fix = (
                    f"Add the column '{header}'; one of another name is mapped by --columns "
                    f'"name in the table={header}"'
                )
            raise MeasurementError(
                f"{self.source or 'Measurements'}, row {self.rows[row]}, column '{name}': {what}, and the target "
                f"'{self.targets[row]}' of this row hangs on that joint. {fix}."
            )

    def _columns_of_joints(self, names: Sequence[str]) -> list[int]:
        """Return the column of each joint, from 0; MeasurementError if the table lacks one."""
        check_names("names", names)
        column = {name: i for i, name in enumerate(self.joint_names)}
        missing = [name for name in names if name not in column]
        if missing:
            raise MeasurementError(
                f"{self.source or 'the measurements'}: no values of the joints {choices(missing)}. "
                f"The joints there are: {choices(self.joint_names, limit=30)}."
            )
        return [column[name] for name in names]

    # Selections

    def select(self, mask: ArrayLike) -> Measurements:
        """Return some of the rows, with their row numbers.

        Args:
            mask: True for the rows to keep, shape (N,); a pair may lose one of its rows.

        Returns:
            These rows, in their order.

        Raises:
            ArgumentError: It is not True or False for each row.
        """
        chosen = mask_of_rows("mask", mask, len(self))
        is_chosen = chosen.tolist()
        kept: dict[str, Any] = {}
        for name in (*WORD_COLUMNS, "rows"):
            kept[name] = tuple(compress(getattr(self, name), is_chosen))
        for name in _ARRAYS:
            values = getattr(self, name)
            kept[name] = None if values is None else values[chosen]
        for name in _MAPPINGS:
            kept[name] = {key: values[chosen] for key, values in getattr(self, name).items()}
        return replace(self, **kept)

    def without_copies(self) -> Measurements:
        """Return the rows without those that repeat an earlier row to the last digit.

        Joint values and measurement of repeats differ by noise; equal ones, of the same kind, station
        and target, were copied, whatever their torques, set and ``sigma``. Rows of kinds that measure no
        number, and pairs, are kept.

        Returns:
            The rows; ``copies`` has the row numbers of those that were left out.
        """
        given = [
            getattr(self, name)
            for name in _ARRAYS
            if name not in ("torques", "moves", "without_joint")
        ]
        arrays = [*given, *self.readings.values()]
        numbers = np.hstack([a.reshape(len(self), -1) for a in arrays if a is not None])
        seen = set()
        is_repeated = np.zeros(len(self), dtype=np.bool_)
        for i, words in enumerate(zip(self.kinds, self.groups, self.targets, strict=True)):
            row = (*words, numbers[i].tobytes())  # NaN is a number as any other
            is_repeated[i] = row in seen
            seen.add(row)
        measures_number = self.where(lambda kind: kind.size > 0)
        is_copy = is_repeated & ~self.paired & measures_number
        copies = tuple(compress(self.rows, is_copy.tolist()))
        return replace(self.select(~is_copy), copies=copies) if copies else self

    # Writing

    def write(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a CSV table in degrees and millimetres that `read` gives back.

        Numbers that came from a table in these units come back to the last bit, others to a relative 1e-15, because
        hardly any number of radians is exactly a number of degrees. Orientations come back to 1e-15. Columns in which
        no row has a number, or all have the word that is filled in when none is given, are left out, except ``set``.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Raises:
            FileError: The file exists and ``overwrite`` is False, or it cannot be written.
        """
        columns = self.columns()
        rows = [columns, *zip(*columns.values(), strict=True)]
        write_atomically(path, csv_bytes(rows), overwrite=overwrite)

    def to_frame(self, library: Library = "pandas") -> Any:  # noqa: ANN401  of any library
        """Return the table that `write` writes, in degrees and millimetres, as a frame that `of` gives back.

        Args:
            library: ``"pandas"`` or ``"polars"``.

        Returns:
            A ``pandas.DataFrame`` or a ``polars.DataFrame``; numbers that were not measured are missing values.

        Raises:
            CalibError: The library is not installed, or another one was named.
        """
        columns = {}
        for header, cells in self.columns().items():
            has_words = header in _WORD_HEADERS
            columns[header] = [None if cell == "" and not has_words else cell for cell in cells]
        return frame_of(columns, library)

    def columns(self) -> dict[str, Sequence[object]]:
        """Return the columns that `write` writes by their headers, in degrees and millimetres; `of` takes them.

        Poses and references are in the order of measurement; a number that was not measured is an empty text.
        """
        columns = self._columns_of_poses()
        known = self.references
        if known is None:
            return columns
        cells: dict[str, Sequence[object]] = {
            "row": known.rows,
            "set": (REFERENCE,) * len(known),
            "target": known.targets,
            "group": known.groups,
        }
        for i, name in enumerate(POINT):
            cells[f"{name} [mm]"] = cells_of(known.points[:, i], COMMON["length"])
        # Without a column for them all poses have the word that is filled in.
        for name, words in (("target", self.targets), ("group", self.groups)):
            if name not in columns and set(cells[name]) != set(words):
                columns[name] = words
        order = {number: k for k, number in enumerate(known.sequence)}
        numbers = [*self.rows, *known.rows]
        in_order = sorted(range(len(numbers)), key=lambda i: order[numbers[i]])
        blank = ("",) * len(known)
        for header, of_poses in columns.items():
            both = [*of_poses, *cells.get(header, blank)]
            columns[header] = [both[i] for i in in_order]
        return columns

    def _columns_of_poses(self) -> dict[str, Sequence[object]]:
        """Return the columns of the poses by their headers; a number that was not measured is an empty text."""
        columns: dict[str, Sequence[object]] = {"row": self.rows, "set": self.sets}
        for attribute, (name, default) in WORD_COLUMNS.items():
            words = getattr(self, attribute)
            if set(words) - {default}:
                columns[name] = words
        for name, quantity, values in self._number_columns():
            if len(values) and np.isnan(values).all():
                continue
            unit = "" if quantity is None else COMMON[quantity]
            header = f"{name} [{unit}]" if unit else name
            columns[header] = cells_of(values, unit)
        return columns

    def _number_columns(self) -> Iterator[tuple[str, Quantity | None, Array]]:
        """Yield name, quantity (None: no unit) and values, in SI units, of the columns of numbers to write."""
        # Moves that are not those between the rows, as in some of the rows of a table.
        moves = self.moves
        if moves is not None and np.allclose(
            moves, last_moves(self.joints), rtol=0.0, atol=SAME_POSE
        ):
            moves = None
        joints = self.joints
        if self.without_joint is not None:
            joints = np.where(self.without_joint, np.nan, joints)
        for i, name in enumerate(self.joint_names):
            slides = name in self.prismatic
            yield name, "length" if slides else "angle", joints[:, i]
            if moves is not None:
                yield name + MOVE, "length" if slides else "angle", moves[:, i]
            if self.torques is not None:
                yield name + TORQUE, "force" if slides else "torque", self.torques[:, i]
        for names, values in ((POINT, self.points), (BOARD_POINT, self.board_points)):
            if values is not None:
                for i, name in enumerate(names):
                    yield name, "length", values[:, i]
        if self.rotations is not None:
            quaternions = to_quaternions(self.rotations)
            for i, name in enumerate(QUATERNION.columns):
                yield name, None, quaternions[:, i]
        for reading in registry.readings().values() if len(self) else ():
            yield reading.name, reading.quantity, self.reading(reading.name)
        for symbol, values in self.sigma.items():
            unit = RESIDUAL_UNITS[symbol]
            yield unit.sigma_name, unit.quantity, values
        if self.covariances is not None:
            entries = self.covariances.reshape(len(self), len(COVARIANCE))
            for name, values in zip(COVARIANCE, entries.T, strict=True):
                yield name, None, values
