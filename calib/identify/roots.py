"""Square roots of normal matrices: triangles R with R^T R = H, which carry all that many rows say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf

Array = NDArray[np.float64]


def compressed(H: Array) -> Array:
    """A triangle, or square, R with R^T R = H, shape (p, p): all that a problem's rows say, in p of them.

    By Cholesky; by eigenvalues where H is singular to rounding.
    """
    size = np.sqrt(np.maximum(H.diagonal(), np.finfo(np.float64).tiny))
    scaled = H / size / size[:, None]
    root, failed = dpotrf(scaled, lower=0, clean=1)
    if failed:
        values, vectors = np.linalg.eigh(scaled)
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return np.asarray(root * size)


def smallest_eigenvalue(H: Array) -> float:
    """The smallest eigenvalue of a matrix that is scaled to a diagonal of ones."""
    size = np.sqrt(np.maximum(H.diagonal(), np.finfo(np.float64).tiny))
    return float(np.linalg.eigvalsh(H / size / size[:, None])[0])


def triangle_of(A: Array) -> Array:
    """The triangle R of A = Q R, shape (p, p); rows of zeros where A has fewer."""
    p = A.shape[1]
    R = np.zeros((p, p))
    if len(A):
        found = np.linalg.qr(A, mode="r")
        R[: len(found)] = found
    return R


def upper_root(covariance: Array) -> Array:
    """The upper triangle T with C = T^T T of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(covariance)
    return triangle_of(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)
