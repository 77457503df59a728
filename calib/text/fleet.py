"""What ``calib fleet`` prints: a row for each robot, the odd ones, the failed ones, and how many there were.

A fleet is here what stands in its file ``fleet.json``; see docs/fleet.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from calib.text.lines import fill

#: More robots than this are counted, and those are listed that need somebody to look at them.
LISTED = 40

_WITHHELD = "No corrected URDF, because the verdict is 'do not use' (summary.txt says why; --accept writes it):"

_SIZES = {
    "nominal": "nominal_rms_m",
    "calibrated": "calibrated_rms_m",
    "unseen": "unseen_rms_m",
    "noise": "sigma_m",
}


def figure_text(figure: str, unit: str, value: float, usual: float, z: float, limit: float) -> str:
    """Why a robot is odd, by a figure."""
    scale, shown = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}.get(unit, (1.0, unit))
    numbers = f"{scale * value:.4g} {shown}, usually {scale * usual:.4g} {shown}"
    return f"{figure} {numbers} (|z| {abs(z):.1f}, limit {limit:.1f})"


def data_text(others: Sequence[str], source: str) -> str:
    """Why a robot is odd, by its data, which are those of others."""
    more = f" and {len(others) - 3} more" * (len(others) > 3)
    return f"the same measurements as {', '.join(others[:3])}{more} ({source})"


def few_text(robots: int, counted: int, needed: int, kind: str) -> str:
    """What cannot be said of so few robots, of a kind, if there are several."""
    text = f"{robots} robot{'s' * (robots > 1)}"
    text += f" with the data of {counted}" * (counted < robots)
    text += f" of the kind '{kind}'" * bool(kind)
    return f"Too few to tell what is usual: {text}; it takes {needed}. Only data given twice are looked for."


def fleet_cells(fleet: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the table of robots; of a large fleet those that are odd or not simply to be used."""
    shown = [robot for robot in fleet["robots"] if not robot["message"]]
    if len(shown) > LISTED:
        odd = {one["name"] for one in fleet["odd"]}
        shown = [r for r in shown if r["name"] in odd or r["verdict"] not in ("use", "")]
    rows = []
    for robot in shown:
        model = robot["model"] + f" ({robot['non_geometric']})" * bool(robot["non_geometric"])
        numbers = (robot[key] for key in _SIZES.values())
        cells = ["" if value is None else f"{1e3 * value:.3f}" for value in numbers]
        counts = [str(robot["rows"]), str(robot["outliers"])]
        words = [robot["verdict"] or "-", robot["urdf"] or "-", model]
        rows.append([robot["name"], *words, *cells, *counts])
    return ["robot", "verdict", "urdf", "model", *_SIZES, "rows", "out"], rows


def fleet_text(fleet: Mapping[str, Any], kept: int) -> Iterator[str]:
    """The odd ones, the failed ones, what could not be said, and how many there were; ``kept`` by an earlier run."""
    odd: dict[str, list[str]] = {}
    twice: dict[str, list[str]] = {}
    failed: dict[str, list[str]] = {}
    for one in fleet["odd"]:
        (twice if one["figure"] == "data" else odd).setdefault(one["name"], []).append(one["text"])
    done = [robot for robot in fleet["robots"] if not robot["message"]]
    withheld = [robot["name"] for robot in fleet["robots"] if robot["urdf"] == "withheld"]
    for robot in fleet["robots"]:
        if robot["message"]:
            failed.setdefault(robot["message"], []).append(robot["name"])
    for head, lines in (
        ("Odd ones out:", [f"{name}: {'; '.join(texts)}" for name, texts in odd.items()]),
        (
            "Data given twice, which count once in what is usual:",
            [f"{name}: {'; '.join(texts)}" for name, texts in twice.items()],
        ),
        (_WITHHELD, [", ".join(withheld)] * bool(withheld)),
        ("Failed:", [f"{', '.join(names)}: {text}" for text, names in failed.items()]),
    ):
        if lines:
            yield "\n".join([head, *(fill(line, "  ", "  ") for line in lines), ""])
    yield from map(fill, fleet["notes"])
    verdicts = Counter(robot["verdict"] or "no verdict" for robot in done)
    words = ", ".join(f"{count} {word}" for word, count in verdicts.most_common())
    count = len(fleet["robots"])
    yield (
        f"{len(done)} of {count} robots calibrated"
        + f" ({words})" * bool(words)
        + f", {kept} of them by an earlier run" * bool(kept)
        + f"; {len(odd)} odd"
        + f", {len(twice)} with the data of another" * bool(twice)
        + f", {len(withheld)} without a corrected URDF" * bool(withheld)
        + f", {count - len(done)} failed."
    )
