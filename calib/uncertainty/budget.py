"""The uncertainty budget (JCGM 100): what each source adds to the uncertainty over a set of poses, and what would help.

Squares are averaged over the poses, so that the lines add up to the whole. The expanded uncertainty of the whole is the
root mean square of that of each pose; `Budget.without` is the same if a source were not there, with the degrees of
freedom that the others have then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import ReadOnlyMapping, Value, keep_read_only
from calib.numerics.errors import rms
from calib.result.calibration import Calibration
from calib.robot.ranges import SPREAD, spread_between, spread_poses
from calib.uncertainty.at_poses import BY_ROWS, Distribution, PoseUncertainty, Source

#: The share of the whole that is aimed at.
_HALF = 0.5

#: The number of times as many rows is found to this share.
_TOLERANCE = 1e-3

#: The most times as many rows that are worth a word.
_MOST_ROWS = 100.0


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One line of the budget."""

    source: Source
    #: Standard uncertainty of the position [m] and of the orientation [rad], rms over the poses
    position_std: float
    orientation_std: float
    distribution: Distribution
    #: Degrees of freedom; infinite if it is known
    freedom: float
    #: Share of the variance of the position, 0 to 1
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Budget(Value):
    """The uncertainty over N poses, by source."""

    #: The sources that add something, the largest share first
    lines: tuple[BudgetLine, ...]
    #: Combined standard uncertainty of the position [m] and of the orientation [rad], rms over the poses
    position_std: float
    orientation_std: float
    #: Expanded uncertainty of the position [m] and of the orientation [rad], rms over the poses
    position: float
    orientation: float
    #: Effective degrees of freedom of the position
    freedom: float
    #: Number of poses
    poses: int
    #: False if nothing separates the instrument's noise from the robot's errors: all of it counts as the robot's
    separated: bool = True
    #: Expanded uncertainty of the position that would be left without each source [m]
    without: Mapping[Source, float] = field(default_factory=ReadOnlyMapping)
    #: The fewest sources without which half the expanded uncertainty of the position is left, or less, the first of
    #: them the largest; empty without poses
    halving: tuple[Source, ...] = ()
    #: How many times as many rows halve it; infinite if no number does
    rows_factor: float = np.inf

    def __post_init__(self) -> None:
        """Keep a read-only copy of the mapping."""
        keep_read_only(self, "without")

    @property
    def factor(self) -> float:
        """Coverage factor k of the position: expanded over combined standard uncertainty."""
        return self.position / self.position_std if self.position_std > 0.0 else np.nan

    @property
    def dominant(self) -> Source | None:
        """The source with the largest share; None if nothing is uncertain."""
        return self.lines[0].source if self.lines else None

    @classmethod
    def of(cls, uncertainty: PoseUncertainty) -> Budget:
        """Sum up the uncertainty of N poses by source.

        Args:
            uncertainty: That of each pose.

        Returns:
            The budget; squares are averaged over the poses, so that the lines add up to the whole.
        """
        total = rms(uncertainty.position_std)
        lines = []
        for part in uncertainty.contributions:
            position = float(np.sqrt(np.mean(np.trace(part.covariance[:, :3, :3], 0, 1, 2))))
            orientation = float(np.sqrt(np.mean(np.trace(part.covariance[:, 3:, 3:], 0, 1, 2))))
            share = position**2 / total**2 if total > 0.0 else 0.0
            if position > 0.0 or orientation > 0.0:
                lines.append(
                    BudgetLine(
                        part.source, position, orientation, part.distribution, part.freedom, share
                    )
                )
        lines.sort(key=lambda line: -line.share)
        sources = tuple(line.source for line in lines)
        return cls(
            lines=tuple(lines),
            position_std=total,
            orientation_std=rms(uncertainty.orientation_std),
            position=rms(uncertainty.position),
            orientation=rms(uncertainty.orientation),
            freedom=float(np.median(uncertainty.position_freedom)),
            poses=len(uncertainty.poses),
            separated=uncertainty.separated,
            without={source: _left(uncertainty, source) for source in sources},
            halving=_halving(uncertainty, sources),
            rows_factor=_rows_factor(uncertainty),
        )


def budget_poses(result: Calibration, *, everywhere: bool = False) -> Array:
    """Return the joint values over which a budget is averaged if none are given.

    Args:
        result: The calibration.
        everywhere: False for values spread evenly over the measured ranges of the joints, True for the joint limits.

    Returns:
        Shape (200, m), [rad] or [m].
    """
    ranges = result.rows.ranges
    if everywhere or not np.all(ranges[:, 0] <= ranges[:, 1]):
        return spread_poses(result.nominal)
    return spread_between(ranges, SPREAD)


def _left(uncertainty: PoseUncertainty, *sources: Source) -> float:
    """Return U of the position without some sources, rms over the poses [m].

    It is not more than with them: degrees of freedom that fall as a well-known source goes do not make it worse.
    """
    return min(rms(uncertainty.without(*sources).position), rms(uncertainty.position))


def _halving(uncertainty: PoseUncertainty, sources: tuple[Source, ...]) -> tuple[Source, ...]:
    """Return the fewest sources, given with the largest first, without which half of U is left, or less.

    Of several sets of as many sources it is the one that leaves least.
    """
    half = _HALF * rms(uncertainty.position)
    for count in range(1, len(sources) + 1):
        left = {chosen: _left(uncertainty, *chosen) for chosen in combinations(sources, count)}
        best = min(left, key=left.__getitem__)
        if left[best] <= half:
            return best
    return ()


def _rows_factor(uncertainty: PoseUncertainty) -> float:
    """Return how many times as many rows halve U; infinite if not even a hundred times as many do."""
    whole = rms(uncertainty.position)

    def excess(logarithm: float) -> float:
        """The excess over half of it, with so many times as many rows."""
        left = uncertainty.without(*BY_ROWS, share=float(np.exp(-logarithm)))
        return rms(left.position) - _HALF * whole

    most = float(np.log(_MOST_ROWS))
    if whole <= 0.0 or excess(most) > 0.0:
        return np.inf
    # By bisection: SciPy's optimisers take longer to import than a budget takes.
    low, high = 0.0, most
    while high - low > _TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return float(np.exp(0.5 * (low + high)))
