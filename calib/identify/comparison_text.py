"""A comparison as text of at most 100 columns, its answer first, and as nested tables for JSON."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calib.errors import choices
from calib.identify.comparison import (
    BAD_VERDICT,
    CANNOT_TELL,
    DRIFT,
    NOTHING_KNOWN,
    OTHER_ERRORS,
    SAME_DATA,
    Comparison,
    ParameterDifference,
    PlaceDifference,
)
from calib.identify.displacement import unknown_frame
from calib.identify.drift import LEVEL, own_names
from calib.identify.result import Calibration
from calib.identify.statements import lengths_of_kinds, title_of_errors
from calib.identify.statistics import Errors
from calib.identify.words import three, wrap
from calib.version import __version__

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 28

#: More frames or targets than this are not listed one by one.
_MOST_PLACES = 6

#: Beyond this many standard deviations the number says nothing more.
_HIGHEST = 37.0

_ERRORS = "{:<5}{:<31}{:>8}{:>10}{:>10}{:>10}"


def comparison_text(c: Comparison) -> str:
    """The whole text."""
    parts = [_heading(c), _answer(c), _notes(c), _errors(c), _parameters(c), _places(c)]
    return "\n\n".join(part for part in parts if part)


def _heading(c: Comparison) -> str:
    """Which results of which robot."""
    r = c.a.nominal
    lines = [
        wrap(f"calib {__version__}: two calibrations of robot '{r.name}', {r.base} to {r.tip}")
    ]
    for letter, name, one in zip("ab", c.names, (c.a, c.b), strict=True):
        use = "" if one.verdict is None else f", verdict: {one.verdict.use}"
        data = one.source.name or "memory"
        text = f"{letter}: {name}, {len(one.rows)} rows of {data}, model '{one.model.name}'{use}"
        lines.append(wrap(text, "  "))
    return "\n".join(lines)


def _answer(c: Comparison) -> str:
    """Did the robot drift? In one sentence, and what it stands on."""
    lines = [wrap(sentence(c))]
    test = c.test
    if test.combinations and (c.outcome != CANNOT_TELL or any((c.only_a, c.only_b))):
        lines.append(
            wrap(
                f"Test: chi-square {test.chi_square:.1f} over the {test.combinations} combinations of parameters that "
                f"both data know; {_odds(test.p)} where nothing has changed ({test.freedom:.0f} d.o.f. of noise); "
                f"called a drift below {LEVEL:g}.",
                "  ",
            )
        )
    for move in c.moves:
        turn = (
            f", {three(float(np.degrees(move.rms_angle)))} deg"
            if np.isfinite(move.rms_angle)
            else ""
        )
        lines.append(
            wrap(
                f"Over {move.where}: {three(1e3 * move.rms)} mm rms{turn}, at most {three(1e3 * move.max)} mm; noise "
                f"alone would show {three(1e3 * move.noise)} mm rms.",
                "  ",
            )
        )
    absorbed = _absorbed(c)
    if absorbed:
        lines.append(wrap(absorbed, "  "))
    return "\n".join(lines)


def sentence(c: Comparison) -> str:
    """The answer in a sentence."""
    if c.outcome == CANNOT_TELL:
        return f"Whether the robot drifted cannot be told. {_why(c)}"
    if c.outcome == DRIFT:
        much = f"{_HIGHEST:.0f} or more" if c.test.sigma > _HIGHEST else f"{c.test.sigma:.1f}"
        move = c.moves[0]
        return (
            f"The robot drifted ({much} sigma): between a and b its target moved by "
            f"{three(1e3 * move.moved)} ± {three(1e3 * move.std)} mm rms over {move.where}."
        )
    return "No drift that these data could show."


def _why(c: Comparison) -> str:
    """Why it cannot be told."""
    bad = [
        name
        for name, one in zip(c.names, (c.a, c.b), strict=True)
        if one.verdict is not None and one.verdict.use == "do not use"
    ]
    return {
        SAME_DATA: "Both results are made of the same measurements, so that the robot was the same: what differs is "
        "how they were fitted.",
        BAD_VERDICT: f"The verdict on {' and on '.join(bad)} is 'do not use': mend that first.",
        NOTHING_KNOWN: "The data of the two know no combination of the robot's parameters in common better than the "
        "priors do. Measure more poses.",
        OTHER_ERRORS: f"The results differ by more than chance, but they estimate different errors: {_only(c)}. What "
        "one leaves out shows as a difference. Fit both with the same --model.",
    }[c.why]


def _only(c: Comparison) -> str:
    """Which parameters only one result has, in words."""
    return " and ".join(
        f"only {name} ('{one.model.name}') has {choices(own, limit=4)}"
        for name, one, own in zip(c.names, (c.a, c.b), (c.only_a, c.only_b), strict=True)
        if own
    )


def _absorbed(c: Comparison) -> str:
    """What frame and target make up for, in words."""
    found = ["where the base stands"] * bool(unknown_frame(c.a) or unknown_frame(c.b))
    found += ["where the target sits"] * (c.a.setup.estimate_target or c.b.setup.estimate_target)
    if not found:
        return ""
    text = f"The data had to tell {' and '.join(found)} too, so that moves are told up to these"
    if c.untold:
        text += f": a drift of {choices(c.untold, limit=8)} cannot be told from them"
    return f"{text}."


def notes(c: Comparison) -> tuple[str, ...]:
    """What to mind, sentences."""
    both = tuple(zip(c.names, (c.a, c.b), strict=True))
    found = []
    if c.a.nominal.name != c.b.nominal.name:
        found.append(f"The URDFs name their robots '{c.a.nominal.name}' and '{c.b.nominal.name}'.")
    if (c.only_a or c.only_b) and not c.why:
        found.append(f"The results estimate different errors: {_only(c)}.")
    if not c.same_start:
        found.append(
            "The results count from different nominal robots: parameters are not subtracted, and what the data do not "
            "know stays where each nominal robot has it."
        )
    if not unknown_frame(c.a) and not unknown_frame(c.b):
        found.append(
            "Both take the measurement frame as known: an error in where the tracker was said to stand looks like a "
            "drift of the first joints."
        )
    with_larger = [f"{name} ('{one.larger.name}')" for name, one in both if one.larger is not None]
    if with_larger:
        found.append(
            f"Compared is the geometry that the URDF holds; the larger model of {' and of '.join(with_larger)} is not. "
            "Loads, speeds and poses should be alike in both measurements."
        )
    bounded = dict.fromkeys(
        p.name for _, one in both for p in one.parameters if p.at_bound and p.name in own_names(one)
    )
    if bounded:
        found.append(
            f"{choices(bounded)} {'stands' if len(bounded) == 1 else 'stand'} at a bound, and is taken as known there."
        )
    careful = [
        name for name, one in both if one.verdict is not None and one.verdict.use == "use with care"
    ]
    if careful:
        found.append(f"The verdict on {' and on '.join(careful)} is 'use with care'; see there.")
    return tuple(found)


def _notes(c: Comparison) -> str:
    """The same, set."""
    return "\n".join(wrap(f"Note: {note}") for note in notes(c))


def error_sets(one: Calibration) -> list[tuple[str, Errors]]:
    """Errors of the calibrated robot: estimation rows, validation rows, left-out rows."""
    sets = [(f"{name} rows", errors) for name, errors in one.errors["calibrated"].items()]
    if one.cross_validation is not None:
        sets.append(("left-out rows", one.cross_validation.errors))
    return [(rows, errors) for rows, errors in sets if errors.n]


def _errors(c: Comparison) -> str:
    """Errors of both calibrated robots, each on its own rows."""
    measured = lengths_of_kinds(c.a.kinds | c.b.kinds)
    head = f"{title_of_errors(measured)} [mm]"
    lines = [_ERRORS.format("", head, "rows", "max", "mean", "rms")]
    for letter, one in (("a", c.a), ("b", c.b)):
        for rows, e in error_sets(one):
            values = [f"{1e3 * v:.3f}" for v in (e.max, e.mean, e.rms)]
            lines.append(_ERRORS.format(letter, rows, e.n, *values))
    noise = [
        f"{three(1e3 * one.sigma)} mm in {letter}"
        for letter, one in (("a", c.a), ("b", c.b))
        if np.isfinite(one.sigma)
    ]
    if noise:
        lines.append(f"Noise of a {measured}: {', '.join(noise)}.")
    return "\n".join(lines) if len(lines) > 1 else ""


def _parameters(c: Comparison) -> str:
    """The robot's parameters of both."""
    first, second = set(own_names(c.a)), set(own_names(c.b))
    shared = [p for p in c.parameters if p.name in first and p.name in second]
    lines = [
        wrap(f"Only {letter} has the parameters {choices(names, limit=60)}.")
        for letter, names in (
            ("a", [p.name for p in c.parameters if p.name not in second]),
            ("b", [p.name for p in c.parameters if p.name not in first]),
        )
        if names
    ]
    return "\n\n".join((["\n".join(_table(shared))] if shared else []) + lines)


def _table(parameters: list[ParameterDifference]) -> list[str]:
    """The parameters that both have."""
    width = min(max(len(p.name) for p in parameters), _LONGEST_NAME) + 2
    head = f"{'Parameter':<{width}}{'a':>11}{'b':>11}{'b - a':>10}{'std':>9}{'sigma':>8}"
    lines = [head]
    for p in parameters:
        scale, unit = (1e3, "mm") if p.unit == "m" else (float(np.degrees(1.0)), "deg")
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(wrap(name))
            name = ""
        cells = [
            _cell(scale * p.a, 11),
            _cell(scale * p.b, 11),
            _cell(scale * p.difference, 10, "+"),
        ]
        cells += [_cell(scale * p.std, 9), _sigmas(p)]
        mark = "" if p.alone else " *"
        lines.append(f"{name:<{width}}{''.join(cells)} {unit}{mark}")
    if not all(p.alone for p in parameters):
        lines.append(
            wrap(
                "* known in combination with others only: priors share out what is known, so neither its value nor "
                "its difference means much by itself"
            )
        )
    lines.append("std: of the difference, sqrt(C_a + C_b).")
    return lines


def _cell(value: float, width: int, sign: str = "-") -> str:
    """A number with four digits after the point, or a dash."""
    return f"{f'{round(value, 4) + 0.0:{sign}.4f}' if np.isfinite(value) else '-':>{width}}"


def _sigmas(p: ParameterDifference) -> str:
    """The difference in standard deviations."""
    return f"{f'{round(p.sigmas, 1) + 0.0:+.1f}' if np.isfinite(p.sigmas) else '-':>8}"


def _places(c: Comparison) -> str:
    """How frames and targets moved: no drift of the robot's."""
    what = "Measurement frame" if c.a.tells_place else "Set-up"
    lines = _moved(c.frames, what, f"in {c.a.nominal.base}")
    lines += _moved(c.targets, "Target", f"in {c.a.nominal.tip}")
    lost = [
        f"{what} {choices(names)} of {name}"
        for name, one in zip(c.names, (c.a, c.b), strict=True)
        for what, names in (
            ("set-ups", _without_pair(one.setup.groups, c.frames)),
            ("targets", _without_pair(one.setup.targets, c.targets)),
        )
        if names
    ]
    if lost:
        lines.append(wrap(f"Without a partner of the same name: {'; '.join(lost)}."))
    return "\n".join(lines)


def _without_pair(names: tuple[str, ...], pairs: Iterable[PlaceDifference]) -> tuple[str, ...]:
    """Names of a result's frames or targets that were not compared."""
    paired = {p.name for p in pairs}
    return () if len(names) == 1 else tuple(name for name in names if name not in paired)


def _moved(places: tuple[PlaceDifference, ...], what: str, where: str) -> list[str]:
    """A line for each of the first few."""
    lines = []
    for place in places[:_MOST_PLACES]:
        name = f" '{place.name}'" if place.name else ""
        if not place.found and place.shift == 0.0 and not place.turn > 0.0:
            lines.append(wrap(f"{what}{name}: the same in both, as given."))
            continue
        turn = (
            f" and turned by {three(float(np.degrees(place.turn)))} deg"
            if np.isfinite(place.turn)
            else ""
        )
        how = "" if place.found else ", as given"
        lines.append(
            wrap(
                f"{what}{name}: {three(1e3 * place.shift)} mm elsewhere{turn} in b, {where}{how}; that is no drift of "
                "the robot."
            )
        )
    more = len(places) - len(lines)
    return [*lines, *([f"... and {more} more of these"] if more > 0 else [])]


def _odds(p: float) -> str:
    """A probability in words."""
    return f"p = {p:.2g}" if p > 1e-12 else "p < 1e-12"
