"""Forecast of the rms error of fresh rows: its distribution, by the errors of held-out rows.

The error of a row is the length of its residual. Of the m rows that the fit held out in turn, S is the mean square of
the errors; T is that of n fresh rows, which were not fitted, at poses like those fitted. Approximately

    log(T / S) ~ N(0, 2 / nu_n + 2 / nu_m)

as of two means of squares with nu_n and nu_m degrees of freedom, those of chi-squares of their means and variances
(F. E. Satterthwaite, Biometrics Bulletin 2, 1946). Rows of one pose are off together, so variances are those of sums
over poses. For squares that are gamma distributed 2 S^2 / var(S) - 2 is unbiased for the degrees of freedom of m rows,
whatever their shape: few for errors along one direction, or with heavy tails. Normal errors have no more than scalars,
N. With the degrees of freedom h of a row,

    h = (2 S^2 / var(S) - 2) / m,        nu_m = (1 - kappa) m h,        1 / nu_n = 1 / (n h) + kappa / N

where kappa is the share of the N held-out scalars that the fit takes up, by the residuals r of the fit to all rows and
c without each: with the leverage H of a row's own scalars r = (1 - H) c, of expected product (1 - H) c^2, so that

    1 - kappa = sum(r c) / sum(c^2)

As much less than m rows is left to the residuals; and kappa of S are errors of kappa N effective parameters, which all
fresh rows share, however many there are.

The median of T is S, not that of S F(nu_n, nu_m), which is larger where nu_m is small: a wild row among few makes both
S large and nu_m small, so that S is then no less than what is to come.

Wild rows would decide a mean of squares. A row is an outlier if its error is above sqrt(S F^-1(1 - a / n; h, m h)), of
held-out rows n is m: one of a table without outliers is with a = 1 %. Scores of the fit do not tell them, as those of
fresh rows are of another distribution than those of fitted ones, which a fit of few rows follows.
"""

from __future__ import annotations

import numbers
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtri, ndtr, ndtri

from calib.basics.arguments import finite_numbers
from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.errors import ArgumentError
from calib.numerics.errors import CrossValidation, rms
from calib.result.calibration import Calibration
from calib.uncertainty.at_poses import Source

#: Probability that the rms error of fresh rows is within the interval.
LEVEL = 0.90

#: Half the width of that interval of a normal variable, in standard deviations.
_BOUND = float(ndtri(0.5 + LEVEL / 2.0))

#: Probability that any row of a table without outliers is taken for one.
_FALSE_ALARM = 0.01

#: The fewest degrees of freedom, below which an interval says nothing.
_FEWEST_FREEDOM = 1.0

#: More degrees of freedom than this are as good as infinitely many.
_MOST_FREEDOM = 1e9

#: Times that outliers are looked for among held-out rows, each time by the others; mostly two settle.
_ROUNDS = 20


@dataclass(frozen=True, slots=True)
class FreshError(Value):
    """The distribution of the rms error of fresh rows, outliers aside."""

    #: Symbol of the unit: ``"m"``, or the first one that was measured
    unit: str
    #: Number n of fresh rows; may be infinite
    rows: float
    #: Median of the rms error, the root of S; at stated joint values with what is not known there [unit]
    rms: float
    #: Degrees of freedom of S, nu_m
    freedom: float
    #: Degrees of freedom of a row, h: 3 of normal errors that are alike in three directions
    freedom_of_row: float
    #: What is left of 1 / nu_n for infinitely many rows, kappa / N
    shared: float
    #: Share of the held-out rows that are outliers
    outliers: float
    #: Number m of held-out rows, outliers included
    held_out: int

    @property
    def spread(self) -> float:
        """Standard deviation of the logarithm of the rms error."""
        by_fresh = 1.0 / (self.rows * self.freedom_of_row) + self.shared
        return float(np.sqrt(0.5 * (by_fresh + 1.0 / self.freedom)))

    @property
    def low(self) -> float:
        """The lower end of the 90 % interval of the rms error, in the unit."""
        return float(self.rms * np.exp(-_BOUND * self.spread))

    @property
    def high(self) -> float:
        """The upper end of the 90 % interval of the rms error, in the unit."""
        return float(self.rms * np.exp(_BOUND * self.spread))

    @property
    def limit(self) -> float:
        """The error above which one of the n rows is an outlier, in the unit."""
        of_held_out = self.freedom_of_row * (1.0 - self.outliers) * self.held_out
        return self.rms * _limit(self.freedom_of_row, of_held_out, self.rows)

    def table(self) -> dict[str, Any]:
        """Return the figures by the unit, as files have them, in SI units."""
        figures = asdict(self) | {"low": self.low, "high": self.high, "limit": self.limit}
        return {figures.pop("unit"): figures}

    def compared(self, errors: ArrayLike) -> FreshRows:
        """Compare fresh rows with the forecast, which becomes one for as many rows.

        Args:
            errors: shape (n,), lengths of their residuals, in the unit.

        Returns:
            Their rms error without outliers, and where in the distribution it is.

        Raises:
            ArgumentError: They are not made of numbers, or there are none.
            ModelError: They have another shape, or one is not finite.
        """
        lengths = finite_numbers(
            "errors", errors, (None,), "the lengths of n residuals, shape (n,)"
        )
        if not len(lengths):
            raise ArgumentError("The argument 'errors' is empty; it must have an error or more.")
        kept = lengths <= replace(self, rows=float(len(lengths))).limit
        if not np.any(kept):  # then they are no accidents
            kept = ~kept
        forecast = replace(self, rows=float(np.sum(kept)))
        found = rms(lengths[kept])
        with np.errstate(divide="ignore", invalid="ignore"):
            score = np.log(found / forecast.rms) / forecast.spread
        probability = float(ndtr(score)) if found != forecast.rms else 0.5
        return FreshRows(forecast, found, probability, int(np.sum(~kept)))


@dataclass(frozen=True, slots=True)
class FreshRows(Value):
    """Fresh rows beside the forecast of their rms error."""

    #: Of as many rows as are no outliers
    forecast: FreshError
    #: Their rms error, in the unit of the forecast
    rms: float
    #: Probability of an rms error that is no larger, between 0 and 1
    probability: float
    #: Number of rows that are outliers
    outliers: int

    @property
    def within(self) -> bool:
        """True if it is within the 90 % interval."""
        return bool(abs(self.probability - 0.5) <= LEVEL / 2.0)

    @property
    def above(self) -> bool:
        """True if it is above the interval."""
        return self.probability > 0.5 + LEVEL / 2.0


def fresh_error(
    held_out: Array,
    fitted: Array,
    poses: Integers,
    flagged: Mask,
    scalars: int,
    unit: str = "m",
) -> FreshError:
    """Forecast the rms error of as many fresh rows as were held out, by the residuals of these.

    Args:
        held_out: shape (m, d), residuals of held-out rows in the unit, 0 where nothing was measured.
        fitted: shape (m, d), residuals of the same rows by the fit to all of them.
        poses: shape (m,), number of the pose of each; two or more of them.
        flagged: shape (m,), rows that the fit took for outliers, with which the search for them begins.
        scalars: Number N of the measured scalars.
        unit: Symbol of the unit.

    Returns:
        The distribution.
    """
    squares = np.sum(held_out**2, axis=1)
    kept = ~flagged if np.any(~flagged) else flagged
    for _ in range(_ROUNDS):
        expected, freedom = _moments(squares[kept], poses[kept])
        limit = expected * _limit(freedom / float(np.sum(kept)), freedom, len(squares)) ** 2
        before, kept = kept, squares <= limit
        if np.array_equal(before, kept):
            break
    expected, freedom = _moments(squares[kept], poses[kept])
    # Errors of normal scalars have no more than one degree of freedom each.
    freedom = min(freedom, scalars * float(np.mean(kept)))
    share = 0.0
    if expected > 0.0:
        products = np.sum(held_out[kept] * fitted[kept])
        share = float(np.clip(1.0 - products / np.sum(squares[kept]), 0.0, 1.0))
    return FreshError(
        unit=unit,
        rows=float(len(squares)),
        rms=float(np.sqrt(expected)),
        freedom=max((1.0 - share) * freedom, _FEWEST_FREEDOM),
        freedom_of_row=freedom / float(np.sum(kept)),
        shared=share / scalars,
        outliers=float(np.mean(~kept)),
        held_out=len(squares),
    )


def _limit(freedom_of_row: float, freedom: float, rows: float) -> float:
    """Return the error above which one of so many rows is an outlier, over the expected rms error."""
    # The tail of infinitely many rows has no end.
    probability = _FALSE_ALARM / min(rows, _MOST_FREEDOM)
    # The upper tail of F is the inverse of the lower one of its inverse, which is not rounded to 1.
    return float(1.0 / np.sqrt(fdtri(freedom, freedom_of_row, probability)))


def _moments(squares: Array, poses: Integers) -> tuple[float, float]:
    """Return the mean of squares (m,), and its degrees of freedom by the scatter of the sums over poses (m,)."""
    _, pose = np.unique(poses, return_inverse=True)
    sums = np.bincount(pose.reshape(-1), squares)
    counts = np.bincount(pose.reshape(-1))
    mean = float(np.mean(squares))
    if len(sums) < 2 or mean <= 0.0:
        return mean, _FEWEST_FREEDOM
    scatter = float(np.sum((sums - mean * counts) ** 2)) * len(sums) / (len(sums) - 1.0)
    variance = scatter / len(squares) ** 2
    if variance <= 0.0:
        return mean, _MOST_FREEDOM
    freedom = 2.0 * mean**2 / variance - 2.0
    return mean, float(np.clip(freedom, _FEWEST_FREEDOM, _MOST_FREEDOM))


def held_out_at_poses(result: Calibration, *, non_geometric: bool) -> CrossValidation | None:
    """Return the errors of held-out poses, of known stations if there are several; None without cross-validation.

    Args:
        result: A calibration.
        non_geometric: Whether they are those of the non-geometric model, if there is one.
    """
    model = result.part(non_geometric=non_geometric)
    return model.pose_validation or model.cross_validation


def forecast(
    result: Calibration,
    rows: float | None = None,
    joints: ArrayLike | None = None,
    *,
    target: str | None = None,
    group: str | None = None,
    non_geometric: bool = True,
) -> FreshError | None:
    """Forecast the rms error of fresh rows of a result; see `Calibration.forecast`.

    Args:
        result: The calibration, made here or read from its file.
        rows: Number of fresh rows, 1 or more; None: as many as were fitted, or as there are joint values.
        joints: shape (k, m) or (m,), where they are measured; None: at poses like those fitted.
        target: Of ``joints``: the name of the target; None: the first.
        group: Of ``joints``: the name of the station; None: the first.
        non_geometric: Whether the non-geometric model predicts, if there is one.

    Returns:
        Its distribution; None without cross-validation.

    Raises:
        ArgumentError: ``rows`` is below 1, or ``joints`` are not made of numbers.
        ModelError: There is no such target or station, or ``joints`` have another shape.
    """
    if rows is not None and not (isinstance(rows, numbers.Real) and rows >= 1.0):
        raise ArgumentError(f"The argument 'rows' is {rows!r}; it must be a number, 1 or more.")
    if joints is not None and np.size(joints) == 0:
        raise ArgumentError("The argument 'joints' has no joint values; give one row or more.")
    validation = held_out_at_poses(result, non_geometric=non_geometric)
    if validation is None or not len(validation.residual):
        return None
    rows_fitted = result.rows.estimation
    residual = result.rows.residual_calibrated
    if non_geometric and result.non_geometric is not None:
        residual = result.non_geometric.residual
    channels = result.rows.channels.select(rows_fitted)
    unit = validation.errors.leading.unit
    of_unit = channels.where(unit)
    measured = np.any(of_unit, axis=1)
    if not np.any(measured):
        return None
    found = fresh_error(
        np.where(of_unit, validation.residual, 0.0)[measured],
        np.where(of_unit, residual[rows_fitted], 0.0)[measured],
        np.asarray(validation.poses)[measured],
        result.rows.flagged[rows_fitted][measured],
        int(np.sum(of_unit)),
        unit,
    )
    if joints is not None and unit == "m":
        at_joints = result.uncertainty(
            joints, target=target, group=group, non_geometric=non_geometric
        ).without(Source.SCALE)  # the same instrument measures fresh rows
        noise = result.noise.sigma_given.get("m", 0.0) if at_joints.separated else 0.0
        there = float(np.sqrt(np.mean(at_joints.position_std**2) + 3.0 * noise**2))
        found = replace(found, rms=max(found.rms, there), rows=float(len(at_joints.poses)))
    return found if rows is None else replace(found, rows=float(rows))
