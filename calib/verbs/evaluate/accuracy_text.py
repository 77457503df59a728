"""Accuracy and repeatability of robots by ISO 9283 as tables: cells, which reports show too, and printed text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence

import calib.data.kinds as registry
from calib.basics.channels import RESIDUAL_UNITS
from calib.show.lines import plural, wrap
from calib.show.sizes import shown
from calib.show.tables import Column, name_column, table_lines
from calib.verbs.evaluate.acceptance import Assessment
from calib.verbs.evaluate.accuracy import FEWEST_REPEATS, Accuracy, PoseAccuracy
from calib.verbs.evaluate.characteristics import DRIFT_REPEATS, Characteristic

#: The robots in the tables.
NAMES = {
    "nominal": "nominal",
    "urdf": "URDF as it is",
    "calibration": "calibrated",
    "non_geometric": "non-geometric model",
}

#: Heads of the columns of `accuracy_cells`, but for the first.
ACCURACY_HEADS = ("poses", "AP max", "mean", "RP max", "mean", "single")

#: Heads of the columns of `characteristic_cells`, but for the first.
CHARACTERISTIC_HEADS = ("of", "max", "mean")

#: Poses that are listed; the others are counted.
_MOST_POSES = 10

#: Rows of a pose that are named.
_MOST_ROWS = 3

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


def figures_of(e: Assessment) -> dict[str, Accuracy]:
    """Return the accuracy of each robot of an assessment by its name in tables."""
    return {NAMES[who]: accuracy for who, accuracy in e.accuracies.items()}


# Accuracy and repeatability of the poses


def accuracy_text(robots: Mapping[str, Accuracy]) -> str:
    """Write accuracy AP and repeatability RP of several robots.

    Args:
        robots: The accuracy of each robot, by its name in the table.

    Returns:
        A table for each unit that was measured: of positions [mm], of orientations [deg].
    """
    return "\n\n".join(_accuracy_table(robots, unit) for unit in accuracy_units(robots))


def accuracy_units(robots: Mapping[str, Accuracy]) -> list[str]:
    """Return the units in which some robot has figures, in the order of `RESIDUAL_UNITS`."""
    units = {unit for accuracy in robots.values() for unit in accuracy.units}
    return [unit for unit in RESIDUAL_UNITS if unit in units]


def accuracy_title(robots: Mapping[str, Accuracy], unit: str) -> str:
    """Return the title of a table of accuracies in one unit: the accuracy of lengths alone is none of a pose.

    Args:
        robots: The accuracy of each robot, by its name in the table.
        unit: Symbol of the unit.
    """
    poses = [pose for accuracy in robots.values() for pose in accuracy.poses]
    points = any(registry.get(pose.kind).coordinates for pose in poses)
    if unit == "m":
        return "Pose accuracy, ISO 9283 [mm]" if points else "Length accuracy [mm]"
    of_unit = RESIDUAL_UNITS[unit]
    standard = ", ISO 9283" if unit == "rad" else " accuracy"
    return f"{of_unit.measured.capitalize()}{standard} [{of_unit.shown}]"


def accuracy_cells(robots: Mapping[str, Accuracy], unit: str) -> list[tuple[str, ...]]:
    """Return the rows of a table of accuracies in one unit.

    Args:
        robots: The accuracy of each robot, by its name in the table.
        unit: Symbol of the unit.

    Returns:
        Of each robot its name, and a cell for each of `ACCURACY_HEADS`.
    """
    rows = []
    for name, accuracy in robots.items():
        count = len(accuracy.of("ap", unit))
        figures = [shown(figure, unit) for figure in accuracy.figures(unit).values()]
        rows.append((name, str(count), *figures))
    return rows


def _accuracy_table(robots: Mapping[str, Accuracy], unit: str) -> str:
    """Write a table of accuracies in one unit."""
    count, *figures = ACCURACY_HEADS
    columns = [name_column(accuracy_title(robots, unit), 33), Column(count, 5, gap=0)]
    columns += [Column(head, 9) for head in figures]
    rows = [(f"  {name}", *cells) for name, *cells in accuracy_cells(robots, unit)]
    return "\n".join(table_lines(columns, rows))


# Further characteristics


def characteristics_text(characteristics: Sequence[Characteristic], robot: str) -> str:
    """Write the further characteristics of one robot, and what is missing for those that the rows do not have.

    Args:
        characteristics: AD, RD, vAP, dAP and dRP.
        robot: The robot's name in tables.
    """
    columns = [name_column(f"Further figures of ISO 9283: {robot}", 51)]
    columns += [Column(head, 10) for head in CHARACTERISTIC_HEADS]
    rows: list[Sequence[str] | str] = [
        (f"  {name}", *cells) for name, *cells in characteristic_cells(characteristics)
    ]
    rows += [f"  {symbol} n/a: needs {needed}" for symbol, needed in missing(characteristics)]
    return "\n".join(table_lines(columns, rows))


def characteristic_cells(characteristics: Sequence[Characteristic]) -> list[tuple[str, ...]]:
    """Return the characteristics that the rows have: the name of each, and a cell by `CHARACTERISTIC_HEADS`."""
    rows: list[tuple[str, ...]] = []
    for characteristic in characteristics:
        if characteristic.count:
            unit = characteristic.unit
            name, noun, _ = _CHARACTERISTICS[characteristic.symbol]
            rows.append(
                (
                    f"{characteristic.symbol} {name} [{RESIDUAL_UNITS[unit].shown}]",
                    plural(characteristic.count, noun),
                    shown(characteristic.largest, unit),
                    shown(characteristic.mean, unit),
                )
            )
    return rows


def missing(characteristics: Sequence[Characteristic]) -> list[tuple[str, str]]:
    """Return what is missing for the characteristics that the rows do not have.

    Returns:
        Symbols that need the same, ``"dAP, dRP"``, and what they need, in words.
    """
    present = {characteristic.symbol for characteristic in characteristics if characteristic.count}
    symbols_by_need: dict[str, list[str]] = {}
    for symbol, (_, _, needed) in _CHARACTERISTICS.items():
        if symbol not in present:
            symbols_by_need.setdefault(needed, []).append(symbol)
    return [(", ".join(symbols), needed) for needed, symbols in symbols_by_need.items()]


# The poses


def poses_text(e: Assessment, robot: str) -> str:
    """Write the table of poses, the worst first.

    Args:
        e: The evaluation.
        robot: The evaluated robot in words.

    Returns:
        A line for each of at most ten poses, with AP and RP [mm] and, where orientations were measured, [deg].
    """
    heads = pose_heads(e)
    widths = {"repeats": 7, "single": 7, "RP": 7, "x": 7, "y": 7, "z": 7}
    columns = [name_column("", 24), *(Column(head, widths.get(head, 8)) for head in heads)]
    rows = [(f"  {label}", *cells) for label, *cells in pose_cells(e, _MOST_POSES)]
    lines = [wrap(f"Poses, the worst first, of {robot}:"), *table_lines(columns, rows)]
    more = len(e.accuracies[e.judged].poses) - _MOST_POSES
    if more > 0:
        lines.append(f"  and {more} more")
    return "\n".join(lines)


def pose_heads(e: Assessment) -> list[str]:
    """Return the heads of the columns of `pose_cells`, but for the first."""
    units = e.accuracies[e.judged].units
    heads = ["repeats"]
    for unit in units:
        of_unit = RESIDUAL_UNITS[unit]
        axes = ("x", "y", "z") if of_unit.shows_span else ()
        heads += [f"AP [{of_unit.shown}]", *axes, "RP"]
        if unit == units[0]:
            heads.append("single")
    return heads


def pose_cells(e: Assessment, most: int) -> Iterator[tuple[str, ...]]:
    """Yield a row for each of some poses of the judged robot, the worst first.

    Args:
        e: The evaluation. With an acceptance the worst pose uses most of its tolerance, else it has the largest AP.
        most: The number of poses listed at most.

    Yields:
        The pose's rows, with its target and station where there are several, and a cell for each of `pose_heads`.
    """
    accuracy = e.accuracies[e.judged]
    poses, units = accuracy.poses, accuracy.units
    several_targets = len({pose.target for pose in poses}) > 1
    several_stations = len({pose.group for pose in poses}) > 1
    for pose in _worst_first(e)[:most]:
        names = [pose.target] * several_targets + [pose.group] * several_stations
        yield _pose_row(pose, names, units)


def _worst_first(e: Assessment) -> list[PoseAccuracy]:
    """Return the poses of the judged robot, the worst first."""
    accuracy = e.accuracies[e.judged]
    if e.accepted is not None:
        return sorted(accuracy.poses, key=e.accepted.used, reverse=True)
    unit = accuracy.units[0]
    return sorted(accuracy.poses, key=lambda pose: -pose[unit].ap if unit in pose.by_unit else 0.0)


def _pose_row(pose: PoseAccuracy, names: list[str], units: Sequence[str]) -> tuple[str, ...]:
    """Return the cells of a pose in some units; names are of its target and station where there are several."""
    label = rows_label(pose)
    if names:
        label += f" ({', '.join(names)})"
    cells = [textwrap.shorten(label, _LABEL, placeholder="..."), str(len(pose.rows))]
    for unit in units:
        figures = pose[unit]
        along = figures.ap_axis if RESIDUAL_UNITS[unit].shows_span else ()
        values = [figures.ap, *along, figures.rp]
        if unit == units[0]:
            values.append(figures.single)
        cells += [shown(value, unit) for value in values]
    return tuple(cells)


def rows_label(pose: PoseAccuracy) -> str:
    """Name the rows of a pose: ``row 4``, ``rows 1, 2, 3, ...``; of pairs the first one."""
    rows = pose.rows
    if registry.get(pose.kind).paired:
        rows = rows[:1]
    names = [str(row) for row in rows[:_MOST_ROWS]]
    if len(pose.rows) > _MOST_ROWS:
        names.append("...")
    noun = "rows" if len(rows) > 1 else "row"
    return f"{noun} {', '.join(names)}"
