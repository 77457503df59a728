"""The uncertainty budget as a table and in words: what summary, report and certificate share."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.result.calibration import Calibration
from calib.robot.ranges import SPREAD, column_ranges, spread_between
from calib.show.blocks import EVERYWHERE, Medium
from calib.show.lines import deg, listed, mm, number
from calib.show.tables import Column, Row, Table, name_column
from calib.uncertainty.at_poses import Source
from calib.uncertainty.budget import Budget, BudgetLine
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
    Source.UNDETERMINED: "errors that no row determines",
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
    Source.DRIFT: "reference targets between the poses, and a warm-up",
    Source.MODEL: "a model with further families of errors",
    Source.UNDETERMINED: "poses where none were measured",
    Source.RESOLUTION: "joint readings with more digits",
    Source.TEMPERATURE: "a stated, steady temperature",
}

#: Parts are named that halve the whole if they become at most this many times smaller: more is no advice.
_MOST_TIMES = 4.0


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
        Column("share", 7),
    ]

    def row(name: str, position: float, orientation: float, *others: str) -> Row:
        return (name, position, *[orientation] * angles, *others)

    rows = [
        row(
            SOURCES[line.source],
            line.position,
            line.orientation,
            line.distribution.value,
            number(line.freedom, 0),
            f"{100.0 * line.share:.0f} %",
        )
        for line in budget.lines
    ]
    whole = number(budget.freedom, 0)
    rows.append(row("combined", budget.position_std, budget.orientation_std, "", whole, "100 %"))
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


def budget_sentences(budget: Budget, *, angles: bool = True) -> Iterator[str]:
    """Say what U is, over which poses, which part dominates, and what would halve it.

    Args:
        budget: The budget.
        angles: Whether orientations are said.
    """
    size = f"{mm(budget.position)} mm"
    if angles:
        size += f" and {deg(budget.orientation)} deg"
    yield (
        f"U = {size} within the measured joint ranges, rms over {budget.poses} poses: errors of the target stay below "
        f"with {100.0 * PROBABILITY:.2f} %, the probability of k = 2 along one axis; in space it is "
        f"{budget.factor:.2f} u."
    )
    if not budget.lines:
        return
    first = budget.lines[0]
    text = f"Largest part: {SOURCES[first.source]} ({100.0 * first.share:.0f} %)."
    parts, times = halving(budget)
    if parts:
        named = [f"{SOURCES[line.source]} (by {_REMEDIES[line.source]})" for line in parts]
        text += f" U is halved if it becomes {times:.1f} times smaller"
        if len(parts) > 1 or parts[0] is not first:
            text = text.replace("if it becomes", f"if {len(parts)} parts become")
        text += f": {listed(named)}."
    yield text


def halving(budget: Budget) -> tuple[tuple[BudgetLine, ...], float]:
    """Find the fewest of the largest parts that halve the whole, and how many times smaller they have to be.

    Parts with the share S of the variance, each f times smaller, leave 1 - S + S / f^2 of it, a quarter if
    f = sqrt(S / (S - 3/4)).

    Args:
        budget: The budget.

    Returns:
        The parts and f, at most 4; none and infinity without a variance.
    """
    least_share = 0.75 / (1.0 - _MOST_TIMES**-2)
    share = 0.0
    for count, line in enumerate(budget.lines, start=1):
        share += line.share
        if share >= least_share:
            return budget.lines[:count], float(np.sqrt(share / (share - 0.75)))
    return (), np.inf


def budget_of(result: Calibration) -> Budget:
    """Return the budget of the corrected URDF over poses spread within the measured joint ranges.

    Args:
        result: The calibration, made here or read from its file.
    """
    ranges = result.rows.ranges
    if not np.isfinite(ranges).all():
        ranges = column_ranges(result.nominal)
    q = result.nominal.readings(spread_between(ranges, SPREAD))
    return Budget.of(result.uncertainty(q, non_geometric=False))
