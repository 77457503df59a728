"""Noise of the instrument as a cell states it, for scenarios that state none themselves."""

from __future__ import annotations

from typing import Final

from calib.data.cell import Cell
from calib.data.surroundings import TrackerNoise

#: Noise of lengths where neither a scenario nor its cell states one. A scenario that has this very object states none.
USUAL_NOISE: Final = TrackerNoise()


def cell_noise(cell: Cell) -> TrackerNoise:
    """Return the noise of lengths: the cell's ``sigma["m"]``, else its tracker's, else the usual one."""
    if "m" in cell.sigma:
        return TrackerNoise(cell.sigma["m"], 0.0, 0.0)
    return USUAL_NOISE if cell.tracker is None else cell.tracker.noise


def further_noise(cell: Cell) -> dict[str, float]:
    """Return the standard deviation of one scalar in the units of ``cell.sigma`` other than of length."""
    return {unit: std for unit, std in cell.sigma.items() if unit != "m"}
