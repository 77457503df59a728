"""The look that figures and pages share: colours, styles of robots, marks of rows, short names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.basics.arrays import Mask
from calib.result.calibration import Calibration

#: Colour of the nominal robot.
NOMINAL = "#45709c"

#: Colour of the calibrated robot.
CALIBRATED = "#ee8420"

#: Colour of the estimation rows.
ESTIMATION = "#16202a"

#: Colour of the validation rows.
VALIDATION = "#009e73"

#: Colour of the flagged rows of either set.
OUTLIER = "#c8323c"

#: Colour of lines of sight and of the instruments that they come from.
BEAM = "#a0569a"

#: Colours from little (pale) to much (dark): density of the target's positions.
LITTLE_TO_MUCH = ("#fbe3b0", "#f5b13a", "#d6602a", "#8c2a4f")

#: Colours from sure (light) to unsure (dark): uncertainty over the workspace, on figures and on the 3-D page.
SURE_TO_UNSURE = ("#9bd7a0", "#36a796", "#2b7098", "#433585", "#2b0d42")

#: Colour of text and axes.
INK = "#16202a"

#: Colour of secondary text, axes and guide lines.
SOFT = "#5a6875"

#: Markers of more outliers than this are half as large.
_MANY_OUTLIERS = 40

#: Markers of more other rows than this are half as large and have no white edge.
_MANY_ROWS = 400


class RobotStyle(NamedTuple):
    """Style in which a robot's errors are drawn; robots differ by more than their colour."""

    #: Text in the legend
    label: str
    #: Colour of lines and areas
    colour: str
    #: Matplotlib's letter of the marker
    marker: str
    #: Matplotlib's line style
    line: str
    #: Matplotlib's pattern of areas
    hatch: str

    @property
    def area(self) -> dict[str, Any]:
        """Properties of the robot's boxes and bars, as matplotlib takes them."""
        return {"alpha": 0.5, "fc": self.colour, "ec": self.colour, "hatch": self.hatch}


BEFORE = RobotStyle("before (nominal)", NOMINAL, "s", "--", "////")
AFTER = RobotStyle("after (calibrated)", CALIBRATED, "o", "-", "")


class RowKind(NamedTuple):
    """A group of rows, and how its rows are marked in every figure."""

    #: ``"estimation"``, ``"validation"`` or ``"outlier"``
    name: str
    #: Shape (N,), its rows among all rows of the table
    mask: Mask
    #: Colour of the markers
    colour: str
    #: Matplotlib's letter of the marker
    marker: str
    #: Size of the markers [pt]
    size: float

    def style(self, factor: float = 1.0) -> dict[str, Any]:
        """Return matplotlib's properties of a line of markers; its label holds the number of rows.

        Args:
            factor: Factor of the markers' size; they are half as large if many rows are drawn.
        """
        is_outlier = self.name == "outlier"
        count = int(np.count_nonzero(self.mask))
        size = factor * self.size
        if count > (_MANY_OUTLIERS if is_outlier else _MANY_ROWS):
            size *= 0.5
        edge = self.colour if is_outlier or count > _MANY_ROWS else "white"
        return {
            "ls": "none",
            "marker": self.marker,
            "ms": size,
            "color": self.colour,
            "mec": edge,
            "mew": 1.4 if is_outlier else 0.4,
            "label": rows_text(self.mask, self.name, "" if is_outlier else " row"),
        }


def row_kinds(c: Calibration) -> tuple[RowKind, ...]:
    """Return estimation rows, validation rows and flagged rows of either set; each row is in one, none is empty."""
    m = c.fit.measurements
    flagged = c.rows.flagged
    kinds = (
        RowKind("estimation", m.estimation & ~flagged, ESTIMATION, "o", 4.2),
        RowKind("validation", m.validation & ~flagged, VALIDATION, "D", 5.0),
        RowKind("outlier", flagged, OUTLIER, "x", 6.0),
    )
    return tuple(kind for kind in kinds if np.any(kind.mask))


def rows_text(mask: Mask, kind: str, noun: str = " row") -> str:
    """Word the number of rows of a mask, such as ``"1 estimation row"``.

    Args:
        mask: shape (N,), the rows that count.
        kind: The word before the noun.
        noun: The noun in singular, with a blank before it; empty if ``kind`` is the noun.
    """
    count = int(np.count_nonzero(mask))
    plural = "" if count == 1 else "s"
    return f"{count:,} {kind}{noun}{plural}"


def short_names(names: Sequence[str], longest: int = 26) -> list[str]:
    """Shorten names that are too long for an axis: their middle becomes an ellipsis.

    Args:
        names: Names of joints, parameters and the like; line breaks and tabs become blanks.
        longest: Letters of a name at most.
    """
    shortened = []
    head = longest // 2
    for name in names:
        text = " ".join(name.split())
        if len(text) > longest:
            text = f"{text[:head]}…{text[head + 1 - longest :]}"
        shortened.append(text)
    return shortened
