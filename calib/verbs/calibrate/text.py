"""The result as text for a terminal: what to do, how good it is, what was estimated. At most 100 columns, no colours.

What the report shows too is public: facts, places, rows of errors and of parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.basics.values import one_line
from calib.model.families import FAMILIES, unit_of
from calib.model.parameters import FRAME, TARGET
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.show.doubtful_rows import outliers_text, robustness_text
from calib.show.errors import error_table, error_title
from calib.show.lines import mm, number, plural, wrap
from calib.show.notebook import chain_name, html_table, verdict_rows
from calib.show.readings import coupling_sentence, rows_sentence
from calib.show.short import before_and_after, rms_text
from calib.show.sizes import with_unit
from calib.show.tables import Column, name_column, table_lines
from calib.show.verdict import reason_text
from calib.show.words import combination_text
from calib.verbs.calibrate.noise_text import (
    ENOUGH_FREEDOM,
    noise_text,
    per_scalar,
    pose_noise_text,
)
from calib.verbs.calibrate.optics_text import counted_rows, optics_sentences
from calib.verbs.calibrate.places_text import frame_sentences, target_sentences
from calib.version import __version__

#: Rows, or combinations of parameters, that are listed; the others are counted.
_MOST_ROWS = 12


#: Labels of `facts` that tests and the report ask for.
EXPECTED = "Expected error at a new point"
POSE_NOISE = "Noise of poses"
SCATTER = "Scatter of repeats"
PRIOR_STD = "Prior standard deviations"

#: A prior standard deviation below this is shown as none [mm, mrad, urad/Nm]: the last digit shown.
_NOTHING = 2e-3

#: Description of each method of cross-validation.
_HELD_OUT = {
    "leave-one-out": "each row predicted from the others alone",
    "leave-one-pose-out": "each pose, repeats and all, predicted from the others alone",
    "leave-one-station-out": "each station predicted from the others, but for its own frame",
    "leave-stations-out": "some stations predicted from the others, but for their own frames",
    "10-fold": "a tenth of the poses at a time, predicted from the others",
}

_DEG = math.degrees(1.0)


def summary(c: Calibration) -> str:
    """Write the whole summary of a calibration."""
    parts = (
        _heading(c),
        _verdict(c),
        _errors(c),
        _flagged(c),
        "\n".join(map(wrap, target_sentences(c))),
        "\n".join(map(wrap, frame_sentences(c))),
        "\n".join(map(wrap, optics_sentences(c))),
        _models(c),
        _facts(c),
        _parameters(c),
        _non_geometric(c),
        _solver(c),
    )
    return "\n\n".join(part for part in parts if part)


def _heading(c: Calibration) -> str:
    """Name the robot and count the rows."""
    heading = wrap(
        f"calib {__version__}: robot '{c.nominal.name}', {c.nominal.base} to {c.nominal.tip}, "
        f"{len(c.nominal.joints)} joints; {counted_rows(c)} from "
        f"{c.source.name or 'memory'}"
    )
    rows = rows_sentence(c.nominal)
    sentences = [f"{rows}." if rows else "", coupling_sentence(c.nominal)]
    return "\n".join([heading, *(wrap(sentence) for sentence in sentences if sentence)])


def _verdict(c: Calibration) -> str:
    """Write the verdict with its reasons."""
    if c.verdict is None:
        return "Verdict: none, because nothing was cross-validated."
    reasons = [wrap(reason_text(reason), "  ") for reason in c.verdict.reasons]
    return "\n".join([f"Verdict: {c.verdict.use}", *reasons])


def _facts(c: Calibration) -> str:
    """Write the facts, and the unidentifiable combinations below the rank."""
    lines = [wrap(f"{label}: {text}") for label, text in facts(c).items()]
    combinations = c.trust.observability.unidentifiable
    if combinations:
        lines.append(f"{unidentifiable_text(c)}:")
    lines += [wrap(combination_text(one), "  ") for one in combinations[:_MOST_ROWS]]
    more = len(combinations) - _MOST_ROWS
    if more > 0:
        lines.append(f"  and {more} more")
    return "\n".join(lines)


def _non_geometric(c: Calibration) -> str:
    """Write the table of the non-geometric model's further parameters."""
    if c.non_geometric is None:
        return ""
    columns = [name_column("", 48), Column("", 9), Column("", left=True), Column("", left=True)]
    rows = [(f"  {name}", *cells) for name, *cells in non_geometric_parameters(c)]
    head = f"Non-geometric model '{c.non_geometric.name}', not in the URDF:"
    return "\n".join([head, *table_lines(columns, rows)])


def _solver(c: Calibration) -> str:
    """Write how the solver ended, and its time, if it is known."""
    time = "" if math.isnan(c.method.seconds) else f", {1e3 * c.method.seconds:.0f} ms"
    return wrap(f"{solver_text(c)}{time}. {c.method.solution.message}")


def facts(c: Calibration) -> dict[str, str]:
    """Word the figures of a result besides its errors.

    Args:
        c: The result.

    Returns:
        A sentence for each label, as far as the figure exists: noise, scatter of repeats, expected error at a new
        point, prior standard deviations, rank.
    """
    result = {"Noise": noise_text(c)}
    if c.noise.pose_noise is not None:
        result[POSE_NOISE] = pose_noise_text(c.noise.pose_noise)
    if c.noise.repeats is not None:
        unit = next(iter(c.noise.repeats.within))
        scatter, freedom = c.noise.repeats.within[unit], c.noise.repeats.freedoms[unit]
        if np.isfinite(scatter):
            per = per_scalar(c.rows.channels, unit)
            result[SCATTER] = f"{with_unit(scatter, unit)} {per} ({freedom:.0f} d.o.f.)."
    result[EXPECTED] = _expected(c)
    if c.geometry.prior_std:
        result[PRIOR_STD] = _prior_std(c)
    o = c.trust.observability
    result["Rank"] = f"{o.rank} of {o.columns} parameters, condition number {o.condition:.0f}."
    return result


def _expected(c: Calibration) -> str:
    """Word the expected error at a new point."""
    if c.cross_validation is None and c.verdict is not None:
        # A usual mistake explains the rows, or a frame was not found: this fit is of something that is not there.
        return "not known: see the verdict."
    if c.cross_validation is None and c.noise.freedom < ENOUGH_FREEDOM:
        # Prior standard deviations estimated from nothing shrink to nothing, and the expected error with them.
        return "not known: too few rows."
    near, everywhere = c.new_point
    return f"{mm(near)} mm rms near the measured poses, {mm(everywhere)} mm over the joint limits."


def _prior_std(c: Calibration) -> str:
    """List the prior standard deviation of each family, and its source."""
    sizes = []
    for family, std in c.geometry.prior_std.items():
        factor, unit = FAMILIES[family].unit.shown
        size = factor * std
        sizes.append(f"{family} {size:.3g} {unit}" if size > _NOTHING else f"{family} none")
    source = "estimated from the data" if c.method.prior_std_from == "data" else "as given"
    return f"{', '.join(sizes)} ({source})."


def error_rows(c: Calibration) -> list[tuple[str, Errors]]:
    """Label and errors of each row of the error tables: nominal and calibrated, by set, and on held-out rows.

    Those of the nominal robot are left out where a measurement frame was not found: they are those of its wrong place.
    """
    rows = []
    for name in ("estimation", "validation"):
        for who, errors in c.errors.items():
            if who == "nominal" and not c.rows.nominal_is_judged:
                continue
            rows.append((f"{name} rows, {who}", errors[name]))
    validated = {"nominal": c.trust.nominal_cross_validation, "calibrated": c.cross_validation}
    if c.non_geometric is not None:
        validated["non_geometric"] = c.non_geometric.cross_validation
    for who, cross_validation in validated.items():
        if cross_validation is None:
            continue
        rows.append((f"held-out rows*, {who}", cross_validation.errors))
        if c.rows.outliers:
            without = cross_validation.errors_without_outliers
            rows.append(("  the same without outliers", without))
    return rows


def errors_at_board(c: Calibration) -> dict[str, Errors]:
    """Return errors of images as lengths at the board [m], by the labels of `error_rows`; empty without images."""
    rows = {}
    by_robot = c.rows.errors_at_board
    for name in ("estimation", "validation"):
        for who, sets in by_robot.items():
            if name in sets:
                rows[f"{name} rows, {who}"] = sets[name]
    validations = {
        "nominal": c.trust.nominal_cross_validation,
        "calibrated": c.cross_validation,
    }
    for who, validation in validations.items():
        errors = c.rows.held_out_errors_at_board(validation)
        if errors is not None:
            rows[f"held-out rows*, {who}"] = errors
    return rows


def held_out_text(c: Calibration) -> str:
    """Footnote on ``held-out rows*``: the method; empty without cross-validation."""
    if c.cross_validation is None:
        return ""
    method = c.cross_validation.method
    return f"* {method}: {_HELD_OUT[method]}"


def weights_text(c: Calibration) -> str:
    """Word the weight of the outliers in the fit."""
    weights = dict(zip(c.rows.numbers, c.rows.weights, strict=True))
    unused = not any(weights.get(outlier.row) for outlier in c.rows.outliers)
    return "no weight in the fit" if unused else "full weight in the fit"


def errorless(c: Calibration) -> frozenset[str]:
    """Names of the parameters of families that the data showed to have no errors.

    Their family's estimated prior standard deviation is zero to the digits shown: they stay nominal, and their
    interval, which is zero too, is not shown, since it is no knowledge of them.
    """
    if c.method.prior_std_from != "data":
        return frozenset()
    names = []
    for parameter, estimate in zip(c.model.parameters, c.parameters, strict=True):
        if parameter.family not in c.geometry.prior_std:
            continue
        limit = _NOTHING / FAMILIES[parameter.family].unit.shown[0]
        # A parameter with a prior of its own does not share the family's.
        if c.geometry.prior_std[parameter.family] <= limit and estimate.prior_std <= limit:
            names.append(parameter.name)
    return frozenset(names)


def unidentifiable_text(c: Calibration) -> str:
    """Heading of the unidentifiable combinations; empty if there are none."""
    if not c.trust.observability.unidentifiable:
        return ""
    resolved = " (resolved by the priors only)" if c.geometry.prior_std else ""
    return f"Unidentifiable combinations{resolved}"


def shown_parameters(c: Calibration) -> list[ParameterEstimate]:
    """Parameters of the geometry that are listed; frames and the targets' orientations are shown as poses instead."""
    shown = []
    for estimate, parameter in zip(c.parameters, c.model.parameters, strict=True):
        of_frame = parameter.family == FRAME
        turns_target = parameter.family == TARGET and parameter.unit == "rad"
        if not of_frame and not turns_target and parameter.internal is None:
            shown.append(estimate)
    return shown


def non_geometric_parameters(c: Calibration) -> Sequence[tuple[str, str, str, str]]:
    """Name, value, half the 95 % interval and unit of the non-geometric model's parameters that the geometry lacks."""
    if c.non_geometric is None:
        return []
    result = []
    for p in c.non_geometric.parameters:
        if p.name in c.model.names:
            continue
        factor, unit = unit_of(p.unit).shown
        half = "(at bound)" if p.at_bound else f"± {0.5 * factor * (p.high - p.low):.3f}"
        result.append((p.name, number(factor * p.value), half, unit))
    return result


def solver_text(c: Calibration) -> str:
    """Word the end of the solver's iterations, without the time that they took."""
    s = c.method.solution
    return f"Solver '{c.method.solver}': {s.status} after {s.iterations} iterations, {s.evaluations} evaluations"


def _errors(c: Calibration) -> str:
    """Write a table of errors for each unit that was measured."""
    rows = error_rows(c)
    tables = []
    for unit in c.rows.channels.present:
        of_unit = [row for row in rows if row[1][unit].n]
        table = error_table(error_title(unit, c.rows.channels), unit, of_unit)
        tables.append("\n".join(table))
    at_board = list(errors_at_board(c).items())
    if at_board:
        tables.append("\n".join(error_table("Error at the board", "m", at_board)))
    note = held_out_text(c)
    text = "\n\n".join(tables)
    return f"{text}\n{note}" if note else text


def _flagged(c: Calibration) -> str:
    """List the outliers, the first dozen of each set, and the effect of their weights."""
    lines = ["Outliers: none."]
    if c.rows.outliers:
        lines = [wrap(f"Outliers ({weights_text(c)}): {outliers_text(c, c.rows.outliers)}")]
        if c.trust.robustness is not None:
            lines.append(wrap(robustness_text(c.trust.robustness), "  "))
    if c.rows.suspects:
        lines.append(
            wrap(f"Outliers among the validation rows: {outliers_text(c, c.rows.suspects)}")
        )
    return "\n".join(lines)


def _models(c: Calibration) -> str:
    """Write the table of the models that were tried, and which of them were chosen."""
    if not c.method.candidates:
        return ""
    columns = [
        name_column("Models tried", 35),
        Column("parameters", 10),
        Column("evidence", 9),
        Column("held-out rms", 15),
        Column("chosen for", left=True, gap=2),
    ]
    best = max(candidate.evidence for candidate in c.method.candidates)
    uses = {"geometry": "the URDF", "non_geometric": "predict()"}
    rows = []
    for candidate in c.method.candidates:
        figures = candidate.cross_validation.errors_without_outliers.leading
        rms = with_unit(figures.rms, figures.unit)
        evidence = f"{candidate.evidence - best:.1f}"
        use = uses.get(candidate.chosen, "")
        rows.append((f"  {candidate.name}", str(candidate.parameters), evidence, rms, use))
    note = "  evidence: penalised restricted log-likelihood, relative to the best model"
    return "\n".join([*table_lines(columns, rows), note])


def _parameters(c: Calibration) -> str:
    """Write the table of parameters with their 95 % intervals; * where only combinations are known."""
    shown, none = shown_parameters(c), errorless(c)
    if not shown:
        return ""
    columns = [
        name_column("Parameter"),
        Column("nominal", 11, gap=2),
        Column("value", 11),
        Column("change", 10),
        Column("95 % +-", 9),
        Column("", left=True),
    ]
    lines = table_lines(columns, [_parameter_row(p, none) for p in shown])
    if none:
        lines.append("# no errors of this kind were found: kept at its nominal value")
    if not all(p.identifiable or p.name in none for p in shown):
        lines.append("* known in combination with others only; see above")
    return "\n".join(lines)


def _parameter_row(p: ParameterEstimate, none: frozenset[str]) -> tuple[str, ...]:
    """Cells of a parameter; ``none`` are those of `errorless`."""
    factor, unit = (_DEG, "deg") if p.unit == "rad" else unit_of(p.unit).shown
    nominal = change = "-"
    if p.nominal is not None:
        nominal = number(factor * p.nominal)
        change = number(factor * p.delta, 3, "+")
    half = f"{0.5 * factor * (p.high - p.low):.3g}"
    mark = "" if p.identifiable else " *"
    if p.at_bound:
        half = "at bound"
    if p.name in none:
        half, mark = "-", " #"
    return p.name, nominal, number(factor * p.value), change, half, f"{unit}{mark}"


def calibration_html(c: Calibration) -> str:
    """Write a calibration: the verdict with its first reason, errors before and after, rows."""
    where, before, after = before_and_after(c)
    rows = [*verdict_rows(c.verdict)]
    rows.append((f"rms error, nominal ({where} rows)", rms_text(before)))
    rows.append((f"rms error, calibrated ({where} rows)", rms_text(after)))
    other = c.non_geometric
    if other is not None and other.cross_validation is not None:
        errors = other.cross_validation.errors_without_outliers
        rows.append((f"rms error, model '{other.name}' ({where} rows)", rms_text(errors)))
    rows.append(("model", c.model.name))
    rows.append(("rows", f"{len(c.rows)}, {len(c.rows.outliers)} of them outliers"))
    return html_table(f"Calibration of {chain_name(c.nominal)}", rows)


def calibration_line(c: Calibration) -> str:
    """Write a calibration in one line: robot, verdict, error before and after, rows."""
    verdict = "no verdict" if c.verdict is None else c.verdict.use
    where, before, after = before_and_after(c)
    errors = f"{where} rms {rms_text(before)} to {rms_text(after)}"
    return one_line(
        "Calibration", chain_name(c.nominal), verdict, errors, plural(len(c.rows), "row")
    )
