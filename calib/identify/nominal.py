"""The nominal robot on the rows of a table: where frames and targets stand for it, and what it leaves over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.identify.registration import register_seen
from calib.identify.rows import Rows, evenly, thinned
from calib.identify.setup import Setup
from calib.identify.statistics import Mask
from calib.model.kernel import over_blocks
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: A row that is this many median distances off does not take part in a nominal robot's registration.
_GROSS = 5.0
_GROSS_ROUNDS = 5

#: Rows in which gross ones are looked for; more do not change where targets and frames are registered.
ENOUGH = 20_000


def nominal_on(robot: Robot, setup: Setup, every: Rows, mask: Mask) -> tuple[Setup, Array]:
    """Frames and targets as given, or as the nominal robot registers them, and its residual on all rows.

    Args:
        robot: The nominal robot.
        setup: What is known.
        every: N rows.
        mask: shape (N,), the rows to register with.

    Returns:
        The set-up, and measured minus predicted, shape (N, D), [m] and [rad].
    """
    rows = thinned(every.select(mask), ENOUGH)
    placed = nominal_setup(robot.poses(rows.joints), setup, rows)
    return placed, residual_of(robot, placed, every)


def residual_of(robot: Robot, setup: Setup, rows: Rows) -> Array:
    """Measured minus what a robot predicts in a set-up, shape (N, D), [m] and [rad]."""
    return rows.residual(seen_from(setup, robot.poses(rows.joints), rows))


def nominal_setup(T_base_tip: Array, setup: Setup, rows: Rows) -> Setup:
    """Frames and targets as given; those that were not given as the nominal robot registers them.

    Args:
        T_base_tip: shape (N, 4, 4), poses of the nominal robot [m].
        setup: What is known.
        rows: N rows.
    """
    asked = setup.as_known(setup.frame_given, setup.target_given)
    return register_without_gross(T_base_tip, asked, rows)


def register_without_gross(T_base_tip: Array, setup: Setup, rows: Rows) -> Setup:
    """The set-up registered to a nominal robot, without the rows that lie far from the others.

    One gross row would move target and frame, and with them the errors of the nominal robot on every other row.

    Args:
        T_base_tip: shape (N, 4, 4), poses of the nominal robot [m].
        setup: What is known.
        rows: N rows.
    """
    if len(rows) > ENOUGH:
        some = evenly(rows, ENOUGH)
        T_base_tip, rows = T_base_tip[some], rows.select(some)
    kept = np.ones(len(rows), dtype=bool)
    registered = register_seen(T_base_tip, setup, rows)
    alive = np.any(rows.used, axis=1)
    for _ in range(_GROSS_ROUNDS if setup.count else 0):
        residual = rows.residual(seen_from(registered, T_base_tip, rows))
        distance = np.sqrt(np.sum((residual / rows.scales) ** 2, axis=1))
        near = (distance <= _GROSS * np.median(distance[alive])) | ~alive
        if np.array_equal(near, kept) or np.sum(near & alive) < 0.6 * np.sum(alive):
            break
        if not _keeps_setups(near, rows):
            break
        kept = near
        chosen = kept | _partners_of(kept, rows)
        registered = register_seen(T_base_tip[chosen], setup, rows.select(chosen))
    return registered


def without_outliers(rows: Rows, outliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The rows to register with, shape (N,): not the outliers, unless they are half of a set-up's rows.

    Args:
        rows: The rows.
        outliers: shape (N,), those that do not belong to the others.
    """
    kept = ~outliers
    if not _keeps_setups(kept, rows):
        return np.ones(len(rows), dtype=bool)
    return kept | _partners_of(kept, rows)


def _keeps_setups(kept: NDArray[np.bool_], rows: Rows) -> bool:
    """Whether more than half of each set-up's rows are kept."""
    count, every = np.bincount(rows.samples.frame[kept]), np.bincount(rows.samples.frame)
    count = np.append(count, np.zeros(len(every) - len(count), dtype=int))
    return bool(np.all(2 * count >= every))


def _partners_of(kept: NDArray[np.bool_], rows: Rows) -> NDArray[np.bool_]:
    """The second rows of the pairs that are kept."""
    result = np.zeros(len(rows), dtype=bool)
    result[rows.partner[kept & (rows.partner >= 0)]] = True
    return result


def seen_from(setup: Setup, T_base_tip: Array, rows: Rows) -> Array:
    """T_frame_target of each row, shape (N, 4, 4), [m]."""
    frame, target = rows.samples.frame, rows.samples.target
    result = np.empty((len(rows), 4, 4))

    def work(own: slice) -> None:
        T_frame_tip = setup.T_frame_base[frame[own]] @ T_base_tip[own]
        np.matmul(T_frame_tip, setup.T_tip_target[target[own]], out=result[own])

    over_blocks(work, len(rows))
    return result
