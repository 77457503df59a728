"""Labels of rows as numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from calib.basics.arrays import Integers


def numbered(words: Sequence[str], names: Sequence[str]) -> Integers:
    """Return the index of words in a list of names.

    Args:
        words: N words.
        names: Different names, which all words are among.

    Returns:
        shape (N,), index of each word in ``names``, from 0.

    Raises:
        KeyError: A word is none of the names.
    """
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
        entries = np.ones(len(first))
        graph = coo_matrix((entries, (first, second)), shape=(count, count))
        # Components are numbered in the order of their smallest labels.
        _, component = connected_components(graph, directed=False)
        labels = component[labels]
    _, number = np.unique(labels, return_inverse=True)
    return number.reshape(-1)
