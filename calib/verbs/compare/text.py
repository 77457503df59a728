"""A comparison as text of at most 100 columns, its answer first, and as nested tables for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from calib.errors import choices
from calib.result.calibration import Calibration
from calib.result.calibration_file import versions
from calib.show.lines import deg, mm, wrap
from calib.show.notebook import chain_name, html_table
from calib.show.short import before_and_after, rms_text
from calib.verbs.compare.comparison import Comparison
from calib.verbs.compare.difference import Displacement, own_names, unknown_frame
from calib.verbs.compare.drift import LEVEL
from calib.version import __version__

#: The layout of `comparison_table`; a word, so that it is not taken for a result.
COMPARISON_SCHEMA = "comparison 5"

#: A p-value below this is shown as such: its digits mean nothing.
_SMALLEST_P = 1e-12

#: Joint values over which predictions are compared.
_WHERE = {
    "measured ranges": "the joint values that both measured",
    "joint limits": "the joint limits",
}


def comparison_text(c: Comparison) -> str:
    """Write a comparison: the results, the answer with its numbers, notes."""
    parts = (
        _heading(c),
        _answer(c),
        "\n".join(wrap(f"Note: {note}") for note in notes(c)),
    )
    return "\n\n".join(part for part in parts if part)


def _both(c: Comparison) -> tuple[tuple[str, str, Calibration], ...]:
    """Letter, name and value of each result."""
    return ("a", c.names[0], c.a), ("b", c.names[1], c.b)


def _heading(c: Comparison) -> str:
    """Name the robot and both results."""
    robot = c.a.nominal
    title = f"calib {__version__}: two calibrations of robot '{robot.name}', {robot.base} to {robot.tip}"
    lines = [wrap(title)]
    for letter, name, result in _both(c):
        data = result.source.name or "memory"
        text = f"{letter}: {name}, {len(result.rows)} rows of {data}, model '{result.model.name}'"
        if result.verdict is not None:
            text += f", verdict: {result.verdict.use}"
        lines.append(wrap(text, "  "))
    return "\n".join(lines)


def sentence(c: Comparison) -> str:
    """Word the answer in a sentence."""
    if c.outcome == "drift":
        move = c.moves[0]
        return (
            f"The robot drifted ({c.test.sigma:.1f} sigma): between a and b its target moved by "
            f"{mm(move.moved)} ± {mm(move.std)} mm rms over {_WHERE[move.where]}."
        )
    if not c.why:
        return "No drift that these data could show."
    return f"Cannot tell whether the robot drifted: {_obstacle(c)}"


def _obstacle(c: Comparison) -> str:
    """Word why no drift can be tested, by the comparison's code."""
    return {
        "same data": "both results are made from the same measurements.",
        "bad verdict": f"the verdict on {_results_with(c, 'do not use')} is 'do not use'.",
        "nothing known": "no combination of its parameters is known from both data. Measure more poses.",
        "other errors": "the results differ by more than chance, but estimate different errors "
        f"({_only(c)}). Fit both with the same --model.",
    }[c.why]


def _results_with(c: Comparison, use: str) -> str:
    """Name the results with this verdict."""
    names = []
    for _, name, result in _both(c):
        if result.verdict is not None and result.verdict.use == use:
            names.append(name)
    return " and on ".join(names)


def _only(c: Comparison) -> str:
    """List the parameters that only one result has."""
    parts = []
    for (_, name, result), parameters in zip(_both(c), (c.only_a, c.only_b), strict=True):
        if parameters:
            listed = choices(parameters, limit=4)
            parts.append(f"only {name} ('{result.model.name}') has {listed}")
    return " and ".join(parts)


def _answer(c: Comparison) -> str:
    """Write the answer and the numbers behind it."""
    lines = []
    if c.test.combinations and (c.outcome != "cannot tell" or c.only_a or c.only_b):
        lines.append(_test(c))
    lines += map(_move, c.moves)
    registered = []
    if unknown_frame(c.a) or unknown_frame(c.b):
        registered.append("the base")
    if c.a.setup.estimate_target or c.b.setup.estimate_target:
        registered.append("the target")
    if registered:
        text = f"Displacements are up to the place of {' and '.join(registered)}"
        if c.compensated:
            text += f"; a drift of {choices(c.compensated, limit=8)} cannot be seen"
        lines.append(f"{text}.")
    return "\n".join([wrap(sentence(c)), *(wrap(line, "  ") for line in lines)])


def _test(c: Comparison) -> str:
    """Word the chi-square test."""
    test = c.test
    p = f"p = {test.p:.2g}" if test.p > _SMALLEST_P else "p < 1e-12"
    return (
        f"Test: chi-square {test.chi_square:.1f} over {test.combinations} combinations known from both data, "
        f"{test.freedom:.0f} d.o.f. of noise: {p}; a drift below {LEVEL:g}."
    )


def _move(move: Displacement) -> str:
    """Word how far predictions of both results are apart."""
    turn = f", {deg(move.rms_angle)} deg" if np.isfinite(move.rms_angle) else ""
    return (
        f"Over {_WHERE[move.where]}: {mm(move.rms)} mm rms{turn}, at most {mm(move.max)} mm; expected from noise "
        f"alone: {mm(move.noise)} mm rms."
    )


def notes(c: Comparison) -> tuple[str, ...]:
    """List caveats of a comparison, in sentences."""
    result = []
    robots = c.a.nominal.name, c.b.nominal.name
    if robots[0] != robots[1]:
        result.append(f"The URDFs name their robots '{robots[0]}' and '{robots[1]}'.")
    if (c.only_a or c.only_b) and not c.why:
        result.append(f"The results estimate different errors: {_only(c)}.")
    if not unknown_frame(c.a) and not unknown_frame(c.b):
        result.append(
            "Both take the measurement frame as known: its error looks like a drift of the first joints."
        )
    non_geometric = [
        f"{name} ('{one.non_geometric.name}')"
        for _, name, one in _both(c)
        if one.non_geometric is not None
    ]
    if non_geometric:
        result.append(
            f"The non-geometric model of {' and of '.join(non_geometric)} is not compared. Loads, speeds and poses "
            "should be alike in both measurements."
        )
    bounded = _at_bounds(c.a) | _at_bounds(c.b)
    if bounded:
        result.append(f"At a bound, and taken as known there: {choices(sorted(bounded))}.")
    careful = _results_with(c, "use with care")
    if careful:
        result.append(f"The verdict on {careful} is 'use with care'; see there.")
    return tuple(result)


def _at_bounds(result: Calibration) -> set[str]:
    """Names of the robot's parameters at a bound."""
    names = own_names(result)
    return {p.name for p in result.parameters if p.at_bound and p.name in names}


def comparison_table(c: Comparison) -> dict[str, Any]:
    """Comparison as nested tables of plain values in SI units; the keys are documented in docs/comparison.md."""
    robot = c.a.nominal
    return {
        "schema": COMPARISON_SCHEMA,
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "outcome": c.outcome,
        "why": c.why,
        "test": {**asdict(c.test), "level": LEVEL},
        "moves": [_move_table(move) for move in c.moves],
        "compensated": list(c.compensated),
        "only_a": list(c.only_a),
        "only_b": list(c.only_b),
        "results": [_result_table(name, result) for _, name, result in _both(c)],
        "versions": versions(),
    }


def _move_table(move: Displacement) -> dict[str, Any]:
    """Difference of predictions, in SI units."""
    return {
        "where": move.where,
        "moved_rms_m": move.moved,
        "rms_rad": move.rms_angle,
        "rms_m": move.rms,
        "max_m": move.max,
        "noise_rms_m": move.noise,
        "moved_std_m": move.std,
    }


def _result_table(name: str, result: Calibration) -> dict[str, Any]:
    """One of the results that are compared."""
    return {
        "name": name,
        "set": result.model.name,
        "verdict": None if result.verdict is None else result.verdict.use,
        "sigma": result.noise.sigma,
        "urdf_sha256": result.nominal.urdf.sha256,
        "measurements_sha256": result.source.sha256,
    }


def comparison_html(c: Comparison) -> str:
    """Write a comparison: its answer, and the verdict on each result."""
    rows = [("answer", sentence(c))]
    for name, result in zip(c.names, (c.a, c.b), strict=True):
        verdict = "no verdict" if result.verdict is None else result.verdict.use
        _, _, after = before_and_after(result)
        rows.append((name, f"{verdict}, rms error {rms_text(after)}, {len(result.rows)} rows"))
    return html_table(f"Comparison of two calibrations of {chain_name(c.a.nominal)}", rows)
