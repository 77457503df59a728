"""The figure of the budget: a bar for each part, as long as its share."""

from __future__ import annotations

import pytest

from calib.show.budget_table import SOURCES
from calib.show.plotting import styled
from calib.verbs.calibrate.figure_budget import shares


def test_bars_are_the_shares_of_the_parts(paper_calibration):
    lines = paper_calibration.budget(non_geometric=False).lines
    with styled():
        (ax,) = shares(paper_calibration).axes
    assert [bar.get_width() for bar in ax.patches] == pytest.approx(
        [100.0 * line.share for line in lines]
    )
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == [SOURCES[line.source] for line in lines]
    # Bars and the numbers beside them stay within the panel.
    assert ax.get_xlim()[1] >= 120.0
