"""The uncertainty budget as a table and in words: what summary, report and certificate share."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.show.blocks import EVERYWHERE, Medium
from calib.show.lines import deg, listed, mm, number
from calib.show.tables import Column, Row, Table, name_column
from calib.uncertainty.at_poses import Source
from calib.uncertainty.budget import Budget
from calib.uncertainty.coverage import PROBABILITY

#: The sources in words, as they stand in tables.
SOURCES = {
    Source.INSTRUMENT: "noise of the measured rows",
    Source.SCALE: "scale of the instrument",
    Source.FRAME: "measurement frame",
    Source.TARGET: "target",
    Source.REPEATABILITY: "repeatability of the robot",
    Source.LOST_MOTION: "lost motion",
    Source.DRIFT: "drift between series",
    Source.MODEL: "what the model lacks",
    Source.UNDETERMINED: "what the rows leave open",
    Source.RESOLUTION: "resolution of the joint readings",
    Source.TEMPERATURE: "temperature",
}

#: What makes a part smaller.
_REMEDIES = {
    Source.INSTRUMENT: "more poses, or an instrument with less noise",
    Source.SCALE: "an instrument whose scale is known better (instrument in the cell file)",
    Source.FRAME: "a frame measured with more points",
    Source.TARGET: "a target whose place is measured better",
    Source.REPEATABILITY: "approaches alike, or another robot",
    Source.LOST_MOTION: "approaches from one side, or the model 'lost_motion'",
    Source.DRIFT: "references measured in every series, and a warm-up",
    Source.MODEL: "a model with further families of errors",
    Source.UNDETERMINED: "poses where none were measured",
    Source.RESOLUTION: "joint readings with more digits",
    Source.TEMPERATURE: "a stated, steady temperature",
}

#: From so many degrees of freedom on a size counts as known: Student's t is then the normal distribution to 0.01 %.
_KNOWN = 1e4


def budget_table(budget: Budget, *, angles: bool = True, on: Medium = EVERYWHERE) -> Table:
    """Tabulate a budget: its lines, the largest share first, the combined standard uncertainty and U.

    Args:
        budget: The budget.
        angles: Whether orientations have a column.
        on: The media that draw it.
    """
    columns = [
        name_column("source", 34),
        Column("u [mm]", 9, unit="mm"),
        *[Column("u [deg]", 8, unit="deg", digits=4)] * angles,
        Column("distribution", 12, left=True, gap=2),
        Column("d.o.f.", 7),
        Column("share [%]", 10),
    ]

    def row(name: str, position: float, orientation: float, *others: str) -> Row:
        return (name, position, *[orientation] * angles, *others)

    rows = [
        row(
            SOURCES[line.source],
            line.position_std,
            line.orientation_std,
            line.distribution.value,
            _freedom(line.freedom),
            f"{100.0 * line.share:.0f}",
        )
        for line in budget.lines
    ]
    whole = _freedom(budget.freedom)
    rows.append(row("combined", budget.position_std, budget.orientation_std, "", whole, "100"))
    rows.append(row("expanded, U (95.45 %)", budget.position, budget.orientation, "", "", ""))
    count = len(rows)
    return Table(
        "Uncertainty budget",
        columns,
        rows,
        "u: root of the sum of the variances along three axes, rms over the poses; shares are of the variance of the "
        "position. d.o.f.: degrees of freedom, a dash where the size is known.",
        strong=(count - 2, count - 1),
        indent="  ",
        on=on,
    )


def _freedom(freedom: float) -> str:
    """Write degrees of freedom; a dash for so many that the size is as good as known."""
    return number(freedom if freedom < _KNOWN else np.inf, 0)


def budget_sentences(budget: Budget, *, angles: bool = True) -> Iterator[str]:
    """Say what U is, over which poses, which part dominates, and what would halve it.

    Args:
        budget: The budget, over poses within the measured joint ranges.
        angles: Whether orientations are said.
    """
    size = f"{mm(budget.position)} mm"
    if angles:
        size += f" and {deg(budget.orientation)} deg"
    yield (
        f"U = {size} within the measured joint ranges, rms over {budget.poses} poses: the target stays nearer to its "
        f"prediction with {100.0 * PROBABILITY:.2f} %, as k = 2 has it along one axis. In space U is "
        f"{budget.factor:.2f} u."
    )
    if budget.dominant is not None:
        text = f"Largest part: {SOURCES[budget.dominant]} ({100.0 * budget.lines[0].share:.0f} %)."
        ways = []
        if budget.halving:
            names = listed([SOURCES[source] for source in budget.halving])
            ways.append(f"without {names}")
        if np.isfinite(budget.rows_factor):
            ways.append(f"with {budget.rows_factor:.1f} times as many rows")
        if ways:
            text += f" Half of U, or less, is left {', or '.join(ways)}."
        remedies = [_REMEDIES[source] for source in budget.halving[:2]]
        if remedies:
            text += f" What reduces it: {'; '.join(remedies)}."
        yield text
    if not budget.separated:
        yield (
            "Nothing states the instrument's noise, so all scatter of the rows counts as the robot's: state it in the "
            "cell file or the table, or measure poses repeatedly."
        )
