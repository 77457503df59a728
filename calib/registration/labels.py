"""Labels of rows as numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from calib.units import Integers


def numbered(words: Sequence[str], names: Sequence[str]) -> Integers:
    """The number of each word among some names, shape (N,)."""
    number = {name: i for i, name in enumerate(names)}
    return np.array([number[word] for word in words], dtype=np.int_)


def joined_labels(labels: Integers, pairs: Sequence[tuple[int, int]]) -> Integers:
    """Labels after joining those of some pairs of entries, numbered from 0 in order."""
    if len(pairs):
        count = int(labels.max()) + 1
        one, other = labels[np.array(pairs)].T
        graph = coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
        # Components are numbered in the order of their smallest labels.
        labels = connected_components(graph, directed=False)[1][labels]
    return np.unique(labels, return_inverse=True)[1].reshape(-1)
