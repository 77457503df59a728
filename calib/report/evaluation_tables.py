"""The tables of an evaluation's report; every cell is the text that `calib evaluate` prints."""

from __future__ import annotations

from collections.abc import Sequence

from calib.channels import RESIDUAL_UNITS
from calib.report.table import MOST_LISTED, Table
from calib.result.acceptance import Acceptance, Assessment
from calib.text.accuracy import (
    ACCURACY_HEADS,
    CHARACTERISTIC_HEADS,
    NAMES,
    accuracy_cells,
    accuracy_title,
    characteristic_cells,
    figures_of,
    pose_cells,
    pose_heads,
)
from calib.text.evaluation import FIGURES, error_blocks
from calib.text.layout.lines import number
from calib.text.layout.sizes import shown
from calib.text.summary import error_cells, error_heads, error_title

#: Digits behind the point of the factor of registration.
_FACTOR_DIGITS = 3


def accuracy(e: Assessment, unit: str) -> Table:
    """Tabulate AP, RP and the largest single error of each robot in one unit; the evaluated robot is strong."""
    robots = figures_of(e)
    rows = accuracy_cells(robots, unit)
    heads = ("robot", *ACCURACY_HEADS)
    strong = [i for i, row in enumerate(rows) if row[0] == NAMES[e.judged]]
    return Table(accuracy_title(robots, unit), heads, rows, "lrrrrrr", strong=strong)


def before_and_after(e: Assessment, unit: str) -> Table:
    """Tabulate the same of the nominal and of the evaluated robot alone."""
    table = accuracy(e, unit)
    names = (NAMES["nominal"], NAMES[e.judged])
    rows = [row for row in table.rows if row[0] in names]
    return table._replace(rows=rows, strong=[len(rows) - 1])


def checks(e: Assessment) -> Table:
    """Tabulate the figure compared with each tolerance, and what counts against it; no rows without a tolerance."""
    a = e.accepted
    return Table(
        "Comparison with the tolerance",
        ("figure A", "A", "factor f", "U (k = 2)", "f A + U", "tolerance T", "outcome"),
        [] if a is None else [_check_row(a, unit) for unit in a.checks],
        "lrrrrrl",
        "f: random errors before targets or frames were registered to these rows, over those after it; 1 without.",
    )


def _check_row(a: Acceptance, unit: str) -> tuple[str, ...]:
    """Return the cells of the check in one unit."""
    check, of_unit = a.checks[unit], RESIDUAL_UNITS[unit]
    name = f"{FIGURES[a.criterion]}, {of_unit.measured} [{of_unit.shown}]"
    return (
        name,
        shown(check.figure, unit),
        number(check.factor, _FACTOR_DIGITS),
        shown(check.uncertainty, unit),
        shown(check.held, unit),
        shown(check.tolerance, unit),
        check.outcome,
    )


def characteristics(e: Assessment) -> Table:
    """Tabulate the further characteristics of the evaluated robot that the rows have."""
    rows = characteristic_cells(e.characteristics[e.judged])
    title = f"Further characteristics by ISO 9283: {NAMES[e.judged]}"
    return Table(title, ("characteristic", *CHARACTERISTIC_HEADS), rows, "llrr")


def poses(e: Assessment, robot: str) -> Table:
    """Tabulate the poses of the evaluated robot, the worst first, at most `MOST_LISTED`.

    Args:
        e: The evaluation.
        robot: The robot in words.
    """
    heads = ("rows", *pose_heads(e))
    rows = list(pose_cells(e, MOST_LISTED))
    more = len(e.accuracies[e.judged].poses) - len(rows)
    notes = ["x, y, z: the mean error along the axes of the base."] if "x" in heads else []
    if more:
        notes.append(f"{more:,} more are in the file of --json.")
    align = "l" + "r" * (len(heads) - 1)
    return Table(f"Poses, the worst first, of {robot}", heads, rows, align, " ".join(notes))


def errors(e: Assessment, unit: str, result: str) -> Table:
    """Tabulate the errors of each robot by set of rows in one unit.

    Args:
        e: The evaluation.
        unit: Symbol of the unit.
        result: Name of the result's file.
    """
    rows: list[Sequence[str]] = []
    robot = ""
    for row in error_blocks(e, unit, result):
        if isinstance(row, str):
            robot = row.removesuffix(":")
            continue
        label, of_rows = row
        rows.append((robot, label.strip(), *error_cells(of_rows[unit])))
        robot = ""
    heads = ("robot", "set", *error_heads(unit))
    title = f"{error_title(unit, e.evaluations['urdf'].channels)} [{RESIDUAL_UNITS[unit].shown}]"
    return Table(title, heads, rows, "ll" + "r" * (len(heads) - 2))
