"""A comparison in words: its answer first, then the numbers that it rests on and what limits it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from calib.errors import choices
from calib.show.as_html import notebook_html
from calib.show.as_text import page_text
from calib.show.blocks import NOTEBOOK, TERMINAL, Block, Bullets, Facts, Page, Paragraph, Section
from calib.show.lines import deg, mm
from calib.show.words import before_and_after, chain_name, rms_text
from calib.verbs.compare.comparison import Comparison, Kept
from calib.verbs.compare.difference import own_names, unknown_frame
from calib.verbs.compare.drift import LEVEL
from calib.version import __version__

#: A p-value below this is shown as such: its digits mean nothing.
_SMALLEST_P = 1e-12

#: Joint values over which predictions are compared.
_WHERE = {
    "measured ranges": "the joint values that both measured",
    "joint limits": "the joint limits",
}


def comparison_text(c: Comparison) -> str:
    """Write a comparison: the results, the answer with its numbers, notes."""
    return page_text(_page(c))


def comparison_html(c: Comparison) -> str:
    """Draw the excerpt of a comparison for a notebook."""
    return notebook_html(_page(c))


def _page(c: Comparison) -> Page:
    """List the sections that show a comparison, each with the places where it is shown."""
    sections = (
        Section(partial(_excerpt, c), on=NOTEBOOK),
        Section(partial(_results, c), on=TERMINAL),
        Section(partial(_answer, c), on=TERMINAL),
        Section(lambda: [Bullets([f"Note: {note}" for note in notes(c)])], on=TERMINAL),
    )
    return Page("Comparison", chain_name(c.a.nominal), sections)


def _excerpt(c: Comparison) -> Iterator[Block]:
    """Show the answer, and the verdict on each result."""
    yield Paragraph(f"Comparison of two calibrations of {chain_name(c.a.nominal)}")
    facts = [("answer", sentence(c))]
    for _, name, result in c.results:
        verdict = "no verdict" if result.verdict is None else result.verdict.use
        _, _, after = before_and_after(result)
        facts.append((name, f"{verdict}, rms error {rms_text(after)}, {len(result.rows)} rows"))
    yield Facts(facts)


def _results(c: Comparison) -> Iterator[Block]:
    """Name the robot and both results."""
    robot = c.a.nominal
    yield Paragraph(f"calib {__version__}: two calibrations of robot {chain_name(robot)}")
    results = []
    for letter, name, result in c.results:
        data = result.source.name or "memory"
        text = f"{letter}: {name}, {len(result.rows)} rows of {data}, model '{result.model.name}'"
        if result.verdict is not None:
            text += f", verdict: {result.verdict.use}"
        results.append(text)
    yield Bullets(results, indent="  ", tight=True)


def _answer(c: Comparison) -> Iterator[Block]:
    """Write the answer, and below it the test, the displacements [mm, deg] and the motions that they leave out."""
    lines = []
    if c.test.combinations and (c.outcome != "cannot tell" or c.only_a or c.only_b):
        p = f"p = {c.test.p:.2g}" if c.test.p > _SMALLEST_P else "p < 1e-12"
        lines.append(
            f"Test: chi-square {c.test.chi_square:.1f} over {c.test.combinations} combinations that both data sets "
            f"determine, {c.test.freedom:.0f} d.o.f. of noise: {p}; below {LEVEL:g} it is a drift."
        )
    for move in c.moves:
        turn = f", {deg(move.rms_angle)} deg" if np.isfinite(move.rms_angle) else ""
        lines.append(
            f"Over {_WHERE[move.where]}: {mm(move.rms)} mm rms{turn}, at most {mm(move.max)} mm; expected from noise "
            f"alone: {mm(move.noise)} mm rms."
        )
    registered = []
    if unknown_frame(c.a) or unknown_frame(c.b):
        registered.append("the base")
    if c.a.setup.estimate_target or c.b.setup.estimate_target:
        registered.append("the target")
    if registered:
        text = f"Displacements leave out any motion of {' and '.join(registered)}"
        if c.compensated:
            text += f"; a drift of {choices(c.compensated, limit=8)} cannot be seen"
        lines.append(f"{text}.")
    yield Paragraph(sentence(c))
    yield Bullets(lines, indent="  ", tight=True)


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
    obstacle = {
        "same data": "both results are made from the same measurements.",
        "bad verdict": f"the verdict on {_results_with(c, 'do not use')} is 'do not use'.",
        "nothing known": "no combination of its parameters is determined by both data sets. Measure more poses.",
        "other errors": "the results differ by more than chance, but estimate different errors "
        f"({_only(c)}). Fit both with the same --model.",
    }[c.why]
    return f"Cannot tell whether the robot drifted: {obstacle}"


def kept_sentence(kept: Kept, tolerance: float) -> str:
    """Say whether the target moved by no more than a tolerance [m] since the first result."""
    limit = f"{mm(tolerance)} mm"
    return {
        "pass": f"Pass: since the first result the target has moved by no more than {limit} rms.",
        "undecided": f"Undecided: that the target has moved by no more than {limit} rms is neither shown nor refuted.",
        "fail": f"Fail: since the first result the target has moved by more than {limit} rms.",
    }[kept]


def _results_with(c: Comparison, use: str) -> str:
    """Name the results with this verdict, such as ``"do not use"``; empty if there are none."""
    names = [
        name
        for _, name, result in c.results
        if result.verdict is not None and result.verdict.use == use
    ]
    return " and on ".join(names)


def _only(c: Comparison) -> str:
    """List, result by result, the parameters whose effects the other one cannot have."""
    parts = []
    for (_, name, result), parameters in zip(c.results, (c.only_a, c.only_b), strict=True):
        if parameters:
            listed = choices(parameters, limit=4)
            parts.append(f"only {name} ('{result.model.name}') has {listed}")
    return " and ".join(parts)


def notes(c: Comparison) -> tuple[str, ...]:
    """List caveats of a comparison, in sentences."""
    result = []
    robots = c.a.nominal.name, c.b.nominal.name
    if robots[0] != robots[1]:
        result.append(f"The URDFs name their robots '{robots[0]}' and '{robots[1]}'.")
    serials = c.a.record.robot_serial, c.b.record.robot_serial
    if all(serials) and serials[0] != serials[1]:
        result.append(
            f"The records name two robots, of the serial numbers '{serials[0]}' and '{serials[1]}'."
        )
    if (c.only_a or c.only_b) and not c.why:
        result.append(f"The results estimate different errors: {_only(c)}.")
    if not unknown_frame(c.a) and not unknown_frame(c.b):
        result.append(
            "Both take the measurement frame as known: its error looks like a drift of the first joints."
        )
    non_geometric = [
        f"{name} ('{one.non_geometric.name}')"
        for _, name, one in c.results
        if one.non_geometric is not None
    ]
    if non_geometric:
        result.append(
            f"The non-geometric model of {' and of '.join(non_geometric)} is not compared. Loads, speeds and poses "
            "should be alike in both measurements."
        )
    bounded = {
        p.name
        for _, _, one in c.results
        for p in one.parameters
        if p.at_bound and p.name in own_names(one)
    }
    if bounded:
        result.append(f"At a bound, and taken as known there: {choices(sorted(bounded))}.")
    careful = _results_with(c, "use with care")
    if careful:
        result.append(f"The verdict on {careful} is 'use with care'; see there.")
    return tuple(result)
