"""Channels of residuals in tests: lengths in the first three columns, angles behind."""

from __future__ import annotations

import numpy as np

from calib.basics.channels import Channels


def lengths_and_angles(used) -> Channels:
    """Channels of a mask (N, D): vectors of lengths in the first three columns, and of angles in those behind."""
    used = np.asarray(used, dtype=bool)
    behind = np.arange(used.shape[1]) >= 3
    whole = bool(used.shape[1] >= 3 and used[:, :3].any(axis=0).all())
    index = np.where(used, behind.astype(int), -1)
    return Channels(("m", "rad"), (whole, True), index)
