"""What the rows of a table hold, in SI units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
from calib.errors import MeasurementError, choices
from calib.measure.cells import Cells
from calib.measure.layout import Layout
from calib.measure.orientation import to_matrices, wrong_length
from calib.measure.points_file import Points, match_points, unmeasured_points
from calib.measure.table import Table
from calib.measure.wrong_units import WrongUnits

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Values:
    """What the rows of a table hold; the attributes are those of `Measurements`.

    ``names`` are the words of the column ``point``, "" without one. ``unmeasured`` are the numbers of rows that are
    left out, for nothing is measured there yet.
    """

    joints: Array
    points: Array
    sets: tuple[str, ...]
    sigma: Array | None
    targets: tuple[str, ...]
    groups: tuple[str, ...]
    rows: tuple[int, ...]
    kinds: tuple[str, ...]
    rotations: Array | None
    readings: Mapping[str, Array]
    sigma_angle: Array | None
    pairs: tuple[str, ...]
    torques: Array | None
    names: tuple[str, ...]
    unmeasured: tuple[int, ...]

    @classmethod
    def read(cls, table: Table, layout: Layout) -> Values:
        """Read every row of a table, but for those in which all cells of the measurement are empty.

        Raises:
            MeasurementError: a row, a cell or a column's values cannot be used, or no row is
                ``estimate``, or none is measured.
        """
        found = Cells(table, layout)
        for block in table.blocks():
            found.add(block)
        if not found.lines:
            raise MeasurementError(_no_rows(table, layout, len(found.unmeasured)))
        words = found.words
        check_sets(table.source, words["set"], len(found.unmeasured))
        grid, lines, rows = np.concatenate(found.grids), found.lines, tuple(found.rows)
        _check_quaternions(table, layout, grid, lines, rows)
        WrongUnits(table.source, layout, grid, lines, rows).check()
        si = grid * np.array([column.to_si for column in layout.numbers])

        def block_of(name: str) -> Array | None:
            """One column of numbers, shape (N,), if it is there."""
            at = layout.span(name)
            return si[:, at[0]] if at else None

        points, orientation = layout.span("points"), layout.span("orientation")
        return cls(
            joints=si[:, layout.span("joints")],
            points=si[:, points] if points else np.full((len(si), 3), np.nan),
            sets=tuple(words["set"]),
            sigma=block_of("sigma"),
            targets=tuple(words["target"]),
            groups=tuple(words["group"]),
            rows=rows,
            kinds=tuple(found.kinds),
            rotations=to_matrices(si[:, orientation]) if orientation else None,
            readings={n: si[:, layout.span(n)[0]] for n in registry.readings() if layout.span(n)},
            sigma_angle=block_of("sigma_angle"),
            pairs=tuple(words["pair"]),
            torques=_torques(layout, si),
            names=tuple(words["point"]),
            unmeasured=tuple(found.unmeasured),
        )

    def with_points(self, elsewhere: Points, source: str, *, named: bool) -> Values:
        """The values with the points of a list in the rows that they belong to, without rows still to be measured.

        Args:
            elsewhere: the list.
            source: the table's file name.
            named: whether the rows name their points; else they are in the list's order.

        Raises:
            MeasurementError: a row's point is not there, or is that of another row; or the counts differ.
        """
        values = self
        at = [i for i, kind in enumerate(self.kinds) if registry.get(kind).position]
        if named:
            missing = unmeasured_points(elsewhere, [self.names[i] for i in at])
            values = self.without([at[k] for k in missing], source) if missing else self
            at = [i for i, kind in enumerate(values.kinds) if registry.get(kind).position]
        names = [values.names[i] for i in at] if named else None
        positions = np.full((len(values.kinds), 3), np.nan)
        positions[at] = match_points(elsewhere, source, [values.rows[i] for i in at], names)
        return replace(values, points=positions)

    def without(self, at: Collection[int], source: str) -> Values:
        """The values without some rows, from 0, that are not measured either.

        Raises:
            MeasurementError: no row is ``estimate`` any more.
        """
        kept = [i for i in range(len(self.rows)) if i not in at]

        def only(values: Any) -> Any:  # noqa: ANN401
            """Those of the rows that are left, of an array, a tuple, arrays by name, or None."""
            if isinstance(values, Mapping):
                return {name: one[kept] for name, one in values.items()}
            if isinstance(values, tuple):
                return tuple(values[i] for i in kept)
            return None if values is None else values[kept]

        left = {f.name: only(getattr(self, f.name)) for f in fields(self) if f.name != "unmeasured"}
        unmeasured = sorted((*self.unmeasured, *(self.rows[i] for i in at)))
        check_sets(source, left["sets"], len(unmeasured))
        return Values(**left, unmeasured=tuple(unmeasured))


def check_sets(source: str, sets: Sequence[str], unmeasured: int) -> None:
    """Refuse a table of which no row is to be estimated from.

    Raises:
        MeasurementError: there is none.
    """
    if "estimate" in sets:
        return
    but = f", {unmeasured} that are not measured yet aside" if unmeasured else ""
    raise MeasurementError(
        f"{source}, column 'set': no row is 'estimate', all {len(sets)} are 'validate'{but}. Mark those to estimate "
        "from, or remove the column."
    )


def _no_rows(table: Table, layout: Layout, unmeasured: int) -> str:
    """What to say of a table without rows, or without any that is measured."""
    if not unmeasured:
        return f"{table.source}: the table has a header and no rows below it"
    columns = [layout.numbers[i].label for kind in layout.kinds for i in layout.measured_by(kind)]
    listed = ", or give the instrument's list of points with --points" * ("point" in layout.kinds)
    return (
        f"{table.source}: nothing is measured yet; {choices(dict.fromkeys(columns))} are empty in all {unmeasured} "
        f"rows. Fill in what was measured at each pose{listed}."
    )


def _check_quaternions(
    table: Table, layout: Layout, grid: Array, lines: Sequence[int], rows: Sequence[int]
) -> None:
    """Refuse quaternions that have not length one."""
    at = layout.span("orientation")
    wrong = wrong_length(grid[:, at]) if len(at) == 4 else None
    if wrong:
        i, length = wrong
        raise MeasurementError(
            f"{table.source}, line {lines[i]} (row {rows[i]}), columns qx, qy, qz, qw: the quaternion "
            f"has the length {length:.6g}; that of an orientation is 1. Correct it, or leave the "
            'orientation out with --columns "qx=-" and so on.'
        )


def _torques(layout: Layout, si: Array) -> Array | None:
    """The torques of all joints, shape (N, n), NaN for a joint without a column; None without any."""
    at = layout.span("torques")
    if not at:
        return None
    torques = np.full((len(si), len(layout.blocks["joints"])), np.nan)
    torques[:, list(layout.torque_joints)] = si[:, at]
    return torques
