"""Rows that repeat an earlier one to the last digit."""

from __future__ import annotations

import numpy as np

from calib.data.copies import repeats_of_earlier


def test_equal_words_and_numbers_repeat():
    numbers = np.array([[1.0, np.nan], [1.0, np.nan], [1.0, 2.0], [1.0, np.nan]])
    words = [("a",), ("a",), ("a",), ("b",)]
    assert repeats_of_earlier(words, numbers).tolist() == [False, True, False, False]
