"""The figure of the uncertainty budget: a bar for each part, by its share of the variance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calib.result.calibration import Calibration
from calib.show.budget_table import SOURCES
from calib.show.look import CALIBRATED
from calib.show.plotting import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def shares(c: Calibration) -> Figure:
    """Draw the share of each part of the budget in the variance of the position, with its standard uncertainty."""
    lines = c.budget(non_geometric=False).lines
    figure = new_figure(0.3 * len(lines) + 0.9)
    ax = figure.subplots()
    look: dict[str, Any] = {"color": CALIBRATED, "ec": "white", "height": 0.66}
    bars = ax.barh(np.arange(len(lines)), [100.0 * line.share for line in lines], **look)
    sizes = [f"{100.0 * line.share:.0f} %, {1e3 * line.position_std:.3f} mm" for line in lines]
    ax.bar_label(bars, sizes, padding=3, size=8)
    ax.set_yticks(range(len(lines)), [SOURCES[line.source] for line in lines])
    ax.invert_yaxis()
    ax.set_xlim(0.0, 125.0)  # room for the numbers
    ax.set_xticks(range(0, 101, 20))
    ax.set_xlabel("share of the variance of the position [%]")
    ax.grid(visible=False, axis="y")
    return figure
