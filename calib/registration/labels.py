"""Labels of rows as numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from calib.units import Integers


def numbered(words: Sequence[str], names: Sequence[str]) -> Integers:
    """Return the index of each of N words in ``names``, from 0, shape (N,); `KeyError` for one that it lacks."""
    number = {name: i for i, name in enumerate(names)}
    return np.array([number[word] for word in words], dtype=np.int_)


def joined_labels(labels: Integers, pairs: Sequence[tuple[int, int]]) -> Integers:
    """Merge the labels of pairs of entries.

    Args:
        labels: shape (N,), >= 0.
        pairs: Indices of entries whose labels become one.

    Returns:
        shape (N,), merged labels, numbered from 0 in the order of the smallest label of each.
    """
    if len(pairs):
        count = int(labels.max()) + 1
        first, second = labels[np.array(pairs)].T
        graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
        # Components are numbered in the order of their smallest labels.
        component = connected_components(graph, directed=False)[1]
        labels = component[labels]
    return np.unique(labels, return_inverse=True)[1].reshape(-1)
