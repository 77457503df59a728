"""Rows that were copied: they repeat an earlier one to the last digit."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calib.basics.arrays import Array, Mask


def repeats_of_earlier(words: Iterable[tuple[str, ...]], numbers: Array) -> Mask:
    """Mark the rows whose words and numbers are those of an earlier row, to the last digit.

    Args:
        words: Words of each of N rows.
        numbers: shape (N, k), their numbers; NaN is a number as any other.

    Returns:
        shape (N,).
    """
    seen = set()
    result = np.zeros(len(numbers), dtype=np.bool_)
    for i, row_words in enumerate(words):
        key = (*row_words, numbers[i].tobytes())
        result[i] = key in seen
        seen.add(key)
    return result
