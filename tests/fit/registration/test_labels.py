"""Labels of rows as numbers, and labels that are merged."""

from __future__ import annotations

import numpy as np
import pytest

from calib.fit.registration.labels import joined_labels, numbered


def test_words_are_numbered_by_their_place_among_the_names():
    np.testing.assert_array_equal(numbered(["b", "a", "b"], ["a", "b", "c"]), [1, 0, 1])
    with pytest.raises(KeyError):
        numbered(["d"], ["a"])


def test_labels_of_pairs_become_one():
    labels = np.array([0, 1, 2, 3, 3])
    np.testing.assert_array_equal(joined_labels(labels, []), [0, 1, 2, 3, 3])
    # Entries 0 and 2 have one label then, and with entry 2 so has entry 4, whose label entry 3 has too.
    np.testing.assert_array_equal(joined_labels(labels, [(0, 2), (2, 4)]), [0, 1, 0, 0, 0])


def test_labels_are_numbered_anew_from_zero():
    np.testing.assert_array_equal(joined_labels(np.array([7, 4, 7]), []), [1, 0, 1])
