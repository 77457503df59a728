"""Detours: a pose to drive by where the straight way between two others is not free."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calib.model.robot import read_only

Array = NDArray[np.float64]

#: Poses that are tried as a stop on the way; most detours are found among the first.
_TRIES = 300


def detour(
    start: Array, end: Array, poses: Array, free_path: Callable[[Array, Array], bool]
) -> Array | None:
    """The pose by which the way from start to end is free, and the shortest of those tried.

    The length of a straight move is that of the joint that turns farthest, max_k |q_bk - q_ak|.

    Args:
        start: shape (m,), [rad] or [m].
        end: shape (m,).
        poses: shape (n, m), free poses to stop at.
        free_path: Whether the straight way between two poses, both shape (m,), is free.

    Returns:
        shape (m,), or None where none of the 300 shortest ways is free.
    """
    length = np.max(np.abs(poses - start), axis=1) + np.max(np.abs(poses - end), axis=1)
    for k in np.argsort(length, kind="stable")[:_TRIES]:
        if free_path(start, poses[k]) and free_path(poses[k], end):
            return read_only(poses[k])
    return None
