"""Random numbers that do not disturb each other: one stream for each purpose, all from one seed.

So one thing can be changed about a virtual cell and the rest stays: outliers leave the noise of other rows as it was.
"""

from __future__ import annotations

import numpy as np

from calib.errors import CalibError, choices

#: The purposes, each with a stream of its own. A new one goes to the end: the numbers of the others then stay.
STREAMS = (
    "errors",
    "targets",
    "frames",
    "tracker noise",
    "robot noise",
    "angle noise",
    "encoder",
    "outlier rows",
    "outlier directions",
    "poses",
    "validation poses",
)


def stream(seed: int, purpose: str) -> np.random.Generator:
    """The random numbers of one purpose.

    Args:
        seed: A whole number, 0 or more.
        purpose: One of `STREAMS`.

    Raises:
        CalibError: The seed is negative or no whole number, or there is no such purpose.
    """
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        message = f"The seed is {seed!r}; it must be a whole number, 0 or more."
        raise CalibError(message)
    if purpose not in STREAMS:
        message = f"There are no random numbers for '{purpose}'; there are for {choices(STREAMS)}."
        raise CalibError(message)
    sequence = np.random.SeedSequence(int(seed), spawn_key=(STREAMS.index(purpose),))
    return np.random.default_rng(sequence)
