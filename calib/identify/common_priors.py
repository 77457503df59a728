"""A result brought to the priors that two results share; the equations stand in `calib.identify.drift`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.identify.compared import Compared
from calib.identify.drift import Estimated
from calib.model.observability import steps

Array = NDArray[np.float64]

#: Priors are taken to be no wider than this many steps of 1 mm and 1 mrad when it comes to what the data know.
_WIDEST = 10.0

#: How large a drift the common priors leave room for, in the same steps.
_ROOM = 0.2


def estimated(one: Compared, other: Compared, effect: Array) -> Estimated:
    """A result's own parameters for the test: under priors that both share, and that leave room for a drift.

    Args:
        one: The result.
        other: The one that it is compared with.
        effect: shape (r, p), of its own parameters.
    """
    own, step = one.own, steps(own_units(one))
    of_other = dict(zip(other.names, other.precision, strict=True))
    precision = one.precision.copy()
    shared = [min(precision[k], of_other.get(one.names[k], np.inf)) for k in own]
    # Never wider than anything an arm may err by either: with priors off there is none.
    widest, least = 1.0 / (_WIDEST * step) ** 2, 1.0 / (_ROOM * step) ** 2
    precision[own] = np.clip(shared, widest, least)
    precision[one.at_bound] = 0.0
    C = _under(one, precision)
    noise, of_own = C - (C * precision) @ C, C[np.ix_(own, own)]
    return Estimated(
        effect=effect,
        covariance=of_own,
        noise=noise[np.ix_(own, own)],
        pull=of_own * precision[own],
        prior=1.0 / np.clip(shared, widest, least),
        freedom=one.freedom,
        shift=of_own @ (one.push[own] - precision[own] * one.delta[own]),
    )


def _under(one: Compared, precision: Array) -> Array:
    """The covariance under other priors, (C^-1 + Q - P)^-1, shape (p, p). Parameters at a bound stay there.

    Args:
        one: The result.
        precision: shape (p,), Q.
    """
    free = np.flatnonzero(~one.at_bound)
    block = np.ix_(free, free)
    scale = np.sqrt(np.diag(one.covariance)[free])
    scale = np.where(scale > 0.0, scale, 1.0)
    correlation = one.covariance[block] / np.outer(scale, scale)
    M = np.linalg.pinv(correlation, rcond=1e-14, hermitian=True)
    M += np.diag((precision - one.precision)[free] * scale**2)
    # Scaled anew, so that what had been held tightly does not drown the rest.
    size = 1.0 / np.sqrt(np.maximum(np.diag(M), 1e-12))
    inverse = np.linalg.pinv(M * np.outer(size, size), rcond=1e-13, hermitian=True)
    C = np.zeros_like(one.covariance)
    C[block] = inverse * np.outer(size * scale, size * scale)
    return C


def own_units(one: Compared) -> tuple[str, ...]:
    """The units of the robot's own parameters."""
    return tuple(one.units[k] for k in one.own)
