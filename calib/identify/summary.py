"""The result as text for a terminal: what to do, how good it is, what was found. At most 100 columns, no colours."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

import calib
from calib.identify.correlations import correlations
from calib.identify.findings import Outlier
from calib.identify.result import Calibration
from calib.identify.statistics import Errors
from calib.identify.words import frame_text, target_text, three, wrap
from calib.model.observability import SHOWN
from calib.model.parameters import FRAME, TARGET

#: Correlations beyond this are told, the largest few.
_WORTH_NAMING, _MOST_PAIRS = 0.95, 4

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 46

#: What is left out at a time.
_LEFT_OUT = {
    "leave-one-out": "each row predicted from the others alone",
    "leave-one-pose-out": "each pose, repeats and all, predicted from the others alone",
    "leave-one-set-up-out": "each set-up predicted from the others, but for where it stands itself",
    "leave-set-ups-out": "some set-ups predicted from the others, but for where they stand themselves",
}
_TENTHS = "a tenth of the poses at a time, predicted from the others"

#: Degrees of freedom from which on the noise is that of the rows.
_TELLING = 6.0

#: How the size of each family's errors is written.
_SIZES = {
    "length": (1e3, "mm"),
    "angle": (1e3, "mrad"),
    "zero": (1e3, "mrad"),
    "gain": (1e3, "mrad/rad"),
    "eccentricity": (1e3, "mrad"),
    "compliance": (1e6, "urad/Nm"),
}

#: A size of errors below this says that there are none [mm, mrad, urad/Nm].
_NOTHING = 2e-3

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
        _correlations(c),
        _larger(c),
        _solver(c),
    ]
    return "\n\n".join(part for part in parts if part)


def _heading(c: Calibration) -> str:
    """Which robot, which data."""
    m = c.measurements
    return wrap(
        f"calib {calib.__version__}: robot '{c.nominal.name}', {c.nominal.base} to {c.nominal.tip}, "
        f"{len(c.nominal.joints)} joints; {m.estimation.sum()} rows to estimate and {m.validation.sum()} to validate "
        f"from {m.source or 'memory'}"
    )


def _verdict(c: Calibration) -> str:
    """What to do with the result."""
    if c.verdict is None:
        return "Verdict: none, because nothing was cross-validated."
    return "\n".join([f"Verdict: {c.verdict.use}", *(wrap(r, "  ") for r in c.verdict.reasons)])


def _errors(c: Calibration) -> str:
    """The error tables: before and after, by set, and on left-out rows; a second one for orientations."""
    rows = _error_rows(c)
    lines = [error_head(), *(error_row(label, errors) for label, errors in rows if errors.n)]
    if any(errors.n_angle for _, errors in rows):
        lines += ["", angle_head()]
        lines += [angle_row(label, errors) for label, errors in rows if errors.n_angle]
    if c.cross_validation is not None:
        method = c.cross_validation.method
        lines.append(f"* {method}: {_LEFT_OUT.get(method, _TENTHS)}")
    return "\n".join(lines)


def _error_rows(c: Calibration) -> list[tuple[str, Errors]]:
    """Label and errors of each row of the tables."""
    rows = [
        (f"{label} rows, {who}", c.errors[who][name])
        for name, label in (("estimation", "estimation"), ("validation", "validation"))
        for who in c.errors
    ]
    larger = None if c.larger is None else c.larger.cross_validation
    for who, v in (
        ("nominal", c.nominal_cross_validation),
        ("calibrated", c.cross_validation),
        ("larger", larger),
    ):
        if v is not None:
            rows.append((f"left-out rows*, {who}", v.errors))
            if c.outliers:
                rows.append(("  the same without outliers", v.errors_without_outliers))
    return rows


def error_head() -> str:
    """The head of the error table."""
    return _COLUMNS.format("Position error [mm]", "rows", "max", "mean", "rms", "span x", "y", "z")


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
    m = c.measurements
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
        lines.append(columns.format(f"  row {m.rows[i]} [mm]", *values))
    return "\n".join(lines)


def _flagged(c: Calibration) -> str:
    """The rows that do not belong to the others."""
    lines = []
    if c.outliers:
        weights = dict(zip(c.measurements.rows, c.weights, strict=True))
        unused = not any(weights.get(o.row) for o in c.outliers)
        treated = (
            "they have no weight in the fit" if unused else "they keep their weight in this fit"
        )
        lines.append(wrap(f"Outliers ({treated}): {_list(c.outliers)}"))
        if c.robustness is not None:
            lines.append(wrap(c.robustness.sentence(), "  "))
    else:
        lines.append("Outliers: none.")
    if c.suspects:
        lines.append(
            wrap(f"Validation rows that the calibrated robot does not explain: {_list(c.suspects)}")
        )
    return "\n".join(lines)


def _list(outliers: Iterable[Outlier]) -> str:
    """Rows with residual and score; the first dozen."""
    every = list(outliers)
    text = "; ".join(
        f"row {o.row} ({1e3 * o.residual:.2f} mm, {o.score:.1f} sigma)" for o in every[:12]
    )
    return text + (f"; and {len(every) - 12} more" if len(every) > 12 else "")


def _ladder(c: Calibration) -> str:
    """The models that were tried, and which of them were chosen."""
    if not c.candidates:
        return ""
    lines = [
        f"{'Models tried':<36}{'parameters':>10}{'evidence':>10}{'left-out rms':>16}  chosen for"
    ]
    best = max(one.log_likelihood for one in c.candidates)
    words = {"geometry": "the URDF", "larger": "result file, predict()"}
    for one in c.candidates:
        errors = one.cross_validation.errors_without_outliers
        rms = (
            f"{1e3 * errors.rms:.3f} mm" if errors.n else f"{np.degrees(errors.rms_angle):.4f} deg"
        )
        lines.append(
            f"  {one.name:<34}{one.parameters:>10}{one.log_likelihood - best:>10.1f}{rms:>16}  "
            f"{words.get(one.chosen, '')}".rstrip()
        )
    lines.append(
        "  evidence: restricted log likelihood, less the best one's; a step up must gain "
        f"{c.candidates[0].needed:.1f}"
    )
    return "\n".join(lines)


def _correlations(c: Calibration) -> str:
    """The pairs of parameters that hang together most, if any do."""
    pairs = correlations(c, _WORTH_NAMING)[:_MOST_PAIRS]
    if not pairs:
        return ""
    listed = ", ".join(f"{p.first} and {p.second} ({p.value:+.2f})" for p in pairs)
    return wrap(f"Known together better than apart (correlation): {listed}.")


def _larger(c: Calibration) -> str:
    """The parameters of the larger model that the geometry does not have."""
    if c.larger is None:
        return ""
    shown = [p for p in c.larger.parameters if p.name not in c.model.names]
    lines = [f"Larger model '{c.larger.name}', not in the URDF:"]
    for p in shown:
        factor, unit = SHOWN[p.unit]
        half = "(at bound)" if p.at_bound else f"+- {0.5 * factor * (p.high - p.low):.3f}"
        lines.append(f"  {p.name:<{_LONGEST_NAME}}{factor * p.value:>10.3f} {half} {unit}")
    return "\n".join(lines)


def _identified(c: Calibration) -> str:
    """Noise, sizes, rank and what the poses cannot tell apart."""
    o = c.observability
    found = (
        f"found from what is left over ({c.freedom:.0f} d.o.f.)"
        if c.freedom >= _TELLING
        else "mostly assumed: too few rows to tell"
    )
    parts = [f"{1e3 * c.sigma:.3f} mm a coordinate"] * bool(np.isfinite(c.sigma))
    parts += [f"{np.degrees(c.sigma_angle):.4f} deg about an axis"] * bool(
        np.isfinite(c.sigma_angle)
    )
    lines = [
        wrap(f"Noise: {' and '.join(parts)}, {found}."),
        *_repeats(c),
        wrap(
            f"Expected error, if the model is complete: {1e3 * c.expected_measured:.3f} mm rms at the measured poses, "
            f"{1e3 * c.expected_everywhere:.3f} mm over the joint limits."
        ),
    ]
    sizes = [_size(family, size) for family, size in c.sizes.items()]
    if sizes:
        how = "found from the data" if c.cell.priors.sizes == "data" else "as given"
        lines.append(f"Size of the robot's errors: {', '.join(sizes)} ({how}).")
    lines.append(f"Rank: {o.rank} of {o.columns} parameters, condition number {o.condition:.0f}.")
    if o.unidentifiable:
        held = ", so the priors share them out" if sizes else ""
        lines.append(f"These changes move nothing that was measured{held}:")
        lines += [wrap(str(u), "  ") for u in o.unidentifiable[:12]]
        if len(o.unidentifiable) > 12:
            lines.append(f"  and {len(o.unidentifiable) - 12} more")
    return "\n".join(lines)


def _parameters(c: Calibration) -> str:
    """The parameters with their 95 % intervals; * where the data know them in combinations only.

    Frames and the targets' orientations stand above as poses: their parameters count from where registration put them.
    """
    shown = [
        p
        for p, m in zip(c.parameters, c.model.parameters, strict=True)
        if m.family != FRAME and not (m.family == TARGET and m.unit == "rad")
    ]
    if not shown:
        return ""
    width = min(max(len(p.name) for p in shown), _LONGEST_NAME) + 2
    lines = [f"{'Parameter':<{width}}{'nominal':>12}{'value':>12}{'change':>11}{'95 % +-':>10}"]
    for p in shown:
        scale, unit = (1e3, "mm") if p.unit == "m" else (np.degrees(1.0), "deg")
        nominal = "-" if p.nominal is None else three(scale * p.nominal)
        half = "at bound" if p.at_bound else f"{0.5 * scale * (p.high - p.low):.3g}"
        value = three(scale * p.value)
        delta = "-" if p.nominal is None else three(scale * p.delta, "+")
        mark = "" if p.identifiable else " *"
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(wrap(name))
            name = ""
        lines.append(f"{name:<{width}}{nominal:>12}{value:>12}{delta:>11}{half:>10} {unit}{mark}")
    if not all(p.identifiable for p in shown):
        lines.append("* known in combination with others only; see above")
    return "\n".join(lines)


def _solver(c: Calibration) -> str:
    """How the solver fared."""
    s = c.solution
    return wrap(
        f"Solver '{c.solver}': {s.status} after {s.iterations} iterations, {s.evaluations} evaluations, "
        f"{1e3 * c.seconds:.0f} ms. {s.message}"
    )


def _repeats(c: Calibration) -> list[str]:
    """How far repeats of a pose scatter."""
    if c.repeats is None or not np.isfinite(c.repeats.within[0]):
        return []
    scatter, freedom = 1e3 * float(c.repeats.within[0]), float(c.repeats.freedoms[0])
    return [f"Repeats of a pose scatter by {scatter:.3f} mm a coordinate ({freedom:.0f} d.o.f.)."]


def _size(family: str, size: float) -> str:
    """The size of a family's errors in words."""
    factor, unit = _SIZES[family]
    return f"{family} {factor * size:.3g} {unit}" if factor * size > _NOTHING else f"{family} none"
