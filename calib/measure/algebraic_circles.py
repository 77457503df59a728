"""Circles through points in space by algebraic fits: starts for the geometric one, and what it is compared with.

The points are projected onto their least-squares plane; there the circle A (x^2 + y^2) + B x + C y + D = 0 is fitted
by least squares of its left side, under a constraint that keeps all four from being zero:

- ``kasa``: A = 1 (I. Kasa, 1976). Linear, and badly biased on short arcs: noise makes the circle too small.
- ``pratt``: B^2 + C^2 - 4 A D = 1 (V. Pratt, 1987).
- ``taubin``: mean squared gradient at the points is 1 (G. Taubin, 1991).

A. Al-Sharadqah and N. Chernov, Error analysis for circle fitting algorithms, Electronic Journal of Statistics 3, 2009,
compare their biases. What noise does to the plane itself is not in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, choices

Array = NDArray[np.float64]


class Ring(NamedTuple):
    """A circle without its uncertainty: centre (3,) [m], unit normal (3,), radius [m]."""

    center: Array
    normal: Array
    radius: float


def algebraic_circle(points: Array, method: str = "taubin", weights: Array | None = None) -> Ring:
    """The circle of an algebraic fit.

    Args:
        points: shape (N, 3), [m]; three or more that are not on a line.
        method: One of `METHODS`.
        weights: shape (N,); None: all alike.

    Raises:
        CalibError: No such method, or the points lie on a line or about one.
    """
    if method not in METHODS:
        message = f"'{method}' is no way to fit a circle; choose one of {choices(METHODS)}."
        raise CalibError(message)
    w = np.ones(len(points)) if weights is None else weights / weights.mean()
    mean, basis, spread = principal_axes(points, w)
    if spread[1] <= 1e-9 * spread[0]:
        message = (
            "the points lie on a line, through which there is no circle. Let the joint turn further, or fix the target "
            "further from its axis"
        )
        raise CalibError(message)
    # In units of their spread: the matrices below hold squares beside ones.
    scale = float(spread[0])
    xy = (points - mean) @ basis[:, :2] / scale
    a, b, c, d = METHODS[method](xy, w)
    if abs(a) <= 1e-12 * np.hypot(b, c):
        message = (
            "no circle is nearer to the points than a straight line is: they lie on both sides of it alike. Let the "
            "joint turn further, or fix the target further from its axis"
        )
        raise CalibError(message)
    center = mean + basis[:, :2] @ (-0.5 * scale / a * np.array([b, c]))
    radius = scale * np.sqrt(b * b + c * c - 4.0 * a * d) / (2.0 * abs(a))
    return Ring(center, basis[:, 2], float(radius))


def principal_axes(points: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Mean of points and their principal axes, weighted.

    Returns:
        The mean, shape (3,) [m]; the axes as columns of a right-handed basis, longest first, shape (3, 3); and the
        standard deviations along them, shape (3,) [m].
    """
    mean: Array = weights @ points / weights.sum()
    share = np.sqrt(weights / weights.sum())
    _, spread, rows = np.linalg.svd(share[:, None] * (points - mean), full_matrices=False)
    basis = rows.T.copy()
    if np.linalg.det(basis) < 0.0:
        basis[:, 2] *= -1.0
    return mean, basis, spread


def _kasa(xy: Array, weights: Array) -> Array:
    """A = 1: a linear problem."""
    root = np.sqrt(weights)[:, None]
    square = (xy * xy).sum(axis=1, keepdims=True)
    columns = np.hstack([xy, np.ones((len(xy), 1))])
    solution = np.linalg.lstsq(root * columns, -(root * square)[:, 0], rcond=None)[0]
    return np.array([1.0, *solution])


def _pratt(xy: Array, weights: Array) -> Array:
    """The generalised eigenvector of the smallest positive eigenvalue, through an SVD."""
    square = (xy * xy).sum(axis=1, keepdims=True)
    design = np.sqrt(weights)[:, None] * np.hstack([square, xy, np.ones((len(xy), 1))])
    # A row of zeros, so that three points have four singular values too.
    _, s, rows = np.linalg.svd(np.vstack([design, np.zeros(4)]), full_matrices=False)
    if s[3] < 1e-12 * s[0]:
        return np.asarray(rows[3])
    root = (rows.T * s) @ rows
    inverse = np.array([[0, 0, 0, -0.5], [0, 1, 0, 0], [0, 0, 1, 0], [-0.5, 0, 0, 0]])
    values, vectors = np.linalg.eigh(root @ inverse @ root)
    # One eigenvalue is negative; the smallest positive one follows it.
    return np.asarray(np.linalg.solve(root, vectors[:, np.argsort(values)[1]]))


def _taubin(xy: Array, weights: Array) -> Array:
    """The right singular vector of the smallest singular value."""
    mean = weights @ xy / weights.sum()
    square = ((xy - mean) ** 2).sum(axis=1)
    height = float(weights @ square / weights.sum())
    first = (square - height) / (2.0 * np.sqrt(height))
    design = np.sqrt(weights)[:, None] * np.column_stack([first, xy - mean])
    a, b, c = np.linalg.svd(design, full_matrices=False)[2][2]
    a /= 2.0 * np.sqrt(height)
    # Back from the mean of the points to the origin.
    x, y = mean
    return np.array(
        [a, b - 2.0 * a * x, c - 2.0 * a * y, -height * a - b * x - c * y + a * (x * x + y * y)]
    )


#: The fits by name, each a function of points (N, 2) and weights (N,) that gives A, B, C, D.
METHODS: Mapping[str, Callable[[Array, Array], Array]] = MappingProxyType(
    {"kasa": _kasa, "pratt": _pratt, "taubin": _taubin}
)
