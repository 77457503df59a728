"""Residuals of held-out rows: measured minus what a fit without them predicts."""

from __future__ import annotations

from itertools import compress

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.fit.estimate.fitting import Fitted
from calib.fit.registration.registration import register_all_rows
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup


def held_out_residual(fitted: Fitted, rows: Rows, held_out: Mask, outliers: Mask) -> Array:
    """Return the residual of held-out rows, by a fit to the others.

    Args:
        fitted: Fit to all rows except those that are held out.
        rows: The N rows of all folds.
        held_out: True for the n rows that the fit has not used, shape (N,).
        outliers: True for the rows that have no part in a registration, shape (N,).

    Returns:
        Measured minus predicted at the held-out rows, shape (n, D), in the units of the rows' channels.
    """
    samples = rows.samples.select(held_out)
    T_base_tip = fitted.tip_poses(samples)
    setup = fitted.estimated_setup()
    return residual_after_registration(T_base_tip, setup, rows, held_out, ~held_out, outliers)


def residual_after_registration(
    T_base_tip: Array,
    setup: Setup,
    rows: Rows,
    held_out: Mask,
    used: Mask,
    outliers: Mask,
) -> Array:
    """Return the residual of held-out rows; frames and targets that only they see are registered to them first.

    Args:
        T_base_tip: Predicted poses of the tip in the base at the n held-out rows, shape (n, 4, 4), [m].
        setup: Frames and targets as estimated from the rows that were used.
        rows: The N rows of all folds.
        held_out: True for the n rows to predict, shape (N,).
        used: True for the rows from which frames and targets were estimated, shape (N,).
        outliers: True for the rows that have no part in the registration, shape (N,).

    Returns:
        Measured minus predicted at the held-out rows, shape (n, D), in the units of the rows' channels.
    """
    held_out_rows = rows.select(held_out)
    known_frames, known_targets = setup.seen_by(rows.samples.select(used))
    unseen = setup.with_fixed(known_frames, known_targets)
    if unseen.count:
        good = held_out_rows.without(outliers[held_out])
        setup = register_all_rows(T_base_tip[good], unseen, held_out_rows.select(good))
    return held_out_rows.residual(setup.sightings(T_base_tip, held_out_rows.samples))


def seen_only_by(fitted: Fitted, chosen: Mask) -> Mask:
    """Find the parameters of frames and targets that only some rows see.

    Args:
        fitted: A fit with p parameters to N rows.
        chosen: True for the rows in question, shape (N,).

    Returns:
        True for the parameters of frames and targets that none of the other rows sees, shape (p,).
    """
    samples = fitted.estimate.problem.rows.samples
    others = samples.select(~chosen)
    frames, targets = fitted.setup.places
    frames_seen, targets_seen = fitted.setup.seen_by(others)
    unseen_frames = compress(frames, ~frames_seen)
    unseen_targets = compress(targets, ~targets_seen)
    unseen = {*unseen_frames, *unseen_targets}
    parameters = fitted.kinematics.model.parameters
    return np.array([parameter.place in unseen for parameter in parameters], dtype=bool)
