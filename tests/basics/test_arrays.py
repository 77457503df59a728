"""Words as numbers."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import numbered


def test_words_are_numbered_by_their_place_among_the_names():
    np.testing.assert_array_equal(numbered(["b", "a", "b"], ["a", "b", "c"]), [1, 0, 1])
    with pytest.raises(KeyError):
        numbered(["d"], ["a"])
