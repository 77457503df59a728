"""A fleet in words: a row for each robot, the fleet's outliers, failed robots, and their counts.

A fleet is here the content of its file ``fleet.json``; see docs/fleet.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from calib.basics.channels import RESIDUAL_UNITS
from calib.show.lines import fill, plural

#: Of more robots than this only those are listed that somebody should look at.
LISTED = 40

#: Robots with the same data that are named; the others are counted.
_MOST_NAMES = 3

_OUTLIERS = "Fleet outliers:"
_COPIES = "Data given twice, which count once in the statistics:"
_WITHHELD = "No corrected URDF, because the verdict is 'do not use' (summary.txt says why; --accept writes it):"
_FAILED = "Failed:"

#: Columns of figures: the heading, and the key of a robot in ``fleet.json``.
_SIZES = {
    "nominal": "nominal_rms",
    "calibrated": "calibrated_rms",
    "held-out": "unseen_rms",
    "noise": "sigma",
}


def figure_text(figure: str, unit: str, value: float, usual: float, z: float, limit: float) -> str:
    """Word a figure that is unlike that of the other robots.

    Args:
        figure: Name of the figure.
        unit: ``"m"``, ``"rad"``, or the unit in which it is given and shown.
        value: Of this robot, in that unit.
        usual: The median over the fleet.
        z: Robust score of the value.
        limit: Scores beyond this are outliers.

    Returns:
        The figure beside the median, in mm or mrad, and the score.
    """
    factor, shown = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}.get(unit, (1.0, unit))
    numbers = f"{factor * value:.4g} {shown}, usually {factor * usual:.4g} {shown}"
    return f"{figure} {numbers} (|z| {abs(z):.1f}, limit {limit:.1f})"


def data_text(others: Sequence[str], source: str) -> str:
    """Word that a robot has the data of others.

    Args:
        others: Their names.
        source: The file of the data.

    Returns:
        The names, the first few of many, and the file.
    """
    names = ", ".join(others[:_MOST_NAMES])
    if len(others) > _MOST_NAMES:
        names += f" and {len(others) - _MOST_NAMES} more"
    return f"the same measurements as {names} ({source})"


def few_text(robots: int, counted: int, needed: int, kind: str) -> str:
    """Word that a fleet is too small for outliers to be detected.

    Args:
        robots: How many robots there are.
        counted: How many of them have data of their own.
        needed: How many are needed.
        kind: The kind of robot; empty if there is only one kind.

    Returns:
        Two sentences.
    """
    present = plural(robots, "robot")
    if counted < robots:
        present += f" with the data of {counted}"
    if kind:
        present += f" of the kind '{kind}'"
    verb = "is" if robots == 1 else "are"
    return (
        f"Outlier detection needs {needed} robots; there {verb} {present}. Only data given "
        "twice are looked for."
    )


def fleet_cells(fleet: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Make the table of robots.

    Args:
        fleet: The content of ``fleet.json``.

    Returns:
        Headings, and the cells of each robot, lengths in mm; of a large fleet only outliers and robots whose verdict
        is not ``use``.
    """
    shown = [robot for robot in fleet["robots"] if not robot["message"]]
    if len(shown) > LISTED:
        outliers = {outlier["name"] for outlier in fleet["outliers"]}
        shown = [
            robot
            for robot in shown
            if robot["name"] in outliers or robot["verdict"] not in ("use", "")
        ]
    heads = ["robot", "verdict", "urdf", "model", *_SIZES, "rows", "out"]
    return heads, [_cells(robot) for robot in shown]


def _cells(robot: Mapping[str, Any]) -> list[str]:
    """Cells of a robot."""
    model = robot["model"]
    if robot["non_geometric"]:
        model += f" ({robot['non_geometric']})"
    sizes = [_leading_size(robot[key]) for key in _SIZES.values()]
    words = [robot["name"], robot["verdict"] or "-", robot["urdf"] or "-", model]
    return [*words, *sizes, str(robot["rows"]), str(robot["outliers"])]


def _leading_size(by_unit: Mapping[str, float | None]) -> str:
    """Format a figure in the first unit that was measured: lengths in mm without the unit; empty if there is none."""
    for symbol, unit in RESIDUAL_UNITS.items():
        value = by_unit.get(symbol)
        if value is not None:
            number = f"{unit.to_shown * value:.{unit.digits}f}"
            return number if symbol == "m" else f"{number} {unit.shown}"
    return ""


def fleet_text(fleet: Mapping[str, Any], kept: int) -> Iterator[str]:
    """Write paragraphs on a fleet: outliers, data given twice, robots without a URDF, failed robots, notes, counts.

    Args:
        fleet: The content of ``fleet.json``.
        kept: How many of its robots an earlier run had calibrated.

    Yields:
        The paragraphs.
    """
    outliers = _texts_by_name(fleet, of_data=False)
    copies = _texts_by_name(fleet, of_data=True)
    withheld = [robot["name"] for robot in fleet["robots"] if robot["urdf"] == "withheld"]
    sections = {
        _OUTLIERS: _lines_by_name(outliers),
        _COPIES: _lines_by_name(copies),
        _WITHHELD: [", ".join(withheld)] if withheld else [],
        _FAILED: _failures(fleet),
    }
    for head, lines in sections.items():
        if lines:
            filled = [fill(line, "  ", "  ") for line in lines]
            yield "\n".join([head, *filled, ""])
    yield from map(fill, fleet["notes"])
    counts = {
        "by an earlier run": kept,
        "outliers": len(outliers),
        "copies": len(copies),
        "withheld": len(withheld),
    }
    yield fill(_counts(fleet, counts))


def _texts_by_name(fleet: Mapping[str, Any], *, of_data: bool) -> dict[str, list[str]]:
    """Collect the texts of a fleet's outliers by the robot's name.

    Args:
        fleet: The content of ``fleet.json``.
        of_data: Whether the outliers are robots with the data of others; else those with an unusual figure.
    """
    texts: dict[str, list[str]] = {}
    for outlier in fleet["outliers"]:
        if (outlier["figure"] == "data") == of_data:
            texts.setdefault(outlier["name"], []).append(outlier["text"])
    return texts


def _lines_by_name(texts_by_name: Mapping[str, Sequence[str]]) -> list[str]:
    """Put the texts of each robot behind its name, in a line."""
    return [f"{name}: {'; '.join(texts)}" for name, texts in texts_by_name.items()]


def _failures(fleet: Mapping[str, Any]) -> list[str]:
    """Write a line for each message of robots that failed, behind their names; ``fleet`` as of ``fleet.json``."""
    names: dict[str, list[str]] = {}
    for robot in fleet["robots"]:
        message = robot["message"]
        if message:
            names.setdefault(message, []).append(robot["name"])
    return [f"{', '.join(failed)}: {message}" for message, failed in names.items()]


def _counts(fleet: Mapping[str, Any], counts: Mapping[str, int]) -> str:
    """Count the robots of a fleet by their outcome, in a sentence."""
    calibrated = [robot for robot in fleet["robots"] if not robot["message"]]
    count = len(fleet["robots"])
    text = f"{len(calibrated)} of {count} robots calibrated"
    verdicts = Counter(robot["verdict"] or "no verdict" for robot in calibrated)
    if verdicts:
        words = ", ".join(f"{number} {verdict}" for verdict, number in verdicts.most_common())
        text += f" ({words})"
    if counts["by an earlier run"]:
        text += f", {counts['by an earlier run']} of them by an earlier run"
    text += f"; {plural(counts['outliers'], 'fleet outlier')}"
    if counts["copies"]:
        text += f", {counts['copies']} with the data of another"
    if counts["withheld"]:
        text += f", {counts['withheld']} without a corrected URDF"
    return f"{text}, {count - len(calibrated)} failed."
