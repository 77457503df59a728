"""A certificate in words: what was not tested, the method, the decision rule, and who and where."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import one_line
from calib.errors import choices
from calib.show.lines import listed, number, plural, row_ranges
from calib.show.words import chain_name, kinds_text, with_unit
from calib.uncertainty.coverage import PROBABILITY
from calib.verbs.certificate.certificate import Certificate, Decision
from calib.verbs.certificate.rounding import rounded
from calib.verbs.certificate.untested import Gap, Untested

#: A probability below this, or so near to 1, is not written out.
_SMALLEST = 1e-6

#: Sentence of each code; words in braces are made of its values.
_SENTENCES: dict[Untested, str] = {
    Untested.AS_FOUND: "The robot as found: its frame was sought and not found, so that its deviations are not known.",
    Untested.POSITIONS: "Whole positions: rows of kind {kinds} measure less.",
    Untested.ORIENTATIONS: "Orientations: none was measured.",
    Untested.FEW_POINTS: "Further points: {points} were measured; ISO 9283 asks for {wanted}.",
    Untested.REPEATS: "Repeatability: a point was measured {repeats}; it takes {wanted}.",
    Untested.APPROACHES: "Approach from other directions: no point was approached from two (column 'approach').",
    Untested.OTHER_SIDES: "The side from which joints came at the calibration: at these points they came from others.",
    Untested.DRIFT: "Drift while the robot works: a point was measured {repeats}; it takes {wanted}.",
    Untested.STILL_JOINTS: "Errors of {joints}: at all points it had one value.",
    Untested.BEYOND: "The whole box: of the calibrated range of '{joint}' the points cover {share}.",
    Untested.OUTSIDE: "The calibration's box at {rows}: these points are outside of it, where it is an extrapolation.",
    Untested.TARGETS: "Targets {names}.",
    Untested.STATIONS: "Stations {names}.",
    Untested.REGISTERED: "Where the base stands, or the target: the {places} was registered to these rows.",
    Untested.NON_GEOMETRIC: "The non-geometric model of the result: the joint origins alone are certified.",
    Untested.LOAD: "Load: the record does not state what the robot carried.",
    Untested.OTHER_LOADS: "Other loads than the stated one ({stated}).",
    Untested.SPEED: "Speed: the record does not state it.",
    Untested.OTHER_SPEEDS: "Other speeds than the stated one ({stated}).",
    Untested.WARM_UP: "Warm-up: the record does not state it.",
    Untested.TEMPERATURE: "Temperature: the record does not state it.",
    Untested.OTHER_TEMPERATURES: "Other temperatures than {low_C}.",
    Untested.TRACEABILITY: "Traceability: the record lacks the instrument's certificate, or what it is traceable to.",
    Untested.EXPIRED: "The instrument on that day: its calibration was valid until {due}, and the measurement is of "
    "{date}.",
    Untested.NOISE: "The instrument's noise: nothing states it, so that what the calibration left of {units} counts as "
    "noise, and U is too large rather than too small.",
}


def certificate_line(c: Certificate) -> str:
    """Write a certificate in one line: robot, number, outcome, largest deviations, points."""
    parts = [chain_name(c.calibration.nominal), c.record.certificate_number, c.outcome or ""]
    for unit in c.units:
        largest = max(one.left for one in c.of(unit))
        parts.append(f"largest {with_unit(largest, unit)}")
    return one_line("Certificate", *parts, plural(len(c.points), "point"))


def gap_text(gap: Gap) -> str:
    """Word what was not tested."""
    return _SENTENCES[gap.code].format(**_words(gap.values))


def _words(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the values of a gap in words, by their names."""
    words = {}
    for name, value in values.items():
        if name in ("kinds", "joints", "names"):
            words[name] = choices(value)
        elif name == "rows":
            noun = "row" if len(value) == 1 else "rows"
            words[name] = f"{noun} {row_ranges(value)}"
        elif name == "units":
            words[name] = listed([f"{RESIDUAL_UNITS[unit].measured}s" for unit in value])
        elif name == "places":
            words[name] = " and ".join(value)
        elif name == "share":
            words[name] = f"{100.0 * value:.0f} %"
        elif name == "low_C":
            words[name] = temperatures((value, values["high_C"]))
        elif name == "repeats":
            words[name] = "once" if value == 1 else f"{value} times"
        else:
            words[name] = str(value)
    return words


def temperatures(ends: tuple[float, ...]) -> str:
    """Write one temperature or two, ``21.4 °C to 22.1 °C``; empty for none."""
    return " to ".join(f"{number(end, 1)} °C" for end in dict.fromkeys(ends))


def with_uncertainty(value: float, uncertainty: float, unit: str) -> tuple[str, str]:
    """Write a deviation and its expanded uncertainty, rounded to it, in the unit shown but without it."""
    factor = RESIDUAL_UNITS[unit].to_shown
    return rounded(factor * value, factor * uncertainty)


def probability(value: float) -> str:
    """Write a probability in percent, one near 0 or 1 as a bound."""
    if not math.isfinite(value):
        return "-"
    if value < _SMALLEST:
        return f"< {100.0 * _SMALLEST:g} %"
    if 1.0 - value < _SMALLEST:
        return f"> {100.0 * (1.0 - _SMALLEST):.4f} %"
    return f"{100.0 * value:.2g} %" if value < 0.5 else f"{100.0 * value:.{_digits(value)}f} %"


def _digits(value: float) -> int:
    """Return the digits after the point of a percentage near 100 %, so that two of what is missing are shown."""
    return max(0, 1 - math.floor(math.log10(100.0 * (1.0 - value))))


def method_sentences(c: Certificate) -> Iterator[str]:
    """Word what was done: calibration, rows, points, deviations, uncertainty."""
    result, m = c.calibration, c.measurements
    rows = result.rows
    part = result.part(non_geometric=c.assessment.judged == "non_geometric")
    yield (
        f"The model '{part.model.name}' with {plural(len(part.x), 'parameter')} was identified from "
        f"{plural(int(rows.estimation.sum()), 'row')} of {result.source.name or 'a table in memory'} by weighted least "
        "squares, outliers without weight."
    )
    yield f"Each row measures: {kinds_text(m)}."
    source = m.source or "a table in memory"
    if c.is_fresh:
        yield f"The {plural(len(c.points), 'point')} below are of {source}, measured after the calibration."
    else:
        yield (
            f"The {plural(len(c.points), 'point')} below are rows of {source}, the calibration's own table, to which "
            "it was not fitted; no rows were measured afterwards."
        )
    yield (
        "A deviation is the size of the mean error of a point's readings, measured minus predicted: as found by the "
        "nominal robot, as left by the "
        + ("non-geometric model." if c.assessment.judged == "non_geometric" else "calibrated URDF.")
    )
    if c.stated:
        yield f"The uncertainty of the deviations ({listed(_stated(c))}, k = 2) is as the laboratory states it."
    if set(c.units) - set(c.stated):
        yield (
            "The uncertainty of the deviations is that of the reading at the point and of instrument, frame and "
            f"target; U is the length that their error stays below with {100.0 * PROBABILITY:.2f} %, as k = 2 of one "
            "direction, with the effective degrees of freedom of Welch and Satterthwaite (JCGM 100)."
        )
    yield (
        "U of the pose is what the calibration states for the robot at these joint values, with what its model lacks; "
        "it holds between the points too."
    )


def _stated(c: Certificate) -> list[str]:
    """Return the stated uncertainties with their units."""
    return [with_unit(value, unit) for unit, value in c.stated.items()]


def rule_sentences(c: Certificate) -> Iterator[str]:
    """Word the decision rule, and what it means in numbers; or that conformity is not stated."""
    if not c.decisions:
        yield "No tolerance was stated, so conformity is not stated."
        return
    yield (
        "Decision rule (ISO 14253-1, JCGM 106): pass if the largest deviation as left plus the guard band w = U is "
        "within the tolerance T, fail if it is beyond T by more than w, undecided otherwise."
    )
    for unit, decision in c.decisions.items():
        yield from _decision_sentences(decision, unit)


def _decision_sentences(decision: Decision, unit: str) -> Iterator[str]:
    """Word the probabilities and risks of a decision in one unit."""
    check = decision.check
    measured = RESIDUAL_UNITS[unit].measured.capitalize()
    yield (
        f"{measured}s: {with_unit(check.figure, unit)}, w = {with_unit(check.uncertainty, unit)}, T = "
        f"{with_unit(check.tolerance, unit)}: {check.outcome}. Probability that all points are within T "
        f"(lower bound): {probability(decision.conformance)}."
    )
    if math.isfinite(decision.specific_risk):
        wrong = "false acceptance" if check.outcome == "pass" else "false rejection"
        yield f"Specific probability of {wrong} (upper bound): {probability(decision.specific_risk)}."
    if decision.prior is not None and decision.risks is not None:
        mean, std = decision.prior
        yield (
            f"Over all such robots, whose largest deviation is {with_unit(mean, unit)} with a standard deviation of "
            f"{with_unit(std, unit)} (as stated): probability of false acceptance "
            f"{probability(decision.risks.consumer)}, of false rejection {probability(decision.risks.producer)}."
        )
