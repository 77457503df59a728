"""The tables of an evaluation's report; every cell is the text that `calib evaluate` prints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from calib.basics.channels import RESIDUAL_UNITS
from calib.show.errors import error_cells, error_heads, error_title
from calib.show.lines import number
from calib.show.sizes import shown
from calib.show.table import MOST_LISTED, Table
from calib.verbs.evaluate.acceptance import Acceptance, Assessment
from calib.verbs.evaluate.accuracy_text import (
    ACCURACY_HEADS,
    CHARACTERISTIC_HEADS,
    NAMES,
    accuracy_cells,
    accuracy_title,
    accuracy_units,
    characteristic_cells,
    figures_of,
    pose_cells,
    pose_heads,
)
from calib.verbs.evaluate.text import FIGURE_KEYS, FIGURES, decisive_sum, error_blocks

#: Names of figures by their keys in `Accuracy.figures`.
_NAMES = {"ap_max": "AP max", "ap_mean": "AP mean", "rp_max": "RP max", "single_max": "single max"}

#: Those that stand on the first page, with or without a tolerance.
_FIRST_PAGE = ("ap_max", "ap_mean", "rp_max")

#: Title of the first page's table.
_FIRST_TITLE = "Pose accuracy and repeatability, ISO 9283"

#: Cells of a row that is not compared with a tolerance.
_NO_CHECK = 4 * ("",)

#: Digits behind the point of the factor of registration.
_FACTOR_DIGITS = 3


def accuracy(e: Assessment, unit: str) -> Table:
    """Tabulate AP, RP and the largest single error of each robot in one unit; the evaluated robot is strong.

    Args:
        e: The evaluation.
        unit: Symbol of the unit.
    """
    robots = figures_of(e)
    rows = accuracy_cells(robots, unit)
    heads = ("robot", *ACCURACY_HEADS)
    strong = [i for i, row in enumerate(rows) if row[0] == NAMES[e.judged]]
    return Table(accuracy_title(robots, unit), heads, rows, "lrrrrrr", strong=strong)


def before_and_after(e: Assessment) -> Table:
    """Tabulate AP and RP of the nominal and of the evaluated robot, and what is compared with a tolerance.

    The rows that are compared are strong, and have what counts against them; see `checks`.
    """
    a = e.accepted
    compared = "" if a is None else FIGURE_KEYS[a.criterion]
    keys = [key for key in _NAMES if key in (*_FIRST_PAGE, compared)]
    shown_robots = dict.fromkeys(who for who in ("nominal", e.judged) if who in e.accuracies)
    rows: list[tuple[str, ...]] = []
    strong = []
    for unit in accuracy_units(figures_of(e)):
        for key in keys:
            values = [e.accuracies[who].figures(unit)[key] for who in shown_robots]
            row = [f"{_NAMES[key]}, {_of_unit(unit)}", *(shown(value, unit) for value in values)]
            if a is not None and key == compared and unit in a.checks:
                strong.append(len(rows))
                row += _check_cells(a, unit)
            elif a is not None:
                row += _NO_CHECK
            rows.append(tuple(row))
    heads = ["figure A", *_robot_heads(shown_robots)]
    align = "l" + "r" * (len(heads) - 1)
    if a is not None:
        heads += ["U (k = 2)", "A with U", "tolerance T", "outcome"]
        align += "rrrl"
    return Table(_FIRST_TITLE, heads, rows, align, strong=strong)


def _robot_heads(robots: Iterable[str]) -> list[str]:
    """Return the heads of the columns of one robot, or of the nominal and the evaluated robot."""
    names = [NAMES[who] for who in robots]
    if len(names) == 1:
        return names
    return [f"before: {names[0]}", f"after: {names[1]}"]


def _of_unit(unit: str) -> str:
    """Word what is measured in a unit, with the unit that is shown: ``"position [mm]"``."""
    of_unit = RESIDUAL_UNITS[unit]
    return f"{of_unit.measured} [{of_unit.shown}]"


def checks(e: Assessment) -> Table:
    """Tabulate the figure compared with each tolerance, and what counts against it; no rows without a tolerance."""
    a = e.accepted
    return Table(
        "Comparison with the tolerance",
        ("figure A", "A", "factor f", "U (k = 2)", "A with U", "tolerance T", "outcome"),
        [] if a is None else [_check_row(a, unit) for unit in a.checks],
        "lrrrrrl",
        "A with U: f A + U, of a fail A - U. f: random errors before targets or frames were registered to these rows, "
        "over those after it; 1 without.",
    )


def _check_row(a: Acceptance, unit: str) -> tuple[str, ...]:
    """Return the cells of the check in one unit."""
    check = a.checks[unit]
    name = f"{FIGURES[a.criterion]}, {_of_unit(unit)}"
    factor = "1" if check.factor == 1.0 else number(check.factor, _FACTOR_DIGITS)
    return (name, shown(check.figure, unit), factor, *_check_cells(a, unit))


def _check_cells(a: Acceptance, unit: str) -> tuple[str, ...]:
    """Return uncertainty, the sum that decides, tolerance and outcome of the check in one unit.

    An uncertainty that was not stated is a dash.
    """
    check = a.checks[unit]
    uncertainty = shown(check.uncertainty, unit) if check.uncertainty > 0.0 else "-"
    values = (decisive_sum(check), check.tolerance)
    return (uncertainty, *(shown(value, unit) for value in values), check.outcome)


def characteristics(e: Assessment) -> Table:
    """Tabulate the further characteristics of the evaluated robot that the rows have."""
    rows = characteristic_cells(e.characteristics[e.judged])
    title = f"Further characteristics by ISO 9283: {NAMES[e.judged]}"
    note = (
        "AD: mean error of the distance between two poses; RD: three standard deviations of it. vAP: distance between "
        "the mean errors of two approaches to a pose. dAP, dRP: change of AP and RP from the first ten repeats of a "
        "pose to later ones, in the order of the rows."
    )
    return Table(title, ("characteristic", *CHARACTERISTIC_HEADS), rows, "llrr", note)


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


def errors(e: Assessment, unit: str) -> Table:
    """Tabulate the errors of each robot by set of rows in one unit.

    Args:
        e: The evaluation.
        unit: Symbol of the unit.
    """
    rows: list[Sequence[str]] = []
    names = iter(NAMES[who] for who in e.evaluations)
    robot = ""
    for row in error_blocks(e, unit, ""):
        if isinstance(row, str):
            robot = next(names)
            continue
        label, of_rows = row
        rows.append((robot, label.strip(), *error_cells(of_rows[unit])))
        robot = ""
    heads = ("robot", "set", *error_heads(unit))
    title = f"{error_title(unit, e.evaluations['urdf'].channels)} [{RESIDUAL_UNITS[unit].shown}]"
    return Table(title, heads, rows, "ll" + "r" * (len(heads) - 2))
