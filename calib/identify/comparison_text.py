"""A comparison as text of at most 100 columns, its answer first, and as nested tables for JSON."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from calib.errors import choices
from calib.identify.comparability import CANNOT_TELL, DRIFT
from calib.identify.compared import Compared
from calib.identify.comparison_facts import Facts
from calib.identify.differences import ParameterDifference, PlaceDifference
from calib.identify.drift import LEVEL, POWER
from calib.identify.result_tables import versions
from calib.identify.statements import lengths_of_kinds, title_of_errors
from calib.identify.words import three, wrap
from calib.version import __version__

#: The layout of what `comparison_table` gives; a word, so that it is not taken for a result.
COMPARISON_SCHEMA = "comparison 1"

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 28

#: More frames or targets than this are not listed one by one.
_MOST_PLACES = 6

#: Beyond this many standard deviations the number says nothing more.
_HIGHEST = 37.0

#: Single parameters that would explain a drift: the best few.
_MOST_EXPLANATIONS = 3

_ERRORS = "{:<5}{:<31}{:>8}{:>10}{:>10}{:>10}"


def comparison_text(c: Facts) -> str:
    """The whole text."""
    parts = [_heading(c), _answer(c), _notes(c), _errors(c), _parameters(c), _places(c)]
    return "\n\n".join(part for part in parts if part)


def _heading(c: Facts) -> str:
    """Which results of which robot."""
    s = c.a.stored
    lines = [
        wrap(
            f"calib {__version__}: two calibrations of robot '{c.a.robot_name}', {s.base} to {s.tip}"
        )
    ]
    for letter, one in (("a", c.a), ("b", c.b)):
        use = f", verdict: {one.use}" if one.use else ""
        lines.append(
            wrap(
                f"{letter}: {one.name}, {one.data_rows} rows of {one.data[0]}, model '{one.model}'{use}",
                "  ",
            )
        )
    return "\n".join(lines)


def _answer(c: Facts) -> str:
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
    explanation = _explanation(c)
    if explanation:
        lines.append(wrap(explanation, "  "))
    absorbed = _absorbed(c)
    if absorbed:
        lines.append(wrap(absorbed, "  "))
    return "\n".join(lines)


def sentence(c: Facts) -> str:
    """The answer in a sentence."""
    if c.outcome == CANNOT_TELL:
        return f"Whether the robot drifted cannot be told. {c.why}"
    if c.outcome == DRIFT:
        much = f"{_HIGHEST:.0f} or more" if c.test.sigma > _HIGHEST else f"{c.test.sigma:.1f}"
        if not c.moves:
            return f"The robot drifted ({much} sigma): b differs from a by more than chance."
        move = c.moves[0]
        return (
            f"The robot drifted ({much} sigma): between a and b its target moved by "
            f"{three(1e3 * move.moved)} ± {three(1e3 * move.std)} mm rms over {move.where}."
        )
    text = "No drift that these data could show."
    if np.isfinite(c.shows_from):
        text += (
            f" A joint's zero that drifts would be noticed {_share(POWER)} once it moves the target by "
            f"{three(1e3 * c.shows_from)} mm rms over {c.moves[0].where}, whichever joint it is"
            f"{' of those that frame and target do not hide' if c.untold else ''}."
        )
    return text


def _absorbed(c: Facts) -> str:
    """What frame and target make up for, in words."""
    if not c.moves:
        return ""
    found = ["where the base stands"] * bool(c.a.frame or c.b.frame)
    found += ["where the target sits"] * bool(c.a.target_estimated or c.b.target_estimated)
    if not found:
        return ""
    text = f"The data had to tell {' and '.join(found)} too, so that moves are told up to these"
    if c.untold:
        text += f": a drift of {choices(c.untold, limit=8)} cannot be told from them"
    return f"{text}."


def _explanation(c: Facts) -> str:
    """Which single parameters would explain a drift."""
    if c.outcome != DRIFT:
        return ""
    known = [p for p in c.parameters if np.isfinite(p.left_p)]
    best = sorted(known, key=lambda p: -p.left_p)[:_MOST_EXPLANATIONS]
    told = [p for p in best if p.left_p >= LEVEL]
    if not told:
        return "No change of one parameter alone explains it."
    listed = []
    for p in told:
        scale, unit = (1e3, "mm") if p.unit == "m" else (1e3, "mrad")
        change = f"{three(scale * p.explains, '+')} ± {three(scale * p.explains_std)} {unit}"
        listed.append(f"{p.name} by {change} (p = {p.left_p:.2g} for what is left)")
    return f"A change of one parameter alone would explain it: {'; or '.join(listed)}."


def _notes(c: Facts) -> str:
    """What to mind."""
    return "\n".join(wrap(f"Note: {note}") for note in c.notes)


def _errors(c: Facts) -> str:
    """Errors of both calibrated robots, each on its own rows."""
    measured = lengths_of_kinds(c.a.kinds | c.b.kinds)
    head = f"{title_of_errors(measured)} [mm]"
    lines = [_ERRORS.format("", head, "rows", "max", "mean", "rms")]
    for letter, one in (("a", c.a), ("b", c.b)):
        for e in one.errors:
            values = [f"{1e3 * v:.3f}" for v in (e.max, e.mean, e.rms)]
            lines.append(_ERRORS.format(letter, e.rows, e.n, *values))
    noise = [
        f"{three(1e3 * one.sigma)} mm in {letter}"
        for letter, one in (("a", c.a), ("b", c.b))
        if np.isfinite(one.sigma)
    ]
    if noise:
        lines.append(f"Noise of a {measured}: {', '.join(noise)}.")
    return "\n".join(lines) if len(lines) > 1 else ""


def _parameters(c: Facts) -> str:
    """The robot's parameters of both."""
    first, second = set(c.a.own_names), set(c.b.own_names)
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
    head = f"{'Parameter':<{width}}{'a':>11}{'b':>11}{'b - a':>10}{'std':>9}{'sigma':>8}{'shows from':>12}"
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
        cells += [_cell(scale * p.std, 9), _sigmas(p), _from(scale * p.would_show)]
        mark = "" if p.alone else " *"
        lines.append(f"{name:<{width}}{''.join(cells)} {unit}{mark}")
    if not all(p.alone for p in parameters):
        lines.append(
            wrap(
                "* known in combination with others only: priors share out what is known, so neither its value nor "
                "its difference means much by itself"
            )
        )
    lines.append(
        wrap(
            f"std: of the difference, sqrt(C_a + C_b). shows from: what a drift of this parameter alone must exceed to "
            f"be noticed {_share(POWER)}; never where frame, target or too few data hide it."
        )
    )
    return lines


def _cell(value: float, width: int, sign: str = "-") -> str:
    """A number with four digits after the point, or a dash."""
    return f"{f'{round(value, 4) + 0.0:{sign}.4f}' if np.isfinite(value) else '-':>{width}}"


def _sigmas(p: ParameterDifference) -> str:
    """The difference in standard deviations."""
    return f"{f'{round(p.sigmas, 1) + 0.0:+.1f}' if np.isfinite(p.sigmas) else '-':>8}"


def _from(value: float) -> str:
    """The smallest change that shows."""
    return f"{f'{value:.4f}' if np.isfinite(value) else 'never':>12}"


def _places(c: Facts) -> str:
    """How frames and targets moved: no drift of the robot's."""
    what = "Measurement frame" if {"point", "pose"} & c.a.kinds else "Set-up"
    lines = _moved(c.frames, what, f"in {c.a.stored.base}")
    lines += _moved(c.targets, "Target", f"in {c.a.stored.tip}")
    lost = [
        f"{what} {choices(names)} of {one.name}"
        for one in (c.a, c.b)
        for what, names in (
            ("set-ups", _without_pair(one, c.frames, frames=True)),
            ("targets", _without_pair(one, c.targets, frames=False)),
        )
        if names
    ]
    if lost:
        lines.append(wrap(f"Without a partner of the same name: {'; '.join(lost)}."))
    return "\n".join(lines)


def _without_pair(
    one: Compared, pairs: Iterable[PlaceDifference], *, frames: bool
) -> tuple[str, ...]:
    """Names of a result's frames or targets that were not compared."""
    known = one.stored.known.frames if frames else one.stored.known.targets
    paired = {p.name for p in pairs}
    return () if len(known) == 1 else tuple(name for name in known if name not in paired)


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


def _share(power: float) -> str:
    """The power in words."""
    return f"{10 * power:.0f} times in 10"


def comparison_table(c: Facts) -> dict[str, Any]:
    """The comparison as nested tables of plain values; the keys are documented in docs/comparison.md."""
    t = c.test
    return {
        "schema": COMPARISON_SCHEMA,
        "robot": {"name": c.a.robot_name, "base": c.a.stored.base, "tip": c.a.stored.tip},
        "outcome": c.outcome,
        "sentence": sentence(c),
        "test": {
            "combinations": t.combinations,
            "chi_square": t.chi_square,
            "freedom": t.freedom,
            "p": t.p,
            "sigma": t.sigma,
            "level": LEVEL,
        },
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
        "shows_from_rms_m": c.shows_from,
        "power": POWER,
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "a": p.a,
                "b": p.b,
                "difference": p.difference,
                "std": p.std,
                "sigmas": p.sigmas,
                "alone": p.alone,
                "explains": p.explains,
                "explains_std": p.explains_std,
                "left_p": p.left_p,
                "shows_from": p.would_show,
            }
            for p in c.parameters
        ],
        "untold": list(c.untold),
        "only_a": list(c.only_a),
        "only_b": list(c.only_b),
        "frames": [_place(one, "group") for one in c.frames],
        "targets": [_place(one, "target") for one in c.targets],
        "results": [_result(one) for one in (c.a, c.b)],
        "notes": list(c.notes),
        "versions": versions(),
    }


def _place(one: PlaceDifference, key: str) -> dict[str, Any]:
    """How one frame or target moved."""
    return {key: one.name, "found": one.found, "shift_m": one.shift, "turn_rad": one.turn}


def _result(one: Compared) -> dict[str, Any]:
    """What was compared."""
    return {
        "name": one.name,
        "set": one.model,
        "verdict": one.use or None,
        "sigma_m": one.sigma,
        "errors": [
            {"rows": e.rows, "n": e.n, "max_m": e.max, "mean_m": e.mean, "rms_m": e.rms}
            for e in one.errors
        ],
        "inputs": {
            "urdf": {"name": one.urdf[0], "sha256": one.urdf[1]},
            "measurements": {
                "name": one.data[0],
                "sha256": one.data[1],
                "rows": one.data_rows,
            },
        },
    }
