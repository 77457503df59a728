"""Figures of the errors before and after calibration: over the rows, by axis, and their distributions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, Mask
from calib.basics.channels import RESIDUAL_UNITS, VECTOR, Channels
from calib.numerics.errors import CrossValidation
from calib.result.calibration import Calibration
from calib.show.look import AFTER, BEFORE, INK, SOFT, RobotStyle, row_kinds, rows_text
from calib.show.plotting import few_ticks, legend_above, log_axis, new_figure, number_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Curves over more rows than this have no markers: they would overlap.
_MOST_MARKERS = 80

#: Curves over more rows than this are pixels in SVG and PDF, and replace the single marks of rows.
_MOST_LINES = 1000

#: Residuals are drawn up to so many standard deviations.
_REACH = 5.0

#: Outliers are drawn at most so many times as high as the largest error of the other rows.
_OUTLIER_EDGE = 1.25


class CurveRows(NamedTuple):
    """The rows of the error curves and their residuals."""

    #: ``"validation"``, ``"held-out"`` or ``"estimation"``
    name: str
    #: Shape (N,), the rows drawn
    mask: Mask
    #: Shape (N, D), measured minus predicted by the nominal robot, in the units of the rows' channels
    before: Array
    #: Shape (N, D), of the calibrated robot
    after: Array


def curve_rows(c: Calibration) -> CurveRows:
    """Choose, among rows that measure a length, those of the error curves, with the residuals of all rows.

    The validation rows if there are any, else the estimation rows with held-out predictions if the result was
    cross-validated, else the estimation rows with the fit's own predictions.
    """
    m = c.fit.measurements
    measured = np.any(c.rows.channels.where("m"), axis=1)
    validation = m.validation & measured
    estimation = m.estimation & measured
    if np.any(validation):
        return CurveRows(
            "validation", validation, c.rows.residual_nominal, c.rows.residual_calibrated
        )
    before = c.trust.nominal_cross_validation
    after = c.cross_validation
    if before is not None and after is not None:
        return CurveRows("held-out", estimation, _held_out(c, before), _held_out(c, after))
    return CurveRows("estimation", estimation, c.rows.residual_nominal, c.rows.residual_calibrated)


def _held_out(c: Calibration, validated: CrossValidation) -> Array:
    """Return the residuals (N, D) of a cross-validation; NaN for validation rows."""
    residual = np.full(c.rows.residual_calibrated.shape, np.nan)
    residual[c.fit.measurements.estimation] = validated.residual
    return residual


def curves(c: Calibration) -> Figure:
    """Draw the errors over the rows, before and after, as the paper's figure 8.

    Errors along x, y and z and their norm have a panel each; measured lengths have one, their errors with their signs.
    """
    shown = curve_rows(c)
    _, are_vectors = c.rows.channels.vector_columns("m")
    with_axes = bool(np.any(are_vectors[shown.mask]))
    figure = new_figure(4.9 if with_axes else 2.8)
    shape = (2, 2) if with_axes else (1, 1)
    panels = figure.subplots(*shape, sharex=True, squeeze=False)
    numbers = np.array(c.fit.measurements.rows)[shown.mask]
    for style, residual in ((BEFORE, shown.before), (AFTER, shown.after)):
        errors = 1e3 * _curve_values(residual, c.rows.channels, with_axes=with_axes)[shown.mask]
        for ax, values in zip(panels.ravel(), errors.T, strict=True):
            _curve(ax, numbers, values, style)
    titles = ["Δx", "Δy", "Δz", "Size of the error"] if with_axes else ["Error of the length"]
    for ax, title in zip(panels.ravel(), titles, strict=True):
        ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
        ax.xaxis.set_major_locator(few_ticks(6 if with_axes else 10, integers=True))
        ax.set(title=title, ylabel="error [mm]")
    if with_axes:
        # One scale for x, y and z, symmetric about zero, so that they can be compared.
        by_axis = panels.ravel()[:VECTOR]
        reach = float(np.max(np.abs([ax.get_ylim() for ax in by_axis])))
        for ax in by_axis:
            ax.set_ylim(-reach, reach)
        panels[1, 1].set_ylim(bottom=0.0)
    for ax in panels[-1]:
        ax.set_xlabel(f"{shown.name} row")
    legend_above(figure)
    return figure


def _curve_values(residual: Array, channels: Channels, *, with_axes: bool) -> Array:
    """Return errors along x, y, z and their norm, shape (N, 4), or signed errors of lengths, shape (N, 1), [m].

    They are NaN if a row has none. A row with several lengths that are not a position has the norm of their errors.
    """
    norms = np.where(np.isnan(residual).any(axis=1), np.nan, channels.norms(residual, "m"))
    if with_axes:
        columns, are_vectors = channels.vector_columns("m")
        by_axis = np.where(are_vectors[:, None], residual[:, columns], np.nan)
        return np.column_stack([by_axis, norms])
    of_lengths = channels.where("m")
    signed = np.sum(np.where(of_lengths, residual, 0.0), axis=1)
    is_single = of_lengths.sum(axis=1) == 1
    return np.asarray(np.where(is_single, signed, norms)[:, None])


def _sizes(c: Calibration, unit: str) -> tuple[Array, Array]:
    """Return each row's error by the nominal and by the calibrated robot in the unit shown, (N,); NaN for none."""
    scale = RESIDUAL_UNITS[unit].to_shown
    before = scale * c.rows.channels.norms(c.rows.residual_nominal, unit)
    after = scale * c.rows.channels.norms(c.rows.residual_calibrated, unit)
    return before, after


def by_row(c: Calibration, unit: str = "m") -> Figure:
    """Draw the size of each row's error: before and after above; after alone below, magnified.

    Args:
        c: The result.
        unit: Symbol of the unit: ``"m"`` for lengths, ``"rad"`` for orientations, ``"px"`` for images.
    """
    rows = np.array(c.fit.measurements.rows)
    before, after = _sizes(c, unit)
    figure = new_figure(4.6)
    top, below = figure.subplots(2, 1, sharex=True)
    _curve(top, rows, before, BEFORE)
    _curve(top, rows, after, AFTER)

    # After calibration: each row, held-out ones as dashes, up to the largest that is not flagged.
    flagged = c.rows.flagged
    reach = float(np.nanmax(after[~flagged], initial=1e-3))
    kinds = [kind for kind in row_kinds(c) if np.any(np.isfinite(after[kind.mask]))]
    if len(rows) > _MOST_LINES:
        _curve(below, rows, np.where(flagged, np.nan, after), AFTER)
        kinds = [kind for kind in kinds if kind.name == "outlier"]
    elif c.cross_validation is not None:
        residual = _held_out(c, c.cross_validation)
        held_out = RESIDUAL_UNITS[unit].to_shown * c.rows.channels.norms(residual, unit)
        held_out[np.isnan(residual).any(axis=1) | flagged] = np.nan
        reach = float(np.nanmax(held_out, initial=reach))
        look: dict[str, Any] = {"ls": "none", "marker": "_", "ms": 7, "mew": 1.1, "color": SOFT}
        below.plot(rows, held_out, label="held out", **look)
    # Outliers far above the others stand at the edge: the panel above has them to scale.
    shown = np.where(flagged, np.minimum(after, _OUTLIER_EDGE * reach), after)
    for kind in kinds:
        at = kind.mask & np.isfinite(shown)
        if len(rows) <= _MOST_MARKERS:
            below.vlines(rows[at], 0.0, shown[at], color=kind.colour, lw=0.9, alpha=0.6)
        below.plot(rows[at], shown[at], **kind.style())
    number_points(below, c.fit.measurements.rows, np.stack([rows, shown], axis=1), flagged)

    for ax, title in ((top, "Before and after"), (below, "After")):
        ax.set_title(title)
        ax.set_ylabel(f"size of the error [{RESIDUAL_UNITS[unit].shown}]")
        ax.xaxis.set_major_locator(few_ticks(9, integers=True))
    below.set_xlabel("row")
    top.set_ylim(bottom=0.0)
    below.set_ylim(0.0, 1.32 * reach)
    legend_above(figure, 3)
    return figure


def by_axis(c: Calibration, unit: str = "m") -> Figure:
    """Draw the distribution of errors along or about each axis as boxes; a column of panels for each set of rows.

    Before and after above; after alone below, magnified and without outliers.

    Args:
        c: The result.
        unit: Symbol of the unit: ``"m"`` for lengths, ``"rad"`` for orientations.
    """
    m = c.fit.measurements
    of_unit = RESIDUAL_UNITS[unit]
    columns, are_vectors = c.rows.channels.vector_columns(unit)
    before = of_unit.to_shown * c.rows.residual_nominal[:, columns]
    after = of_unit.to_shown * c.rows.residual_calibrated[:, columns]
    flagged = c.rows.flagged
    masks = {"estimation": m.estimation & are_vectors, "validation": m.validation & are_vectors}
    sets = {name: mask for name, mask in masks.items() if np.any(mask)}

    figure = new_figure(4.6)
    panels = figure.subplots(2, len(sets), squeeze=False, sharey="row", sharex=True)
    for (upper, lower), (name, mask) in zip(panels.T, sets.items(), strict=True):
        _boxes(upper, before[mask], -0.19, BEFORE)
        _boxes(upper, after[mask], 0.19, AFTER)
        _boxes(lower, after[mask & ~flagged], 0.0, AFTER)
        upper.set_title(rows_text(mask, name))
        addition = "without outliers" if np.any(flagged[mask]) else "alone"
        lower.set_title(f"After, {addition}")
        for ax in (upper, lower):
            ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
            ax.grid(visible=False, axis="x")
        prefix = "about " if of_unit.preposition == "about" else ""
        lower.set_xticks(range(VECTOR), [f"{prefix}{axis}" for axis in "xyz"])
    for ax in panels[:, 0]:
        ax.set_ylabel(f"error {of_unit.preposition} the axis [{of_unit.shown}]")
    legend_above(figure)
    return figure


def histograms(c: Calibration) -> Figure:
    """Draw the distribution of the errors' sizes, and that of the residuals over their noise beside the normal one.

    Sizes are of all rows, in the first unit that was measured; residuals are of all scalars of the estimation rows.
    """
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)

    # Sizes of all rows' errors, on a logarithmic scale.
    unit = c.rows.channels.present[0]
    before, after = (sizes[np.isfinite(sizes)] for sizes in _sizes(c, unit))
    # Bins are even in the logarithm; what is far below the median is put into the first one.
    high = max(float(np.concatenate([before, after]).max()), 1e-6)
    low = min(max(0.05 * float(np.median(after)), 1e-6 * high), 0.5 * high)
    count = int(np.clip(2.0 * np.sqrt(len(after)) + 5, 9, 61))
    edges = list(np.geomspace(low, 1.001 * high, count))
    for style, values in ((BEFORE, before), (AFTER, after)):
        if not len(values):  # of a nominal robot that is not judged
            continue
        shown = np.maximum(values, low)
        left.hist(shown, edges, histtype="stepfilled", label=style.label, **style.area)
    log_axis(left, "x")
    left.set(xlabel=f"size of the error [{RESIDUAL_UNITS[unit].shown}]", ylabel="rows")
    left.set_title(f"All {len(after):,} rows")

    # Residuals of the estimation rows over their noise.
    scaled = scaled_residuals(c)
    bins = int(np.clip(np.sqrt(len(scaled)) * 1.5, 8, 50))
    ends = np.linspace(-_REACH, _REACH, bins + 1)
    right.hist(scaled, list(ends), histtype="stepfilled", **AFTER.area)
    t = np.linspace(-_REACH, _REACH, 201)
    normal = np.exp(-0.5 * t**2) / np.sqrt(2.0 * np.pi) * len(scaled) * (ends[1] - ends[0])
    right.plot(t, normal, color=INK, lw=1.2, ls="--", label="normal")
    right.set(xlabel="residual / its noise", ylabel="measured scalars")
    right.set_title(f"{len(scaled):,} scalars of estimation rows")
    outside = int(np.sum(np.abs(scaled) > _REACH))
    if outside:
        right.plot([], [], ls="none", label=f"{outside:,} beyond ±{_REACH:g}")
    for ax in (left, right):
        ax.yaxis.set_major_locator(few_ticks(6, integers=True))
    legend_above(figure)
    return figure


def scaled_residuals(c: Calibration) -> Array:
    """Return the calibrated residual of each measured scalar of the estimation rows over its estimated noise, (K,)."""
    problem = c.fit.geometry.estimate.problem
    residual = c.rows.residual_calibrated[c.fit.measurements.estimation]
    return np.asarray((residual / problem.scales)[problem.rows.used])


def _curve(ax: Axes, rows: NDArray[np.int_], values: Array, style: RobotStyle) -> None:
    """Draw a robot's errors (K,), NaN for none, over row numbers (K,): with markers if few, as pixels if many."""
    # The line passes over rows without a value, such as the second rows of pairs: gaps would leave nothing of it.
    finite = np.isfinite(values)
    if not finite.any():  # no entry in the legend either
        return
    # Rows that were measured in another order than that of their numbers are drawn by number.
    by_number = np.argsort(rows[finite], kind="stable")
    rows = rows[finite][by_number]
    values = values[finite][by_number]
    few = len(values) <= _MOST_MARKERS
    look: dict[str, Any] = {"color": style.colour, "label": style.label, "zorder": 3}
    if few:
        look |= {"ls": style.line, "marker": style.marker, "ms": 3.6}
    many = len(values) > _MOST_LINES
    ax.plot(rows, values, lw=1.3 if few else 0.6, mec="white", mew=0.4, rasterized=many, **look)


def _boxes(ax: Axes, values: Array, shift: float, style: RobotStyle) -> None:
    """Draw a box for the errors (K, 3) along or about each axis, shifted from the ticks 0, 1, 2."""
    line = {"color": style.colour, "lw": 1.4}
    parts = ax.boxplot(
        list(values.T),
        positions=[k + shift for k in range(VECTOR)],
        widths=0.3,
        whis=(5, 95),
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops=style.area,
        medianprops={"color": INK, "lw": 1.4},
        whiskerprops=line,
        capprops=line,
    )
    parts["boxes"][0].set_label(style.label)
