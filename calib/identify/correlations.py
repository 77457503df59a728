"""Correlations worth naming: parameters that the measurements know together better than apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors import CalibError
from calib.identify.result import Calibration


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two parameters that the measurements know together better than apart.

    Attributes:
        first: Name of a parameter.
        second: Name of another.
        value: Their correlation, between -1 and 1.
    """

    first: str
    second: str
    value: float


def correlations(calibration: Calibration, above: float = 0.9) -> tuple[Correlation, ...]:
    """Pairs of the geometry's parameters whose estimates hang together, C_ij / sqrt(C_ii C_jj), the closest first.

    Parameters that the measurements know in combinations only are left aside: the prior shares those out, and
    `Calibration.observability` names the combinations.

    Args:
        calibration: The calibration.
        above: Pairs with a larger absolute correlation are named.

    Raises:
        CalibError: The limit is not between 0 and 1.
    """
    if not 0.0 <= above < 1.0:
        raise CalibError(
            f"Correlations above {above:g} were asked for; the limit lies between 0 and 1, such as 0.9."
        )
    chosen = [k for k, p in enumerate(calibration.parameters) if p.identifiable and not p.at_bound]
    names = [calibration.parameters[k].name for k in chosen]
    C = calibration.covariance[np.ix_(chosen, chosen)]
    std = np.sqrt(np.diag(C))
    R = C / np.outer(std, std)
    pairs = [
        Correlation(names[i], names[j], float(R[i, j]))
        for i, j in zip(*np.triu_indices(len(chosen), 1), strict=True)
        if abs(R[i, j]) > above
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.value)))
