"""The uncertainty budget (JCGM 100): what each source adds to the uncertainty over a set of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.values import Value
from calib.numerics.errors import rms
from calib.uncertainty.at_poses import Distribution, PoseUncertainty, Source


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One line of the budget."""

    source: Source
    #: Standard uncertainty of the position [m] and of the orientation [rad], rms over the poses
    position: float
    orientation: float
    distribution: Distribution
    #: Degrees of freedom; infinite if it is known
    freedom: float
    #: Share of the variance of the position, 0 to 1
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Budget(Value):
    """What the uncertainty over N poses is made of."""

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

    @property
    def factor(self) -> float:
        """Coverage factor k of the position: expanded over combined standard uncertainty."""
        return self.position / self.position_std if self.position_std > 0.0 else np.nan

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
        return cls(
            lines=tuple(lines),
            position_std=total,
            orientation_std=rms(uncertainty.orientation_std),
            position=rms(uncertainty.position),
            orientation=rms(uncertainty.orientation),
            freedom=float(np.median(uncertainty.position_freedom)),
            poses=len(uncertainty.poses),
        )
