"""Random numbers of a virtual cell: each purpose has its own, all from one seed.

So one thing about a virtual cell can be changed and the rest stays: outliers do not change the noise of other rows.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arguments import check_type
from calib.basics.channels import RESIDUAL_UNITS
from calib.errors import CalibError

#: Purposes of random numbers. A new one goes to the end, so that the numbers of the others stay.
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
    # The noise of units of residuals that came later.
    *(f"{unit.quantity} noise" for unit in tuple(RESIDUAL_UNITS.values())[2:]),
    # Of cells with a camera.
    "camera",
    "board",
    "mounts",
    "views",
    "validation views",
    "pictures",
    # Of targets that stand still.
    "references",
    "reference noise",
    # Of an operator who measures stop by stop.
    "mistakes",
    "readings",
)


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Return a new generator of the random numbers of a purpose, one of `STREAMS`, the same for the same seed.

    A seed that is not a whole number, or is negative, raises `CalibError`.
    """
    check_type("seed", seed, (int, np.integer), "a whole number, 0 or more")
    if seed < 0:
        raise CalibError(f"The seed is {seed}; it must be a whole number, 0 or more.")
    sequence = np.random.SeedSequence(int(seed), spawn_key=(STREAMS.index(purpose),))
    return np.random.default_rng(sequence)


def seed_of_reading(seed: int, number: int) -> int:
    """Return the seed of one reading among those that are taken one by one, by its number from 1."""
    sequence = np.random.SeedSequence(int(seed), spawn_key=(STREAMS.index("readings"), number))
    return int(sequence.generate_state(1, np.uint64)[0])
