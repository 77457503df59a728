"""The result as text for a terminal: what to do, how good it is, what was found. At most 100 columns, no colours."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

import numpy as np
import pinocchio as pin

import calib
from calib.identify.calibration import Calibration
from calib.identify.findings import Outlier
from calib.identify.statistics import Errors
from calib.model.parameters import FRAME

_WIDTH = 100

#: A target that moved further than this was given wrongly, rather than mounted inexactly [m].
_TARGET_MOVED = 5e-3

#: A parameter with a longer name gets a line for its name alone.
_LONGEST_NAME = 46

#: What is left out at a time.
_LEFT_OUT = {
    "leave-one-out": "each row predicted from the others alone",
    "leave-one-pose-out": "each pose, repeats and all, predicted from the others alone",
}

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


def summary(c: Calibration) -> str:
    """The whole summary of a calibration."""
    parts = [
        _heading(c),
        _verdict(c),
        _errors(c),
        _validation_rows(c),
        _flagged(c),
        _target(c),
        _frame(c),
        _identified(c),
        _parameters(c),
        _solver(c),
    ]
    return "\n\n".join(part for part in parts if part)


def _heading(c: Calibration) -> str:
    """Which robot, which data."""
    m = c.measurements
    return _wrap(
        f"calib {calib.__version__}: robot '{c.nominal.name}', {c.nominal.base} to {c.nominal.tip}, "
        f"{len(c.nominal.joints)} joints; {m.estimation.sum()} rows to estimate and {m.validation.sum()} to validate "
        f"from {m.source or 'memory'}"
    )


def _verdict(c: Calibration) -> str:
    """What to do with the result."""
    if c.verdict is None:
        return "Verdict: none, because nothing was cross-validated."
    return "\n".join([f"Verdict: {c.verdict.use}", *(_wrap(r, "  ") for r in c.verdict.reasons)])


def _errors(c: Calibration) -> str:
    """The error table: before and after, by set, and on left-out rows."""
    rows = [error_head()]
    for name, label in (("estimation", "estimation rows"), ("validation", "validation rows")):
        for who in ("nominal", "calibrated"):
            errors = c.errors[who][name]
            if errors.n:
                rows.append(error_row(f"{label}, {who}", errors))
    if c.cross_validation is None or c.nominal_cross_validation is None:
        return "\n".join(rows)
    for who, v in (("nominal", c.nominal_cross_validation), ("calibrated", c.cross_validation)):
        rows.append(error_row(f"left-out rows*, {who}", v.errors))
        if c.outliers:
            rows.append(error_row("  the same without outliers", v.errors_without_outliers))
    method = c.cross_validation.method
    rows.append(
        f"* {method}: {_LEFT_OUT.get(method, 'a tenth of the poses at a time, predicted from the others')}"
    )
    return "\n".join(rows)


def error_head() -> str:
    """The head of the error table."""
    return _COLUMNS.format("Position error [mm]", "rows", "max", "mean", "rms", "span x", "y", "z")


def error_row(label: str, errors: Errors) -> str:
    """One row of the error table, [mm]."""
    values = [errors.max, errors.mean, errors.rms, *errors.span_axis]
    return _COLUMNS.format(label, errors.n, *(f"{1e3 * v:.3f}" for v in values))


def _validation_rows(c: Calibration) -> str:
    """Errors of single validation rows by axis, before and after, as in the paper's Table 4; only if they are few."""
    m = c.measurements
    chosen = np.flatnonzero(m.validation)
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
            _three(1e3 * float(value))
            for residual in (c.residual_nominal[i], c.residual_calibrated[i])
            for value in (*residual, np.linalg.norm(residual))
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
        lines.append(_wrap(f"Outliers ({treated}): {_list(c.outliers)}"))
    else:
        lines.append("Outliers: none.")
    if c.suspects:
        lines.append(
            _wrap(
                f"Validation rows that the calibrated robot does not explain: {_list(c.suspects)}"
            )
        )
    return "\n".join(lines)


def _list(outliers: Iterable[Outlier]) -> str:
    """Rows with residual and score; the first dozen."""
    every = list(outliers)
    text = "; ".join(
        f"row {o.row} ({1e3 * o.residual:.2f} mm, {o.score:.1f} sigma)" for o in every[:12]
    )
    return text + (f"; and {len(every) - 12} more" if len(every) > 12 else "")


def _target(c: Calibration) -> str:
    """Where the target is, how sure that is, and how far from where it was said to be."""
    place = ", ".join(_three(1e3 * float(v)) for v in c.target)
    if not c.cell.estimate_target:
        return _wrap(f"Target: ({place}) mm in {c.nominal.tip}, as given.")
    sure = _half_widths(c, [f"target_{axis}" for axis in "xyz"], 1e3)
    given = c.fitted.task.setup
    if not given.target_given[0]:
        return _wrap(f"Target: found at ({place}) mm in {c.nominal.tip}, 95 % +- ({sure}) mm.")
    moved = float(np.linalg.norm(c.target - given.T_tip_target[0, :3, 3]))
    text = (
        f"Target: ({place}) mm in {c.nominal.tip}, 95 % +- ({sure}) mm; it moved {1e3 * moved:.1f} mm from the "
        "position given."
    )
    if moved > _TARGET_MOVED:
        text += " That is further than mounting explains: check the sign and the order of the numbers given."
    return _wrap(text)


def _frame(c: Calibration) -> str:
    """Where the base stands in the measurement frame, if that was estimated, and how sure that is."""
    if not c.cell.estimate_frame:
        return ""
    xyz = ", ".join(_three(1e3 * float(v)) for v in c.T_frame_base[:3, 3])
    rpy = ", ".join(
        _three(float(v)) for v in np.degrees(pin.rpy.matrixToRpy(c.T_frame_base[:3, :3]))
    )
    shift = _half_widths(c, [f"frame_{axis}" for axis in "xyz"], 1e3)
    turn = _half_widths(c, [f"frame_r{axis}" for axis in "xyz"], float(np.degrees(1.0)))
    return _wrap(
        f"Measurement frame: {c.nominal.base} found at ({xyz}) mm, rpy ({rpy}) deg in it; 95 % +- ({shift}) mm and "
        f"({turn}) deg along and about the axes of {c.nominal.base}."
    )


def _half_widths(c: Calibration, names: list[str], scale: float) -> str:
    """Half the 95 % intervals of some parameters."""
    chosen = [c.parameter(name) for name in names]
    return ", ".join(f"{0.5 * scale * (p.high - p.low):.3g}" for p in chosen)


def _identified(c: Calibration) -> str:
    """Noise, sizes, rank and what the poses cannot tell apart."""
    o = c.observability
    found = (
        f"found from what is left over ({c.freedom:.0f} d.o.f.)"
        if c.freedom >= _TELLING
        else "mostly assumed: too few rows to tell"
    )
    lines = [
        f"Noise: {1e3 * c.sigma:.3f} mm a coordinate, {found}.",
        _wrap(
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
        lines += [_wrap(str(u), "  ") for u in o.unidentifiable[:12]]
        if len(o.unidentifiable) > 12:
            lines.append(f"  and {len(o.unidentifiable) - 12} more")
    return "\n".join(lines)


def _parameters(c: Calibration) -> str:
    """The parameters with their 95 % intervals; * where the data know them in combinations only.

    The frame's stand above as a pose: its parameters count from where registration put it.
    """
    shown = [p for p, m in zip(c.parameters, c.model.parameters, strict=True) if m.family != FRAME]
    if not shown:
        return ""
    width = min(max(len(p.name) for p in shown), _LONGEST_NAME) + 2
    lines = [f"{'Parameter':<{width}}{'nominal':>12}{'value':>12}{'change':>11}{'95 % +-':>10}"]
    for p in shown:
        scale, unit = (1e3, "mm") if p.unit == "m" else (np.degrees(1.0), "deg")
        nominal = "-" if p.nominal is None else _three(scale * p.nominal)
        half = 0.5 * scale * (p.high - p.low)
        value = _three(scale * p.value)
        delta = "-" if p.nominal is None else _three(scale * p.delta, "+")
        mark = "" if p.identifiable else " *"
        name = p.name
        if len(name) > _LONGEST_NAME:
            lines.append(_wrap(name))
            name = ""
        lines.append(
            f"{name:<{width}}{nominal:>12}{value:>12}{delta:>11}{half:>10.3g} {unit}{mark}"
        )
    if not all(p.identifiable for p in shown):
        lines.append("* known in combination with others only; see above")
    return "\n".join(lines)


def _solver(c: Calibration) -> str:
    """How the solver fared."""
    s = c.solution
    return _wrap(
        f"Solver '{c.solver}': {s.status} after {s.iterations} iterations, {s.evaluations} evaluations, "
        f"{1e3 * c.seconds:.0f} ms. {s.message}"
    )


def _size(family: str, size: float) -> str:
    """The size of a family's errors in words."""
    factor, unit = _SIZES[family]
    return f"{family} {factor * size:.3g} {unit}" if factor * size > _NOTHING else f"{family} none"


def _three(value: float, sign: str = "-") -> str:
    """Three digits after the point, and no minus before a zero."""
    return f"{round(value, 3) + 0.0:{sign}.3f}"


def _wrap(text: str, indent: str = "") -> str:
    """Text broken at 100 columns."""
    return textwrap.fill(
        text,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_on_hyphens=False,
    )
