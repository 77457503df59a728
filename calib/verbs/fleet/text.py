"""A fleet in words: a row for each robot, the fleet's outliers, failed robots, and their counts.

A fleet is given here as the content of its file ``fleet.json``; see docs/fleet.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from calib.basics.channels import RESIDUAL_UNITS
from calib.show.lines import fill, plural

#: If there are more robots than this, only those that somebody should look at are listed.
LISTED = 40

#: At most this many robots with the same data are named; the others are counted.
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
    """Word a figure that differs from that of the other robots.

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
        robots: Number of robots.
        counted: Number of those with data of their own.
        needed: Number that is needed.
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
        Headings, and the cells of each robot, lengths in mm; failed robots are left out, and of a large fleet all but
        outliers and robots with another verdict than ``use``.
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
    rows = []
    for robot in shown:
        model = robot["model"]
        if robot["non_geometric"]:
            model += f" ({robot['non_geometric']})"
        words = [robot["name"], robot["verdict"] or "-", robot["urdf"] or "-", model]
        sizes = [_leading_size(robot[key]) for key in _SIZES.values()]
        rows.append([*words, *sizes, str(robot["rows"]), str(robot["outliers"])])
    return heads, rows


def _leading_size(by_unit: Mapping[str, float | None]) -> str:
    """Format a figure, given by unit in SI or px, in the first unit that it has; empty if there is none.

    Lengths are in mm without the unit, others with theirs.
    """
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
        kept: Number of its robots that an earlier run had calibrated.

    Yields:
        The paragraphs.
    """
    unusual: dict[str, list[str]] = {}
    copies: dict[str, list[str]] = {}
    for outlier in fleet["outliers"]:
        texts = copies if outlier["figure"] == "data" else unusual
        texts.setdefault(outlier["name"], []).append(outlier["text"])
    withheld = [robot["name"] for robot in fleet["robots"] if robot["urdf"] == "withheld"]
    calibrated = [robot for robot in fleet["robots"] if not robot["message"]]
    failed: dict[str, list[str]] = {}  # names by message
    for robot in fleet["robots"]:
        if robot["message"]:
            failed.setdefault(robot["message"], []).append(robot["name"])

    sections = {
        _OUTLIERS: [f"{name}: {'; '.join(texts)}" for name, texts in unusual.items()],
        _COPIES: [f"{name}: {'; '.join(texts)}" for name, texts in copies.items()],
        _WITHHELD: [", ".join(withheld)] if withheld else [],
        _FAILED: [f"{', '.join(names)}: {message}" for message, names in failed.items()],
    }
    for head, lines in sections.items():
        if lines:
            filled = [fill(line, "  ", "  ") for line in lines]
            yield "\n".join([head, *filled, ""])
    yield from map(fill, fleet["notes"])

    count = len(fleet["robots"])
    sentence = f"{len(calibrated)} of {count} robots calibrated"
    verdicts = Counter(robot["verdict"] or "no verdict" for robot in calibrated)
    if verdicts:
        words = ", ".join(f"{number} {verdict}" for verdict, number in verdicts.most_common())
        sentence += f" ({words})"
    if kept:
        sentence += f", {kept} of them by an earlier run"
    sentence += f"; {plural(len(unusual), 'fleet outlier')}"
    if copies:
        sentence += f", {len(copies)} with the data of another"
    if withheld:
        sentence += f", {len(withheld)} without a corrected URDF"
    yield fill(f"{sentence}, {count - len(calibrated)} failed.")
