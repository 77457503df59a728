"""The tables of an evaluation: errors, accuracy and repeatability by ISO 9283, poses, comparison with a tolerance."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.channels import RESIDUAL_UNITS
from calib.show.blocks import HTML, TERMINAL, Medium
from calib.show.error_tables import (
    ERROR_COLUMNS,
    ErrorColumn,
    ErrorRow,
    error_table,
    error_title,
)
from calib.show.lines import WIDTH, number, plural
from calib.show.tables import (
    MOST_LISTED,
    Cell,
    Column,
    Row,
    Table,
    name_column,
    residual_column,
)
from calib.show.words import shown
from calib.verbs.evaluate.acceptance import Acceptance, Assessment
from calib.verbs.evaluate.accuracy import FEWEST_REPEATS, Accuracy, PoseAccuracy
from calib.verbs.evaluate.characteristics import DRIFT_REPEATS, Characteristic
from calib.verbs.evaluate.text import (
    FIGURE_KEYS,
    FIGURES,
    NAMES,
    decisive_sum,
    named_robot,
    rows_label,
)

#: Names of figures by their keys in `Accuracy.figures`.
_FIGURE_NAMES = {
    "ap_max": "AP max",
    "ap_mean": "AP mean",
    "rp_max": "RP max",
    "single_max": "single max",
}

#: Those that stand on the first page, with or without a tolerance.
_FIRST_PAGE = ("ap_max", "ap_mean", "rp_max")

#: Characters of the label of a pose; longer ones are shortened.
_LABEL = 22

#: Characteristics by their symbols: name, what it is of, and what the rows must have.
_CHARACTERISTICS = {
    "AD": ("distance accuracy", "pair", "positions of two poses of one target"),
    "RD": ("distance repeatability", "pair", f"two poses, each measured {FEWEST_REPEATS} times"),
    "vAP": (
        "variation between approaches",
        "pose",
        f"two approaches to a pose (column 'approach'), each measured {FEWEST_REPEATS} times",
    ),
    "dAP": ("drift of accuracy", "pose", f"{2 * DRIFT_REPEATS} repeats of a pose"),
    "dRP": ("drift of repeatability", "pose", f"{2 * DRIFT_REPEATS} repeats of a pose"),
}


# Errors


def errors(
    e: Assessment, result: str, columns: Sequence[ErrorColumn] = ERROR_COLUMNS
) -> Iterator[Table]:
    """Tabulate the errors of each robot by set of rows, in each unit that was measured.

    Args:
        e: The evaluation.
        result: Name of the result's file.
        columns: The columns after the number of rows: largest, mean, rms and spans unless given.
    """
    channels = e.evaluations["urdf"].channels
    for unit in channels.present:
        rows: list[ErrorRow | str] = []
        for who, evaluation in e.evaluations.items():
            name = named_robot(who, result)
            rows.append(textwrap.shorten(name, WIDTH - 1, placeholder="...") + ":")
            counts = {key: of_set[unit].n for key, of_set in evaluation.errors.items()}
            one_set = counts["all"] in (counts["estimation"], counts["validation"])
            validated = np.any(evaluation.measurements.validation)
            for key, of_set in evaluation.errors.items():
                if key == "all" and one_set:
                    continue
                # Without validation rows, nothing says that anything is estimated from these.
                is_plain = key == "estimation" and not validated
                rows.append(ErrorRow(f"{'measured' if is_plain else key} rows", of_set))
            for chain, of_chain in evaluation.errors_by_chain.items():
                rows.append(ErrorRow(chain, of_chain))
        table = error_table(error_title(unit, channels), unit, rows, columns, names="set")
        yield replace(table, indent="  ")


def image_errors(e: Assessment) -> Table:
    """Tabulate the mean, 95 % and largest error of images in px, its bias, and the first three in mm at the board.

    There is a row for each robot; none without images.
    """
    rows: list[Row] = []
    for who, evaluation in e.evaluations.items():
        i = evaluation.images
        if i is not None:
            pixels = (i.mean, i.p95, i.largest, *i.bias)
            lengths = (i.mean_at_board, i.p95_at_board, i.largest_at_board)
            rows.append((NAMES[who], *pixels, *lengths))
    columns = (
        name_column("", 26),
        *(
            residual_column(head, "px", 8)
            for head in ("mean px", "95 %", "max", "bias u", "bias v")
        ),
        *(residual_column(head, "m", 8) for head in ("mean mm", "95 %", "max")),
    )
    return Table("Corners of images", columns, rows, indent="  ")


def board_errors(e: Assessment) -> Table:
    """Tabulate the rms errors of boards across and along the line of sight; a row for each robot."""
    rows: list[Row] = []
    for who, evaluation in e.evaluations.items():
        board = None if evaluation.images is None else evaluation.images.board
        if board is not None:
            across = (board.across, board.across_alone, board.predicted_across)
            depth = (board.depth, board.depth_alone, board.predicted_depth)
            bias = (board.depth_bias, board.depth_bias_std)
            rows.append((NAMES[who], *across, *depth, *bias))
    columns = (
        name_column("", 26),
        *(residual_column(head, "m", 9) for head in ("across", "alone", "predicted")),
        *(residual_column(head, "m", 9) for head in ("depth", "alone", "predicted", "bias", "±")),
    )
    return Table("Boards in three dimensions [mm]", columns, rows, indent="  ")


# Accuracy and repeatability


def accuracy_units(robots: Iterable[Accuracy]) -> list[str]:
    """Return the units in which some robot has figures, in the order of `RESIDUAL_UNITS`."""
    units = {unit for accuracy in robots for unit in accuracy.units}
    return [unit for unit in RESIDUAL_UNITS if unit in units]


def accuracies(robots: Mapping[str, Accuracy], judged: str, on: Medium) -> Iterator[Table]:
    """Tabulate AP, RP and the largest single error of robots, in each unit that was measured.

    Args:
        robots: The accuracy of each robot, by its name in `NAMES`.
        judged: The name of the robot that is in bold.
        on: The media that draw the tables.
    """
    poses = [pose for accuracy in robots.values() for pose in accuracy.poses]
    are_points = any(registry.get(pose.kind).coordinates for pose in poses)
    for unit in accuracy_units(robots.values()):
        of_unit = RESIDUAL_UNITS[unit]
        standard = ", ISO 9283" if unit == "rad" else " accuracy"
        title = f"{of_unit.measured.capitalize()}{standard} [{of_unit.shown}]"
        if unit == "m":
            # The accuracy of lengths alone is not that of a pose.
            title = "Pose accuracy, ISO 9283 [mm]" if are_points else "Length accuracy [mm]"
        heads = ("AP max", "mean", "RP max", "mean", "single")
        columns = (
            name_column("robot", 33),
            Column("poses", 5, gap=0),
            *(residual_column(head, unit, 9) for head in heads),
        )
        rows: list[Row] = [
            (NAMES[who], len(accuracy.of("ap", unit)), *accuracy.figures(unit).values())
            for who, accuracy in robots.items()
        ]
        strong = [k for k, who in enumerate(robots) if who == judged]
        yield Table(title, columns, rows, strong=strong, indent="  ", on=on)


def characteristics(found: Sequence[Characteristic], robot: str, on: Medium) -> Table:
    """Tabulate the further characteristics of a robot that the rows have.

    Args:
        found: AD, RD, vAP, dAP and dRP.
        robot: The robot's name.
        on: The media that draw the table.
    """
    rows = []
    for one in found:
        if one.count:
            name, noun, _ = _CHARACTERISTICS[one.symbol]
            label = f"{one.symbol} {name} [{RESIDUAL_UNITS[one.unit].shown}]"
            sizes = [shown(value, one.unit) for value in (one.largest, one.mean)]
            rows.append((label, plural(one.count, noun), *sizes))
    return Table(
        f"Further figures of ISO 9283: {robot}",
        (
            name_column("characteristic", 51),
            *(Column(head, 10) for head in ("of", "max", "mean")),
        ),
        rows,
        "AD: mean error of the distance between two poses; RD: three standard deviations of it. vAP: distance between "
        "the mean errors of two approaches to a pose. dAP, dRP: change of AP and RP from the first ten repeats of a "
        "pose to later ones, in the order of the rows.",
        indent="  ",
        on=on,
    )


def missing(found: Sequence[Characteristic]) -> list[str]:
    """Word what the rows lack for the characteristics of ISO 9283 that are missing: ``"dAP, dRP n/a: needs ..."``."""
    present = {one.symbol for one in found if one.count}
    symbols_by_need: dict[str, list[str]] = {}
    for symbol, (_, _, needed) in _CHARACTERISTICS.items():
        if symbol not in present:
            symbols_by_need.setdefault(needed, []).append(symbol)
    return [
        f"{', '.join(symbols)} n/a: needs {needed}" for needed, symbols in symbols_by_need.items()
    ]


def poses(e: Assessment, robot: str) -> Table:
    """Tabulate the poses of the judged robot, the worst first.

    With an acceptance the worst pose uses most of its tolerance; otherwise it has the largest AP in the first unit that
    was measured. A terminal has the table if there is an acceptance, or if U is known.

    Args:
        e: The evaluation.
        robot: The robot in words.
    """
    judged = e.accuracies[e.judged]
    units = judged.units
    columns = [name_column("rows", 24), Column("repeats", 7)]
    for unit in units:
        of_unit = RESIDUAL_UNITS[unit]
        axes = "xyz" if of_unit.shows_span else ""
        columns.append(residual_column(f"AP [{of_unit.shown}]", unit, 8))
        columns.append(replace(residual_column("U", unit, 7), optional=True))
        columns.append(Column("", left=True, optional=True))
        columns += [residual_column(head, unit, 7) for head in (*axes, "RP")]
        if unit == units[0]:
            columns.append(residual_column("single", unit, 7))

    def largest_error(pose: PoseAccuracy) -> float:
        return pose[units[0]].ap if units[0] in pose.by_unit else 0.0

    several_targets = len({pose.target for pose in judged.poses}) > 1
    several_stations = len({pose.group for pose in judged.poses}) > 1
    worst = e.accepted.used if e.accepted is not None else largest_error
    rows = []
    for pose in sorted(judged.poses, key=worst, reverse=True):
        label = rows_label(pose)
        names = [pose.target] * several_targets + [pose.group] * several_stations
        if names:
            label += f" ({', '.join(names)})"
        cells: list[Cell] = [textwrap.shorten(label, _LABEL, placeholder="..."), len(pose.rows)]
        for unit in units:
            figures = pose[unit]
            cells += [figures.ap, figures.U, "> U" if figures.ap > figures.U else ""]
            if RESIDUAL_UNITS[unit].shows_span:
                cells += figures.ap_axis.tolist()
            cells.append(figures.rp)
            if unit == units[0]:
                cells.append(figures.single)
        rows.append(cells)
    notes = []
    if any(RESIDUAL_UNITS[unit].shows_span for unit in units):
        notes.append("x, y, z: the mean error along the axes of the base.")
    if judged.has_uncertainty:
        notes.append(
            "U: what AP stays below with 95.45 % (as k = 2), by the uncertainties of prediction and measurement."
        )
    return Table(
        f"Poses, the worst first, of {robot}",
        columns,
        rows,
        " ".join(notes),
        most={TERMINAL: 10, HTML: MOST_LISTED},
        elsewhere="the file of --json",
        title_above=True,
        indent="  ",
        on=HTML | TERMINAL if e.accepted is not None or judged.has_uncertainty else HTML,
    )


# Comparison with a tolerance


def before_and_after(e: Assessment) -> Table:
    """Tabulate AP and RP of the nominal and of the judged robot, and the figure that is compared with a tolerance.

    Its rows are in bold, and have uncertainty, the sum that decides, tolerance and outcome; see `checks`.
    """
    a = e.accepted
    compared = "" if a is None else FIGURE_KEYS[a.criterion]
    keys = [key for key in _FIGURE_NAMES if key in (*_FIRST_PAGE, compared)]
    robots = dict.fromkeys(who for who in ("nominal", e.judged) if who in e.accuracies)
    rows: list[Row] = []
    strong = []
    for unit in accuracy_units(e.accuracies.values()):
        for key in keys:
            values = [e.accuracies[who].figures(unit)[key] for who in robots]
            row = [
                f"{_FIGURE_NAMES[key]}, {_measured_in(unit)}",
                *(shown(value, unit) for value in values),
            ]
            if a is not None and key == compared and unit in a.checks:
                strong.append(len(rows))
                row += _check_cells(a, unit)
            elif a is not None:
                row += 4 * [""]
            rows.append(row)
    heads = [NAMES[who] for who in robots]
    if len(heads) > 1:
        heads = [f"before: {heads[0]}", f"after: {heads[1]}"]
    columns = [name_column("figure A"), *map(Column, heads)]
    if a is not None:
        columns += [*map(Column, ("U (k = 2)", "A with U", "tolerance T")), name_column("outcome")]
    return Table("Pose accuracy and repeatability, ISO 9283", columns, rows, strong=strong)


def checks(e: Assessment) -> Table:
    """Tabulate, for HTML, the figure compared with each tolerance, factor, uncertainty, deciding sum, and outcome.

    Without a tolerance there are no rows.
    """
    rows: list[Row] = []
    a = e.accepted
    if a is not None:
        for unit, check in a.checks.items():
            name = f"{FIGURES[a.criterion]}, {_measured_in(unit)}"
            factor = "1" if check.factor == 1.0 else number(check.factor)
            rows.append((name, shown(check.figure, unit), factor, *_check_cells(a, unit)))
    heads = ("A", "factor f", "U (k = 2)", "A with U", "tolerance T")
    return Table(
        "Comparison with the tolerance",
        (name_column("figure A"), *map(Column, heads), name_column("outcome")),
        rows,
        "A with U: f A + U, of a fail A - U. f: random errors before targets or frames were registered to these rows, "
        "over those after it; 1 without.",
        on=HTML,
    )


def _measured_in(unit: str) -> str:
    """Word what is measured in a unit, with the unit that is shown: ``"position [mm]"``."""
    of_unit = RESIDUAL_UNITS[unit]
    return f"{of_unit.measured} [{of_unit.shown}]"


def _check_cells(a: Acceptance, unit: str) -> list[str]:
    """Write uncertainty (a dash if none was stated), deciding sum, tolerance and outcome of the check in a unit.

    Sizes are in the unit that it is shown in, such as mm for ``"m"``, without it.
    """
    check = a.checks[unit]
    uncertainty = shown(check.uncertainty, unit) if check.uncertainty > 0.0 else "-"
    sizes = [shown(value, unit) for value in (decisive_sum(check), check.tolerance)]
    return [uncertainty, *sizes, check.outcome]
