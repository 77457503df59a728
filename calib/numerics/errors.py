"""Error figures of a set of rows by unit, as in the paper's Tables 4 and 5, and those of cross-validation.

`interval_factor` has the confidence interval of a quantity whose standard deviation is itself estimated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from calib.basics.arrays import Array, Integers, read_only
from calib.basics.channels import RESIDUAL_UNITS, Channels, residual_unit
from calib.basics.values import ReadOnlyMapping


def rms(values: Array) -> float:
    """Return the root mean square over all entries of an array of any shape, in their unit."""
    return float(np.sqrt(np.mean(values**2)))


def interval_factor(freedom: float, level: float = 0.95) -> float:
    """Return half the width of a two-sided confidence interval, by Student's t distribution.

    Args:
        freedom: Degrees of freedom of the standard deviation; below 1 it counts as 1.
        level: Probability that the interval contains the true value, between 0 and 1.

    Returns:
        Half the width, in standard deviations.
    """
    return float(stdtrit(max(freedom, 1.0), 0.5 + level / 2.0))


@dataclass(frozen=True, slots=True, eq=False)
class UnitErrors:
    """Error figures of a set of rows in one unit; the error of a row is the norm over its scalars of that unit."""

    #: Symbol of the unit, of `calib.basics.channels.RESIDUAL_UNITS`: ``"m"``
    unit: str
    #: Number of rows with a scalar of this unit
    n: int
    #: Largest error, in the unit; NaN if n = 0, as all that follow
    max: float
    #: Mean of the errors
    mean: float
    #: Root mean square of the errors
    rms: float
    #: (3,), mean residual along, or about, x, y, z; NaN, as the next two, unless the residuals of all rows are vectors
    mean_axis: Array
    #: (3,), root mean square of the residual along, or about, each axis
    rms_axis: Array
    #: (3,), largest minus smallest residual along, or about, each axis
    span_axis: Array

    @classmethod
    def of(cls, residual: Array, channels: Channels, unit: str) -> UnitErrors:
        """Summarise the residuals of N rows in one unit.

        Args:
            residual: Measured minus predicted, shape (N, D), in the units of its channels.
            channels: The channel of each of its entries.
            unit: Symbol of the unit.

        Returns:
            Figures of the rows with a scalar of this unit, in the unit; NaN if there are none.
        """
        of_unit = channels.where(unit)
        measured = np.any(of_unit, axis=1)
        norms = channels.norms(residual, unit)[measured]
        largest = mean = root_mean_square = np.nan
        if len(norms):
            largest, mean, root_mean_square = norms.max(), norms.mean(), rms(norms)
        columns, are_vectors = channels.vector_columns(unit)
        by_axis = np.full((3, 3), np.nan)
        if len(norms) and np.array_equal(are_vectors, measured):
            vectors = residual[measured][:, columns]
            by_axis[0] = vectors.mean(axis=0)
            by_axis[1] = np.sqrt(np.mean(vectors**2, axis=0))
            by_axis[2] = np.ptp(vectors, axis=0)
        return cls(
            unit=unit,
            n=len(norms),
            max=float(largest),
            mean=float(mean),
            rms=float(root_mean_square),
            mean_axis=read_only(by_axis[0]),
            rms_axis=read_only(by_axis[1]),
            span_axis=read_only(by_axis[2]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Error figures of a set of rows in each unit that was measured; ``errors["m"].rms`` is one of them."""

    #: By the unit's symbol, in the order of `calib.basics.channels.RESIDUAL_UNITS`
    by_unit: Mapping[str, UnitErrors]

    def __post_init__(self) -> None:
        """Keep a copy that cannot be changed."""
        object.__setattr__(self, "by_unit", ReadOnlyMapping(self.by_unit))

    @classmethod
    def of(cls, residual: Array, channels: Channels | None = None) -> Errors:
        """Summarise the residuals of N rows.

        Args:
            residual: Measured minus predicted, shape (N, D); 0 where nothing was measured.
            channels: The channel of each entry; None: lengths [m], of which three columns are vectors along x, y, z.

        Returns:
            Figures in each unit that some row has.

        Example:
            >>> errors = Errors.of(np.array([[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0]]))["m"]
            >>> round(errors.mean, 6), round(errors.rms, 6)
            (0.0025, 0.003536)
        """
        if channels is None:
            channels = Channels.of_unit(np.ones(residual.shape, dtype=bool))
        return cls({unit: UnitErrors.of(residual, channels, unit) for unit in channels.present})

    def __getitem__(self, unit: str) -> UnitErrors:
        """Return the figures in a unit, by its symbol; with n = 0 and NaN if nothing was measured in it.

        Raises:
            CalibError: It is not a unit of residuals.
        """
        symbol = residual_unit(unit).symbol
        if symbol in self.by_unit:
            return self.by_unit[symbol]
        nothing = np.zeros((0, 1))
        return UnitErrors.of(nothing, Channels.of_unit(nothing > 0.0, symbol), symbol)

    @property
    def units(self) -> tuple[str, ...]:
        """Symbols of the units in which something was measured."""
        return tuple(self.by_unit)

    @property
    def leading(self) -> UnitErrors:
        """The figures in the first unit that was measured, of lengths, angles and pixels; without rows, of lengths."""
        return self[next(iter(self.by_unit), next(iter(RESIDUAL_UNITS)))]


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Errors on held-out rows: each row is predicted by a fit without it."""

    #: ``"leave-one-out"``, ``"leave-one-pose-out"``, ``"leave-one-station-out"``, ``"10-fold"``, ...
    method: str
    #: Number of fits
    folds: int
    #: (N,), from 0: rows of the same number are of one pose or one pair, and held out together
    poses: Integers
    #: (N, D), measured minus predicted by the fit without the row, in the units of the rows' channels
    residual: Array
    #: Of all rows
    errors: Errors
    #: Of the rows that the fit to all rows did not flag as outliers
    errors_without_outliers: Errors

    @property
    def holds_out_stations(self) -> bool:
        """True if each fold is of whole stations, which are predicted but for their own frames."""
        return "station" in self.method

    def without_rows(self) -> CrossValidation:
        """Return the same figures without what there is of each row: ``poses`` and ``residual`` are empty."""
        nothing = read_only(np.zeros(0))
        return replace(self, poses=np.zeros(0, dtype=int), residual=nothing)
