"""A comparison as text of at most 100 columns, its answer first, and as nested tables for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from calib.errors import choices
from calib.estimate.statistics import Errors
from calib.result.calibration import Calibration
from calib.result.calibration_fields import versions
from calib.result.comparison import (
    BAD_VERDICT,
    CANNOT_TELL,
    DRIFT,
    NOTHING_KNOWN,
    OTHER_ERRORS,
    SAME_DATA,
    Comparison,
    ParameterDifference,
)
from calib.result.drift import LEVEL, own_names, unknown_frame
from calib.text.lines import three, wrap
from calib.text.summary import error_title, measured_lengths
from calib.version import __version__

#: The layout of what `comparison_table` gives; a word, so that it is not taken for a result.
COMPARISON_SCHEMA = "comparison 2"

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 28

#: More frames or targets than this are not listed one by one.
_MOST_PLACES = 6

#: Beyond this many standard deviations the number says nothing more.
_HIGHEST = 37.0

_ERRORS = "{:<5}{:<31}{:>8}{:>10}{:>10}{:>10}"


def comparison_text(c: Comparison) -> str:
    """The whole text."""
    noted = "\n".join(wrap(f"Note: {note}") for note in notes(c))
    parts = [_heading(c), _answer(c), noted, _errors(c), _parameters(c), _places(c)]
    return "\n\n".join(part for part in parts if part)


def _both(c: Comparison) -> tuple[tuple[str, str, Calibration], ...]:
    """Letter, name and value of each result."""
    return ("a", c.names[0], c.a), ("b", c.names[1], c.b)


def _judged(c: Comparison, use: str) -> str:
    """The results with this verdict."""
    every = [
        name for _, name, one in _both(c) if one.verdict is not None and one.verdict.use == use
    ]
    return " and on ".join(every)


def _heading(c: Comparison) -> str:
    """Which results of which robot."""
    r = c.a.nominal
    lines = [
        wrap(f"calib {__version__}: two calibrations of robot '{r.name}', {r.base} to {r.tip}")
    ]
    for letter, name, one in _both(c):
        use = "" if one.verdict is None else f", verdict: {one.verdict.use}"
        data = one.source.name or "memory"
        text = f"{letter}: {name}, {len(one.rows)} rows of {data}, model '{one.model.name}'{use}"
        lines.append(wrap(text, "  "))
    return "\n".join(lines)


def _answer(c: Comparison) -> str:
    """Did the robot drift? In one sentence, and what it stands on."""
    test, below = c.test, []
    if test.combinations and (c.outcome != CANNOT_TELL or any((c.only_a, c.only_b))):
        odds = f"p = {test.p:.2g}" if test.p > 1e-12 else "p < 1e-12"
        below.append(
            f"Test: chi-square {test.chi_square:.1f} over the {test.combinations} combinations of parameters that "
            f"both data know; {odds} where nothing has changed ({test.freedom:.0f} d.o.f. of noise); called a drift "
            f"below {LEVEL:g}."
        )
    for move in c.moves:
        angle = three(float(np.degrees(move.rms_angle)))
        turn = f", {angle} deg" if np.isfinite(move.rms_angle) else ""
        below.append(
            f"Over {move.where}: {three(1e3 * move.rms)} mm rms{turn}, at most {three(1e3 * move.max)} mm; noise "
            f"alone would show {three(1e3 * move.noise)} mm rms."
        )
    found = ["where the base stands"] * bool(unknown_frame(c.a) or unknown_frame(c.b))
    found += ["where the target sits"] * (c.a.setup.estimate_target or c.b.setup.estimate_target)
    if found:
        lost = (
            f": a drift of {choices(c.untold, limit=8)} cannot be told from them"
            if c.untold
            else ""
        )
        below.append(
            f"The data had to tell {' and '.join(found)} too, so that moves are told up to these{lost}."
        )
    return "\n".join([wrap(sentence(c)), *(wrap(text, "  ") for text in below)])


def sentence(c: Comparison) -> str:
    """The answer in a sentence."""
    if c.outcome == CANNOT_TELL:
        why = {
            SAME_DATA: "Both results are made of the same measurements, so that the robot was the same: what differs "
            "is how they were fitted.",
            BAD_VERDICT: f"The verdict on {_judged(c, 'do not use')} is 'do not use': mend that first.",
            NOTHING_KNOWN: "The data of the two know no combination of the robot's parameters in common better than "
            "the priors do. Measure more poses.",
            OTHER_ERRORS: f"The results differ by more than chance, but they estimate different errors: {_only(c)}. "
            "What one leaves out shows as a difference. Fit both with the same --model.",
        }
        return f"Whether the robot drifted cannot be told. {why[c.why]}"
    if c.outcome == DRIFT:
        much = f"{_HIGHEST:.0f} or more" if c.test.sigma > _HIGHEST else f"{c.test.sigma:.1f}"
        move = c.moves[0]
        return (
            f"The robot drifted ({much} sigma): between a and b its target moved by "
            f"{three(1e3 * move.moved)} ± {three(1e3 * move.std)} mm rms over {move.where}."
        )
    return "No drift that these data could show."


def _only(c: Comparison) -> str:
    """Which parameters only one result has, in words."""
    return " and ".join(
        f"only {name} ('{one.model.name}') has {choices(own, limit=4)}"
        for (_, name, one), own in zip(_both(c), (c.only_a, c.only_b), strict=True)
        if own
    )


def notes(c: Comparison) -> tuple[str, ...]:
    """What to mind, sentences."""
    larger = [f"{n} ('{one.larger.name}')" for _, n, one in _both(c) if one.larger is not None]
    bounded = dict.fromkeys(
        p.name
        for _, _, one in _both(c)
        for p in one.parameters
        if p.at_bound and p.name in own_names(one)
    )
    careful = _judged(c, "use with care")
    stand = "stands" if len(bounded) == 1 else "stand"
    names = f"'{c.a.nominal.name}' and '{c.b.nominal.name}'"
    every = {
        f"The URDFs name their robots {names}.": c.a.nominal.name != c.b.nominal.name,
        f"The results estimate different errors: {_only(c)}.": (c.only_a or c.only_b) and not c.why,
        "The results count from different nominal robots: parameters are not subtracted, and what the data do not know "
        "stays where each nominal robot has it.": not c.same_start,
        "Both take the measurement frame as known: an error in where the tracker was said to stand looks like a drift "
        "of the first joints.": not unknown_frame(c.a) and not unknown_frame(c.b),
        f"Compared is the geometry that the URDF holds; the larger model of {' and of '.join(larger)} is not. Loads, "
        "speeds and poses should be alike in both measurements.": larger,
        f"{choices(bounded)} {stand} at a bound, and is taken as known there.": bounded,
        f"The verdict on {careful} is 'use with care'; see there.": careful,
    }
    return tuple(text for text, said in every.items() if said)


def _error_sets(one: Calibration) -> list[tuple[str, Errors]]:
    """Errors of the calibrated robot: estimation rows, validation rows, left-out rows."""
    sets = [(f"{name} rows", errors) for name, errors in one.errors["calibrated"].items()]
    if one.cross_validation is not None:
        sets.append(("left-out rows", one.cross_validation.errors))
    return [(rows, errors) for rows, errors in sets if errors.n]


def _errors(c: Comparison) -> str:
    """Errors of both calibrated robots, each on its own rows."""
    used = c.a.used, c.b.used
    head = f"{error_title(*used)} [mm]"
    lines = [_ERRORS.format("", head, "rows", "max", "mean", "rms")]
    for letter, _, one in _both(c):
        for rows, e in _error_sets(one):
            values = [f"{1e3 * v:.3f}" for v in (e.max, e.mean, e.rms)]
            lines.append(_ERRORS.format(letter, rows, e.n, *values))
    noise = [
        f"{three(1e3 * one.sigma)} mm in {letter}"
        for letter, _, one in _both(c)
        if np.isfinite(one.sigma)
    ]
    if noise:
        lines.append(f"Noise of a {measured_lengths(*used)}: {', '.join(noise)}.")
    return "\n".join(lines) if len(lines) > 1 else ""


def _parameters(c: Comparison) -> str:
    """The robot's parameters of both, and the names of those that only one has."""
    own = [set(own_names(one)) for _, _, one in _both(c)]
    shared = [p for p in c.parameters if p.name in own[0] & own[1]]
    parts = ["\n".join(_table(shared))] if shared else []
    for letter, names in zip("ab", (own[0] - own[1], own[1] - own[0]), strict=True):
        if names:
            listed = choices([p.name for p in c.parameters if p.name in names], limit=60)
            parts.append(wrap(f"Only {letter} has the parameters {listed}."))
    return "\n\n".join(parts)


def _table(parameters: list[ParameterDifference]) -> list[str]:
    """The parameters that both have."""
    width = min(max(len(p.name) for p in parameters), _LONGEST_NAME) + 2
    lines = [f"{'Parameter':<{width}}{'a':>11}{'b':>11}{'b - a':>10}{'std':>9}{'sigma':>8}"]
    for p in parameters:
        scale, unit = (1e3, "mm") if p.unit == "m" else (float(np.degrees(1.0)), "deg")
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(wrap(name))
            name = ""
        a, b, difference, std = (scale * v for v in (p.a, p.b, p.difference, p.std))
        cells = (a, 11, "-.4"), (b, 11, "-.4"), (difference, 10, "+.4"), (std, 9, "-.4")
        texts = [
            f"{f'{round(v, int(form[2])) + 0.0:{form}f}' if np.isfinite(v) else '-':>{columns}}"
            for v, columns, form in (*cells, (p.sigmas, 8, "+.1"))
        ]
        lines.append(f"{name:<{width}}{''.join(texts)} {unit}{'' if p.alone else ' *'}")
    if not all(p.alone for p in parameters):
        lines.append(
            wrap(
                "* known in combination with others only: priors share out what is known, so neither its value nor "
                "its difference means much by itself"
            )
        )
    lines.append("std: of the difference, sqrt(C_a + C_b).")
    return lines


def _places(c: Comparison) -> str:
    """How frames and targets moved: no drift of the robot's."""
    frame, lines = "Measurement frame" if c.a.tells_place else "Set-up", []
    both = (frame, c.a.nominal.base, c.frames), ("Target", c.a.nominal.tip, c.targets)
    for what, where, places in both:
        for place in places[:_MOST_PLACES]:
            name = f"{what} '{place.name}'" if place.name else what
            angle = three(float(np.degrees(place.turn)))
            turn = f" and turned by {angle} deg" if np.isfinite(place.turn) else ""
            said = (
                f"{three(1e3 * place.shift)} mm elsewhere{turn} in b, in {where}{'' if place.found else ', as given'}; "
                "that is no drift of the robot."
            )
            if not place.found and place.shift == 0.0 and not place.turn > 0.0:
                said = "the same in both, as given."
            lines.append(wrap(f"{name}: {said}"))
        if len(places) > _MOST_PLACES:
            lines.append(f"... and {len(places) - _MOST_PLACES} more of these")
    lost = [
        f"{what} {choices(names)} of {of}"
        for _, of, one in _both(c)
        for what, own, places in (
            ("set-ups", one.setup.groups, c.frames),
            ("targets", one.setup.targets, c.targets),
        )
        if len(own) > 1
        and (names := [name for name in own if name not in {p.name for p in places}])
    ]
    if lost:
        lines.append(wrap(f"Without a partner of the same name: {'; '.join(lost)}."))
    return "\n".join(lines)


def comparison_table(c: Comparison) -> dict[str, Any]:
    """The comparison as nested tables of plain values; the keys are documented in docs/comparison.md."""
    places = ((c.frames, "group"), (c.targets, "target"))
    frames, targets = (
        [
            {key: one.name, "found": one.found, "shift_m": one.shift, "turn_rad": one.turn}
            for one in every
        ]
        for every, key in places
    )
    return {
        "schema": COMPARISON_SCHEMA,
        "robot": {"name": c.a.nominal.name, "base": c.a.nominal.base, "tip": c.a.nominal.tip},
        "outcome": c.outcome,
        "sentence": sentence(c),
        "test": {**asdict(c.test), "level": LEVEL},
        "moves": [
            {
                "where": m.where,
                "rms_m": m.rms,
                "max_m": m.max,
                "noise_rms_m": m.noise,
                "moved_rms_m": m.moved,
                "moved_std_m": m.std,
                "rms_rad": m.rms_angle,
            }
            for m in c.moves
        ],
        "parameters": [asdict(p) for p in c.parameters],
        "untold": list(c.untold),
        "only_a": list(c.only_a),
        "only_b": list(c.only_b),
        "frames": frames,
        "targets": targets,
        "results": [_result(name, one) for _, name, one in _both(c)],
        "notes": list(notes(c)),
        "versions": versions(),
    }


def _result(name: str, one: Calibration) -> dict[str, Any]:
    """What was compared."""
    urdf, source = one.nominal.urdf, one.source
    data = {"name": source.name or "memory", "sha256": source.sha256, "rows": len(one.rows)}
    return {
        "name": name,
        "set": one.model.name,
        "verdict": None if one.verdict is None else one.verdict.use,
        "sigma_m": one.sigma,
        "errors": [
            {"rows": rows, "n": e.n, "max_m": e.max, "mean_m": e.mean, "rms_m": e.rms}
            for rows, e in _error_sets(one)
        ],
        "inputs": {
            "urdf": {"name": urdf.source, "sha256": urdf.sha256},
            "measurements": data,
        },
    }
