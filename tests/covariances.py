"""Covariances of poses, and errors drawn from them."""

from __future__ import annotations

import numpy as np

#: Standard deviations that covariances are about: of the position [m], of the orientation [rad].
SIZES = np.repeat([1e-4, 1e-3], 3)


def random_covariances(rng, count, spread=1.0):
    """Covariances of poses, (count, 6, 6), each of its own correlations and sizes."""
    factors = rng.normal(size=(count, 6, 9))
    sizes = SIZES * np.exp(spread * rng.uniform(-0.5, 0.5, (count, 6)))
    factors = sizes[:, :, None] * factors
    return factors @ factors.transpose(0, 2, 1) / 9.0


def draw(rng, covariances):
    """An error of each pose, (count, 6)."""
    factors = np.linalg.cholesky(covariances)
    return np.einsum("nij,nj->ni", factors, rng.normal(size=covariances.shape[:2]))
