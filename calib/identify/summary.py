"""The result as text for a terminal: what to do, how good it is, what was found. At most 100 columns, no colours."""

from __future__ import annotations

import math

import numpy as np

from calib.identify.result import Calibration
from calib.identify.statements import (
    candidate_rms,
    correlation_text,
    error_rows,
    error_title,
    errorless,
    expected_text,
    larger_parameters,
    left_out_text,
    listed,
    noise_text,
    parameter_text,
    rank_text,
    repeats_text,
    shown_parameters,
    sizes_text,
    solver_text,
    unidentifiable_text,
    weights_text,
)
from calib.identify.statistics import Errors
from calib.identify.words import frame_text, target_text, three, wrap
from calib.version import __version__

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 46

#: More combinations that nothing determines than this are counted.
_MOST_COMBINATIONS = 12

#: More validation rows than this are not listed one by one.
_MOST_ROWS = 12

#: A row of the error table has the columns: label, n, max, mean, rms, span x, span y, span z.
_COLUMNS = "{:<33}{:>5} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9}"
_ANGLE_COLUMNS = "{:<33}{:>5} {:>9} {:>9} {:>9}"


def summary(c: Calibration) -> str:
    """The whole summary of a calibration."""
    parts = [
        _heading(c),
        _verdict(c),
        _errors(c),
        _validation_rows(c),
        _flagged(c),
        target_text(c),
        frame_text(c),
        _ladder(c),
        _identified(c),
        _parameters(c),
        wrap(correlation_text(c)),
        _larger(c),
        _solver(c),
    ]
    return "\n\n".join(part for part in parts if part)


def _heading(c: Calibration) -> str:
    """Which robot, which data."""
    m = c.rows
    return wrap(
        f"calib {__version__}: robot '{c.nominal.name}', {c.nominal.base} to {c.nominal.tip}, "
        f"{len(c.nominal.joints)} joints; {m.estimation.sum()} rows to estimate and {m.validation.sum()} to validate "
        f"from {c.source.name or 'memory'}"
    )


def _verdict(c: Calibration) -> str:
    """What to do with the result."""
    if c.verdict is None:
        return "Verdict: none, because nothing was cross-validated."
    return "\n".join(
        [f"Verdict: {c.verdict.use}", *(wrap(str(r), "  ") for r in c.verdict.reasons)]
    )


def _errors(c: Calibration) -> str:
    """The error tables: before and after, by set, and on left-out rows; a second one for orientations."""
    rows = error_rows(c)
    head = error_head(error_title(c.used))
    lines = [head, *(error_row(label, errors) for label, errors in rows if errors.n)]
    if any(errors.n_angle for _, errors in rows):
        lines += ["", angle_head()]
        lines += [angle_row(label, errors) for label, errors in rows if errors.n_angle]
    if c.cross_validation is not None:
        lines.append(left_out_text(c))
    return "\n".join(lines)


def error_head(title: str = "Position error") -> str:
    """The head of the error table."""
    return _COLUMNS.format(f"{title} [mm]", "rows", "max", "mean", "rms", "span x", "y", "z")


def angle_head() -> str:
    """The head of the table of orientations."""
    return _ANGLE_COLUMNS.format("Orientation error [deg]", "rows", "max", "mean", "rms")


def angle_row(label: str, errors: Errors) -> str:
    """One row of the table of orientations, [deg]."""
    values = [errors.max_angle, errors.mean_angle, errors.rms_angle]
    return _ANGLE_COLUMNS.format(label, errors.n_angle, *(f"{np.degrees(v):.4f}" for v in values))


def error_row(label: str, errors: Errors) -> str:
    """One row of the error table, [mm]."""
    values = [errors.max, errors.mean, errors.rms, *errors.span_axis]
    texts = [f"{1e3 * v:.3f}" if np.isfinite(v) else "-" for v in values]
    return _COLUMNS.format(label, errors.n, *texts)


def _validation_rows(c: Calibration) -> str:
    """Errors of single validation rows by axis, before and after, as in the paper's Table 4; only if they are few."""
    m = c.rows
    chosen = np.flatnonzero(m.validation & np.all(c.used[:, :3], axis=1) & (c.used.shape[1] >= 3))
    if not 0 < len(chosen) <= _MOST_ROWS:
        return ""
    columns = "{:<18}" + " {:>8}" * 4 + "   " + " {:>8}" * 4
    lines = [
        columns.format(
            "Validation rows", "before dx", "dy", "dz", "norm", "after dx", "dy", "dz", "norm"
        )
    ]
    for i in chosen:
        values = [
            three(1e3 * float(value))
            for residual in (c.residual_nominal[i], c.residual_calibrated[i])
            for value in (*residual[:3], np.linalg.norm(residual[:3]))
        ]
        lines.append(columns.format(f"  row {m.numbers[i]} [mm]", *values))
    return "\n".join(lines)


def _flagged(c: Calibration) -> str:
    """The rows that do not belong to the others."""
    lines = []
    if c.outliers:
        lines.append(wrap(f"Outliers ({weights_text(c)}): {listed(c.outliers)}"))
        if c.robustness is not None:
            lines.append(wrap(c.robustness.sentence(), "  "))
    else:
        lines.append("Outliers: none.")
    if c.suspects:
        lines.append(
            wrap(
                f"Validation rows that the calibrated robot does not explain: {listed(c.suspects)}"
            )
        )
    return "\n".join(lines)


def _ladder(c: Calibration) -> str:
    """The models that were tried, and which of them were chosen."""
    if not c.candidates:
        return ""
    lines = [
        f"{'Models tried':<36}{'parameters':>10}{'evidence':>10}{'left-out rms':>16}  chosen for"
    ]
    best = max(one.log_likelihood for one in c.candidates)
    words = {"geometry": "the URDF", "larger": "result file, predict()"}
    lines += [
        f"  {one.name:<34}{one.parameters:>10}{one.log_likelihood - best:>10.1f}{candidate_rms(one):>16}  "
        f"{words.get(one.chosen, '')}".rstrip()
        for one in c.candidates
    ]
    lines.append(
        "  evidence: restricted log likelihood, less the best one's; a step up must gain "
        f"{c.candidates[0].needed:.1f}"
    )
    return "\n".join(lines)


def _larger(c: Calibration) -> str:
    """The parameters of the larger model that the geometry does not have."""
    if c.larger is None:
        return ""
    lines = [f"Larger model '{c.larger.name}', not in the URDF:"]
    for name, value, half, unit in larger_parameters(c):
        lines.append(f"  {name:<{_LONGEST_NAME}}{value:>10} {half} {unit}")
    return "\n".join(lines)


def _identified(c: Calibration) -> str:
    """Noise, sizes, rank and what the poses cannot tell apart."""
    every = c.observability.unidentifiable
    lines = [
        wrap(noise_text(c)),
        repeats_text(c),
        wrap(expected_text(c)),
        sizes_text(c),
        rank_text(c),
    ]
    lines += [unidentifiable_text(c), *(wrap(str(u), "  ") for u in every[:_MOST_COMBINATIONS])]
    if len(every) > _MOST_COMBINATIONS:
        lines.append(f"  and {len(every) - _MOST_COMBINATIONS} more")
    return "\n".join(line for line in lines if line)


def _parameters(c: Calibration) -> str:
    """The parameters with their 95 % intervals; * where the data know them in combinations only."""
    shown = [parameter_text(p) for p in shown_parameters(c)]
    if not shown:
        return ""
    width = min(max(len(p.name) for p in shown), _LONGEST_NAME) + 2
    lines = [f"{'Parameter':<{width}}{'nominal':>12}{'value':>12}{'change':>11}{'95 % +-':>10}"]
    none = errorless(c)
    for p in shown:
        mark = " #" if p.name in none else "" if p.identifiable else " *"
        half = "-" if p.name in none else p.half
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(wrap(name))
            name = ""
        lines.append(
            f"{name:<{width}}{p.nominal:>12}{p.value:>12}{p.change:>11}{half:>10} {p.unit}{mark}"
        )
    if none:
        lines.append("# no errors of this kind were found, so it stays as it was")
    if not all(p.identifiable or p.name in none for p in shown):
        lines.append("* known in combination with others only; see above")
    return "\n".join(lines)


def _solver(c: Calibration) -> str:
    """How the solver fared; a fleet's results do not say how long it took."""
    took = "" if math.isnan(c.seconds) else f", {1e3 * c.seconds:.0f} ms"
    return wrap(f"{solver_text(c)}{took}. {c.solution.message}")
