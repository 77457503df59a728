"""Types of arrays, and what every room does with them: indices of words, read-only copies, inverses of poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Array of numbers.
Array: TypeAlias = NDArray[np.float64]

#: Array of truth values.
Mask: TypeAlias = NDArray[np.bool_]

#: Array of whole numbers.
Integers: TypeAlias = NDArray[np.int_]


def numbered(words: Sequence[str], names: Sequence[str]) -> Integers:
    """Return the index of words in a list of names.

    Args:
        words: N words.
        names: Different names, which all words are among.

    Returns:
        shape (N,), index of each word in ``names``, from 0.

    Raises:
        KeyError: A word is not among the names.
    """
    number = {name: i for i, name in enumerate(names)}
    return np.array([number[word] for word in words], dtype=np.int_)


def read_only(values: ArrayLike) -> Array:
    """Return a copy of values of any shape as a float64 array of that shape that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def rigid_inverse(T: Array) -> Array:
    """Return the inverses (R^T, -R^T p) of poses (R, p), shape (..., 4, 4) [m]."""
    result = np.zeros_like(T)
    R_T = np.swapaxes(T[..., :3, :3], -1, -2)
    result[..., :3, :3] = R_T
    result[..., :3, 3] = -(R_T @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result
