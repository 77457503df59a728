"""Values that belong to another unit than the header says: metres read as millimetres, degrees as radians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
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

    @np.errstate(over="ignore")  # what is infinite is too large as well
    def check(self) -> None:
        """Refuse values that are not what they are said to be.

        Raises:
            MeasurementError: with the file, the line, the column, and the unit that would make sense.
        """
        span, columns = self.layout.span, self.layout.numbers
        joints, orientation = span("joints"), span("orientation")
        for at in [*([i] for i in joints), *([orientation] if len(orientation) == 3 else [])]:
            self._degrees(at)
        if len(orientation) == 3:
            self._radians(orientation)
        slides = [[i] for i in joints if _unit(columns[i]).quantity == "length"]
        for at in [*slides, *([span("points")] if span("points") else [])]:
            self._far(at, "further from the origin")
        if span("points"):
            self._near(span("points"), "no point is further from the origin")
        self._readings()
        for i in span("sigma_angle"):
            self._vague(i)
        for i in (*span("sigma"), *span("sigma_angle")):
            self._positive(i)

    def _readings(self) -> None:
        """The same for what kinds read in columns of their own."""
        for name, reading in registry.readings().items():
            at = self.layout.span(name)
            if at and reading.positive:
                self._positive(at[0])
            if at and reading.quantity == "length":
                self._far(at, "longer")
                if reading.positive:
                    self._near(at, f"no {name} is longer")

    def _degrees(self, at: list[int]) -> None:
        """Refuse columns in radians that look like degrees."""
        columns = [self.layout.numbers[i] for i in at]
        if any(_unit(column).symbol != "rad" for column in columns):
            return
        size = np.linalg.norm(self.grid[:, at], axis=1)
        median = float(np.median(size[~np.isnan(size)]))
        if median > TURNS_RAD:
            raise MeasurementError(
                f"{self.source}, column '{columns[0].label}': half of the values are beyond "
                f"{median:.4g} rad, more than a turn; they look like degrees. If they are, "
                f"write '{columns[0].name} [deg]' into the header."
            )

    def _radians(self, at: list[int]) -> None:
        """Refuse rotation vectors in degrees that look like radians: the robot turns, they hardly do."""
        columns = [self.layout.numbers[i] for i in at]
        if any(_unit(column).symbol != "deg" for column in columns):
            return
        size = np.linalg.norm(self.grid[:, at], axis=1)
        size = size[~np.isnan(size)]
        if not (np.median(size) > VECTOR_DEG[0] and size.max() < VECTOR_DEG[1]):
            return
        for i in self.layout.span("joints"):
            joint = self.layout.numbers[i]
            turned = float(np.ptp(self.grid[:, i])) * joint.to_si
            if _unit(joint).quantity == "angle" and turned > TURNING_RAD:
                raise MeasurementError(
                    f"{self.source}, column '{columns[0].label}': no rotation vector is longer than "
                    f"{size.max():.4g} deg, while '{joint.name}' turns by {np.degrees(turned):.4g} deg; "
                    f"they look like radians. If they are, write '{columns[0].name} [rad]' into the "
                    "header; if not, give them in radians."
                )

    def _vague(self, i: int) -> None:
        """Refuse a standard deviation of an angle that no instrument has."""
        wrong = np.flatnonzero(self.grid[:, i] * self.layout.numbers[i].to_si > VAGUE_RAD)
        if wrong.size:
            what = "which says nothing of an orientation"
            self._refuse(int(wrong[0]), i, "rad", what, "deg")

    def _positive(self, i: int) -> None:
        """Refuse a standard deviation or a distance that is not greater than zero."""
        column = self.layout.numbers[i]
        wrong = np.flatnonzero(self.grid[:, i] <= 0.0)
        if wrong.size:
            raise MeasurementError(
                f"{self._place(int(wrong[0]), column)}: {column.name} is '{self.grid[wrong[0], i]:.10g}'; it is "
                "greater than zero. Correct it, or leave the column out: noise is found from the data."
            )

    def _metres(self, at: list[int]) -> tuple[int, int, float]:
        """The row that is furthest from the origin, the column that makes it so, and how far [m]."""
        to_si = np.array([self.layout.numbers[i].to_si for i in at])
        metres = np.nan_to_num(self.grid[:, at]) * to_si
        worst, distance = farthest(metres)
        return worst, at[int(np.argmax(np.abs(metres[worst])))], distance

    def _far(self, at: list[int], what: str) -> None:
        """Refuse a row further from the origin than any robot cell is wide."""
        worst, i, distance = self._metres(at)
        if distance > FAR_M:
            self._refuse(worst, i, "m", f"{what} than {FAR_M:g} m")

    def _near(self, at: list[int], what: str) -> None:
        """Refuse lengths that are all shorter than a robot moves."""
        worst, i, distance = self._metres(at)
        if distance < NEAR_M and _unit(self.layout.numbers[i]).symbol != "m":  # no unit is larger
            self._refuse(worst, i, "m", f"and {what} than {NEAR_M * 1e3:g} mm")

    def _refuse(self, row: int, i: int, si: str, what: str, better: str = "") -> None:
        """Say what was read and which unit would make sense of it."""
        column = self.layout.numbers[i]
        value = float(self.grid[row, i])
        better = better or better_unit(value, _unit(column))
        fix = "Correct the value."
        if better:
            fix = f"If it is in {better}, write '{column.name} [{better}]' into the header."
        raise MeasurementError(
            f"{self._place(row, column)}: {value:.10g} was read as {value * column.to_si:.6g} {si}, {what}. {fix}"
        )

    def _place(self, row: int, column: Column) -> str:
        """Where a value stands."""
        return (
            f"{self.source}, line {self.lines[row]} (row {self.rows[row]}), column '{column.label}'"
        )


def _unit(column: Column) -> Unit:
    """The unit of a column of lengths or angles, which `Layout.find` has made sure of."""
    assert column.unit is not None
    return column.unit
