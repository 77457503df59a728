"""The colours of pictures, pages and figures: who is drawn, and which rows.

From Okabe and Ito's palette, so that any colour vision tells them apart, and with lightnesses that differ within each
group, so that grey print does too. A colour never stands alone: figures add markers, line styles or hatches.
"""

from __future__ import annotations

#: The robots, and what was measured.
NOMINAL = "#45709c"
CALIBRATED = "#ee8420"
MEASURED = "#16202a"

#: The rows: those that the fit has seen, those that it has not, and those that do not belong to the others.
ESTIMATION = "#16202a"
VALIDATION = "#009e73"
OUTLIER = "#c8323c"

#: Lines of sight, and what they come from.
BEAM = "#a0569a"

#: From little to much, from pale to dark: how often the target is somewhere, how badly a position is known.
LITTLE_TO_MUCH = ("#fbe3b0", "#f5b13a", "#d6602a", "#8c2a4f")

#: Text and axes, what stands behind them, and lines of a grid.
INK = "#16202a"
SOFT = "#5a6875"
GRID = "#d8dee4"
