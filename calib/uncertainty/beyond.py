"""What an observed variance exceeds a known one by: a variance that cannot be negative.

Observed is s^2 with nu degrees of freedom, of which the part a is known to have another cause: the noise of the
instrument in residuals. What remains, v - a, is then distributed like

    v = nu s^2 / chi^2_nu,        given that v >= a

(the posterior of a variance with the usual prior 1 / v, truncated). Its mean m and variance w are those of another
scaled inverse chi-square with nu' = 4 + 2 m^2 / w degrees of freedom and the estimate u^2 = m (nu' - 2) / nu'. For
a = 0 these are s^2 and nu; near s^2 = a, where the difference s^2 - a may vanish by chance, u^2 does not.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtr

#: Fewer degrees of freedom count as so many: an inverse chi-square then has a variance.
_LEAST_FREEDOM = 5.0

#: Shares of an observed variance below which what is left is rounding.
_NOTHING = 1e-12


def variance_beyond(observed: float, freedom: float, known: float) -> tuple[float, float]:
    """Return what an observed variance exceeds a known one by, and the degrees of freedom of that.

    Args:
        observed: s^2, in the square of any unit, 0 or more.
        freedom: Its degrees of freedom nu; below 5 it counts as 5, infinite if s^2 is known.
        known: a, the part with another cause.

    Returns:
        u^2 in the same unit, 0 or more, and its degrees of freedom.
    """
    if not np.isfinite(freedom) or observed <= 0.0:
        return max(observed - known, 0.0), freedom
    nu = max(freedom, _LEAST_FREEDOM)
    if known <= _NOTHING * observed:
        return observed, nu
    limit = nu * observed / known
    tail = float(chdtr(nu, limit))
    if tail == 0.0:  # far less than what is known to be there
        return 0.0, nu
    mean = nu * observed / (nu - 2.0) * float(chdtr(nu - 2.0, limit)) / tail
    square = (nu * observed) ** 2 / ((nu - 2.0) * (nu - 4.0))
    square *= float(chdtr(nu - 4.0, limit)) / tail
    left = mean - known
    spread = square - mean**2
    if left <= _NOTHING * observed or spread <= 0.0:
        return max(left, 0.0), nu
    own = 4.0 + 2.0 * left**2 / spread
    return left * (own - 2.0) / own, own
