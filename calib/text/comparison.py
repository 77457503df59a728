"""A comparison as text of at most 100 columns, its answer first, and as nested tables for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from calib.errors import choices
from calib.result.calibration import CalibrationValues
from calib.result.calibration_file import versions
from calib.result.comparison import LEVEL, ComparisonValues, own_names, unknown_frame
from calib.text.lines import deg, mm, wrap
from calib.version import __version__

#: The layout of `comparison_table`; a word, so that it is not taken for a result.
COMPARISON_SCHEMA = "comparison 4"

_WHERE = {
    "measured ranges": "the joint values that both measured",
    "joint limits": "the joint limits",
}


def comparison_text(c: ComparisonValues) -> str:
    """The whole text."""
    parts = (
        _heading(c),
        _answer(c),
        "\n".join(wrap(f"Note: {note}") for note in notes(c)),
    )
    return "\n\n".join(part for part in parts if part)


def _both(c: ComparisonValues) -> tuple[tuple[str, str, CalibrationValues], ...]:
    """Letter, name and value of each result."""
    return ("a", c.names[0], c.a), ("b", c.names[1], c.b)


def _heading(c: ComparisonValues) -> str:
    """Which results of which robot."""
    r, lines = c.a.nominal, []
    for letter, name, one in _both(c):
        use = "" if one.verdict is None else f", verdict: {one.verdict.use}"
        data = one.source.name or "memory"
        text = f"{letter}: {name}, {len(one.rows)} rows of {data}, model '{one.model.name}'{use}"
        lines.append(wrap(text, "  "))
    title = f"calib {__version__}: two calibrations of robot '{r.name}', {r.base} to {r.tip}"
    return "\n".join([wrap(title), *lines])


def sentence(c: ComparisonValues) -> str:
    """The answer in a sentence."""
    if c.outcome == "drift":
        move = c.moves[0]
        return (
            f"The robot drifted ({c.test.sigma:.1f} sigma): between a and b its target moved by "
            f"{mm(move.moved)} ± {mm(move.std)} mm rms over {_WHERE[move.where]}."
        )
    return {
        "": "No drift that these data could show.",
        "same data": "Cannot tell whether the robot drifted: both results are made of the same measurements.",
        "bad verdict": "Cannot tell whether the robot drifted: the verdict on "
        f"{_judged(c, 'do not use')} is 'do not use'.",
        "nothing known": "Cannot tell whether the robot drifted: no combination of its parameters is known from both "
        "data. Measure more poses.",
        "other errors": "Cannot tell whether the robot drifted: the results differ by more than chance, but estimate "
        f"different errors ({_only(c)}). Fit both with the same --model.",
    }[c.why]


def _judged(c: ComparisonValues, use: str) -> str:
    """The results with this verdict."""
    found = [n for _, n, one in _both(c) if one.verdict is not None and one.verdict.use == use]
    return " and on ".join(found)


def _only(c: ComparisonValues) -> str:
    """Which parameters only one result has."""
    return " and ".join(
        f"only {name} ('{one.model.name}') has {choices(own, limit=4)}"
        for (_, name, one), own in zip(_both(c), (c.only_a, c.only_b), strict=True)
        if own
    )


def _answer(c: ComparisonValues) -> str:
    """The answer and the numbers behind it."""
    test, below = c.test, []
    if test.combinations and (c.outcome != "cannot tell" or c.only_a or c.only_b):
        odds = f"p = {test.p:.2g}" if test.p > 1e-12 else "p < 1e-12"
        below.append(
            f"Test: chi-square {test.chi_square:.1f} over {test.combinations} combinations known from both data, "
            f"{test.freedom:.0f} d.o.f. of noise: {odds}; a drift below {LEVEL:g}."
        )
    for move in c.moves:
        turn = f", {deg(move.rms_angle)} deg" if np.isfinite(move.rms_angle) else ""
        below.append(
            f"Over {_WHERE[move.where]}: {mm(move.rms)} mm rms{turn}, at most {mm(move.max)} mm; expected from noise "
            f"alone: {mm(move.noise)} mm rms."
        )
    found = ["the base"] * bool(unknown_frame(c.a) or unknown_frame(c.b))
    found += ["the target"] * (c.a.setup.estimate_target or c.b.setup.estimate_target)
    if found:
        lost = f"; a drift of {choices(c.untold, limit=8)} cannot be seen" if c.untold else ""
        below.append(f"Displacements are up to the place of {' and '.join(found)}{lost}.")
    return "\n".join([wrap(sentence(c)), *(wrap(text, "  ") for text in below)])


def notes(c: ComparisonValues) -> tuple[str, ...]:
    """What to mind, sentences."""
    non_geometric = [
        f"{n} ('{one.non_geometric.name}')"
        for _, n, one in _both(c)
        if one.non_geometric is not None
    ]
    bounded = {
        p.name
        for one in (c.a, c.b)
        for p in one.parameters
        if p.at_bound and p.name in own_names(one)
    }
    careful = _judged(c, "use with care")
    names = f"'{c.a.nominal.name}' and '{c.b.nominal.name}'"
    every = {
        f"The URDFs name their robots {names}.": c.a.nominal.name != c.b.nominal.name,
        f"The results estimate different errors: {_only(c)}.": (c.only_a or c.only_b) and not c.why,
        "Both take the measurement frame as known: its error looks like a drift of the first joints.": (
            not unknown_frame(c.a) and not unknown_frame(c.b)
        ),
        f"The non-geometric model of {' and of '.join(non_geometric)} is not compared. Loads, speeds and poses should "
        "be alike in both measurements.": non_geometric,
        f"At a bound, and taken as known there: {choices(sorted(bounded))}.": bounded,
        f"The verdict on {careful} is 'use with care'; see there.": careful,
    }
    return tuple(text for text, applies in every.items() if applies)


def comparison_table(c: ComparisonValues) -> dict[str, Any]:
    """The comparison as nested tables of plain values; the keys are documented in docs/comparison.md."""
    return {
        "schema": COMPARISON_SCHEMA,
        "robot": {"name": c.a.nominal.name, "base": c.a.nominal.base, "tip": c.a.nominal.tip},
        "outcome": c.outcome,
        "why": c.why,
        "test": {**asdict(c.test), "level": LEVEL},
        "moves": [
            {"where": m.where, "moved_rms_m": m.moved, "rms_rad": m.rms_angle}
            | {"rms_m": m.rms, "max_m": m.max, "noise_rms_m": m.noise, "moved_std_m": m.std}
            for m in c.moves
        ],
        **{name: list(getattr(c, name)) for name in ("untold", "only_a", "only_b")},
        "results": [
            {
                "name": name,
                "set": one.model.name,
                "verdict": None if one.verdict is None else one.verdict.use,
                "sigma_m": one.sigma,
                "urdf_sha256": one.nominal.urdf.sha256,
                "measurements_sha256": one.source.sha256,
            }
            for _, name, one in _both(c)
        ],
        "versions": versions(),
    }
