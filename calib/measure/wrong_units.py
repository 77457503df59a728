"""Values that belong to another unit than the header says: metres read as millimetres, degrees as radians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError
from calib.measure.columns import Column
from calib.measure.layout import Layout
from calib.units import UNITS, Unit

# The points of a robot cell lie between these distances from the origin of any frame in use.
FAR_M = 100.0
NEAR_M = 5e-3
# Half of a column beyond this many radians: hardly any joint turns so far, and degrees mostly do.
TURNS_RAD = 7.0
# Rotation vectors in degrees that are all as long as those in radians, while a joint turns further than this.
VECTOR_DEG = (0.5, 2.0 * np.pi)
TURNING_RAD = float(np.radians(30.0))
# No instrument measures an orientation worse than this, and sigmas in degrees mostly look so in radians.
VAGUE_RAD = 1.0


def farthest(metres: NDArray[np.float64]) -> tuple[int, float]:
    """The row that lies furthest from the origin, and how far, [m]; ``metres`` has shape (N, k)."""
    distance = np.hypot.reduce(metres, axis=1)  # does not square: a huge number stays one
    row = int(np.argmax(distance))
    return row, float(distance[row])


def better_unit(value: float, unit: Unit) -> str:
    """The unit of length in which a value would be a distance in a robot cell; "" for the same or none."""
    fits = [u for u in ("mm", "m", "um") if 0.01 <= abs(value) * UNITS[u].to_si <= 20.0]
    return fits[0] if fits and fits[0] != unit.symbol else ""


@dataclass(frozen=True, slots=True)
class WrongUnits:
    """Looks at the numbers of a table as read, before they are turned into SI units.

    Attributes:
        source: the file's name.
        layout: what the columns are.
        grid: shape (N, columns), NaN where a row has no such number.
        lines: of the file, for each row.
        rows: the row numbers.
    """

    source: str
    layout: Layout
    grid: NDArray[np.float64]
    lines: Sequence[int]
    rows: Sequence[int]
    _columns: tuple[Column, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """The columns of ``grid``, put together once."""
        object.__setattr__(self, "_columns", self.layout.numbers)

    @np.errstate(over="ignore")  # what is infinite is too large as well
    def check(self) -> None:
        """Refuse values that are not what they are said to be.

        Raises:
            MeasurementError: with the file, the line, the column, and the unit that would make sense.
        """
        span = self.layout.span
        for i in span("joints"):
            self._degrees([i])
        if len(span("orientation")) == 3:
            self._degrees(span("orientation"))
            self._radians(span("orientation"))
        self._positive()
        for i in span("joints"):
            if _unit(self._columns[i]).quantity == "length":
                self._far([i], "further from the origin")
        for name, far, near in (
            ("points", "further from the origin", "no point is further from the origin"),
            ("distance", "longer", "no distance is longer"),
        ):
            if span(name):
                self._far(span(name), far)
                self._near(span(name), near)
        self._vague()

    def _column(self, i: int) -> Column:
        """The column of ``grid``'s column ``i``."""
        return self._columns[i]

    def _degrees(self, columns: list[int]) -> None:
        """Refuse columns in radians that look like degrees."""
        if any(_unit(self._column(i)).symbol != "rad" for i in columns):
            return
        size = np.linalg.norm(self.grid[:, columns], axis=1)
        median = float(np.median(size[~np.isnan(size)]))
        if median > TURNS_RAD:
            column = self._column(columns[0])
            message = (
                f"{self.source}, column '{column.label}': half of the values are beyond "
                f"{median:.4g} rad, more than a turn; they look like degrees. If they are, "
                f"write '{column.name} [deg]' into the header."
            )
            raise MeasurementError(message)

    def _radians(self, columns: list[int]) -> None:
        """Refuse rotation vectors in degrees that look like radians: the robot turns, they hardly do."""
        if any(_unit(self._column(i)).symbol != "deg" for i in columns):
            return
        size = np.linalg.norm(self.grid[:, columns], axis=1)
        size = size[~np.isnan(size)]
        low, high = VECTOR_DEG
        if not (np.median(size) > low and size.max() < high):
            return
        for i in self.layout.span("joints"):
            turned = float(np.ptp(self.grid[:, i])) * self._column(i).to_si
            if _unit(self._column(i)).quantity == "angle" and turned > TURNING_RAD:
                column = self._column(columns[0])
                message = (
                    f"{self.source}, column '{column.label}': no rotation vector is longer than "
                    f"{size.max():.4g} deg, while '{self._column(i).name}' turns by "
                    f"{np.degrees(turned):.4g} deg; they look like radians. If they are, write "
                    f"'{column.name} [rad]' into the header; if not, give them in radians."
                )
                raise MeasurementError(message)

    def _positive(self) -> None:
        """Refuse a standard deviation or a distance that is not greater than zero."""
        leave_out = ". Correct it, or leave the column out: the noise is found from the data."
        for name, what, fix in (
            ("sigma", "a standard deviation", leave_out),
            ("sigma_angle", "a standard deviation", leave_out),
            (
                "distance",
                "a distance",
                ". A target that stays at one point is of the kind 'fixed'.",
            ),
        ):
            for i in self.layout.span(name):
                wrong = np.flatnonzero(self.grid[:, i] <= 0.0)
                if wrong.size:
                    value = self.grid[wrong[0], i]
                    message = (
                        f"{self._place(int(wrong[0]), i)}: {name} is '{value:.10g}'; {what} is "
                        f"greater than zero{fix}"
                    )
                    raise MeasurementError(message)

    def _vague(self) -> None:
        """Refuse a standard deviation of an angle that no instrument has."""
        for i in self.layout.span("sigma_angle"):
            column = self._column(i)
            wrong = np.flatnonzero(self.grid[:, i] * column.to_si > VAGUE_RAD)
            if wrong.size:
                value = float(self.grid[wrong[0], i])
                message = (
                    f"{self._place(int(wrong[0]), i)}: {value:.10g} was read as "
                    f"{value * column.to_si:.4g} rad, which says nothing of an orientation. If it "
                    f"is in degrees, write '{column.name} [deg]' into the header."
                )
                raise MeasurementError(message)

    def _metres(self, columns: list[int]) -> NDArray[np.float64]:
        """Columns of lengths in metres, shape (N, len(columns)); zero where there is none."""
        to_si = np.array([self._column(i).to_si for i in columns])
        return np.asarray(np.nan_to_num(self.grid[:, columns]) * to_si)

    def _far(self, columns: list[int], what: str) -> None:
        """Refuse a row further from the origin than any robot cell is wide."""
        metres = self._metres(columns)
        worst, distance = farthest(metres)
        if distance > FAR_M:
            largest = columns[int(np.argmax(np.abs(metres[worst])))]
            self._refuse(worst, largest, f"{what} than {FAR_M:g} m")

    def _near(self, columns: list[int], what: str) -> None:
        """Refuse lengths that are all shorter than a robot moves."""
        metres = self._metres(columns)
        worst, distance = farthest(metres)
        largest = columns[int(np.argmax(np.abs(metres[worst])))]
        in_metres = _unit(self._column(largest)).symbol == "m"  # no unit is larger
        if distance < NEAR_M and not in_metres:
            self._refuse(worst, largest, f"and {what} than {NEAR_M * 1e3:g} mm")

    def _refuse(self, row: int, i: int, what: str) -> None:
        """Say what was read and which unit would make sense of it."""
        column = self._column(i)
        value = float(self.grid[row, i])
        unit = better_unit(value, _unit(column))
        fix = "Correct the value."
        if unit:
            fix = f"If it is in {unit}, write '{column.name} [{unit}]' into the header."
        message = (
            f"{self._place(row, i)}: {value:.10g} was read as {value * column.to_si:.6g} m, {what}. "
            f"{fix}"
        )
        raise MeasurementError(message)

    def _place(self, row: int, i: int) -> str:
        """Where a value stands."""
        return (
            f"{self.source}, line {self.lines[row]} (row {self.rows[row]}), "
            f"column '{self._column(i).label}'"
        )


def _unit(column: Column) -> Unit:
    """The unit of a column of lengths or angles, which `Layout.find` has made sure of."""
    assert column.unit is not None
    return column.unit
