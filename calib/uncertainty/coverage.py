"""Coverage factors: the length that an error vector stays below with the probability of k = 2.

The squared length of a normal error with covariance Sigma is a sum of squares weighted by the eigenvalues l of
Sigma. Its three moments c_j = sum l^j are those of a shifted and scaled chi-square with h = c_2^3 / c_3^2 degrees of
freedom (J. P. Imhof, Biometrika 48, 1961, section 4): exact for one direction, for a circle and for a sphere. If Sigma
was estimated with nu degrees of freedom, h F(h, nu) takes the place of chi-square with h, which for one direction
is Student's t.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri, erfc, fdtri

from calib.basics.arrays import Array, read_only

#: Probability that an error along one direction is within two standard deviations, which k = 2 stands for: 95.45 %.
PROBABILITY = 1.0 - float(erfc(np.sqrt(2.0)))


def covered_length(covariance: Array, freedom: Array) -> Array:
    """Return the length that error vectors stay below with `PROBABILITY`.

    Args:
        covariance: shape (N, d, d), covariance of each error vector, in the square of its unit.
        freedom: shape (N,), effective degrees of freedom of each; infinite if it is known.

    Returns:
        shape (N,), expanded uncertainty of the length, in the vector's unit, read-only; 0 for a covariance of 0.
    """
    eigenvalues = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    c1, c2, c3 = (np.sum(eigenvalues**power, axis=1) for power in (1, 2, 3))
    none = c1 <= 0.0
    c2, c3 = np.where(none, 1.0, c2), np.where(none, 1.0, c3)
    h = c2**3 / c3**2
    known = ~np.isfinite(freedom)
    by_chi_square = chdtri(h, 1.0 - PROBABILITY)
    by_f = h * fdtri(h, np.where(known, 1.0, np.maximum(freedom, 1.0)), PROBABILITY)
    quantile = np.where(known, by_chi_square, by_f)
    square = np.where(none, 0.0, c1 + (quantile - h) * np.sqrt(c2 / h))
    return read_only(np.sqrt(np.maximum(square, 0.0)))
