"""Errors before and after: over the rows, by axis, and how often which size occurs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import calib.report.figure_base as base
import calib.report.label_rows as labels
from calib.estimate.statistics import CrossValidation
from calib.result.calibration import Calibration

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: More rows than this get no markers, and more than that are pixels in SVG and PDF.
_MOST_MARKERS, _MOST_LINES = 80, 1000

#: Residuals are drawn up to so many standard deviations.
_REACH = 5.0

_BY_ROW = (
    "of all rows, {rows}, in the order of the table, [UNIT]: before and after calibration "
    f"above, after it alone below. Dashes: rows predicted by fits that have not seen them. {base.EDGE}"
)
_BY_AXIS = (
    "the axes of the measurement frame, measured minus predicted, [UNIT], of {rows}. Above, both robots; below, the "
    "calibrated one alone, without outliers. Boxes hold the middle half of the rows and their median; whiskers reach "
    "from 5 to 95 %."
)


class _What(NamedTuple):
    """Lengths, or orientations: their columns of the residuals, size, factor and unit."""

    columns: slice
    size: Callable[[Array, Mask], Array]
    scale: float
    unit: str


_LENGTH = _What(slice(0, 3), labels.lengths_of, 1e3, "mm")
_ANGLE = _What(slice(3, 6), labels.angles_of, float(np.degrees(1.0)), "deg")


def curve_rows(c: Calibration) -> tuple[str, Mask, Array, Array]:
    """The rows of the error curves: what they are called, which they are, and both robots' residuals, (N, D).

    Those for validation if there are any, else the estimation rows as fits predict them that had not seen them, else
    the estimation rows.
    """
    m, measured = c.measurements, np.any(c.used[:, :3], axis=1)
    if np.any(m.validation & measured):
        return "validation", m.validation & measured, c.residual_nominal, c.residual_calibrated
    before, after = _left_out(c, c.nominal_cross_validation), _left_out(c, c.cross_validation)
    if before is not None and after is not None:
        return "left-out", m.estimation & measured, before, after
    return "estimation", m.estimation & measured, c.residual_nominal, c.residual_calibrated


def _left_out(c: Calibration, found: CrossValidation | None) -> Array | None:
    """Measured minus predicted by fits that had not seen the row, shape (N, D), NaN for validation rows; or None."""
    if found is None:
        return None
    residual = np.full(c.residual_calibrated.shape, np.nan)
    residual[c.measurements.estimation] = found.residual
    return residual


@base.figure(
    "error-curves",
    "errors",
    "Errors before and after calibration",
    "Errors along x, y and z and their size, or the error of the length where a row measures one, measured minus "
    "predicted, [mm], on {curve_rows}: by the nominal robot (dashed) and by the calibrated one (solid).",
    base.has_lengths,
)
def curves(c: Calibration) -> Figure:
    """As the paper's figure 8. Lengths have one panel: their errors with their signs."""
    word, mask, before, after = curve_rows(c)
    axes_too = base.has_axes(c, mask)
    whole = np.all(c.used[mask, :3], axis=1) if axes_too else c.used[mask, 0]
    rows = np.array(c.measurements.rows)[mask]
    drawn = base.new_figure(4.9 if axes_too else 2.8)
    panels = drawn.subplots(*((2, 2) if axes_too else (1, 1)), sharex=True, squeeze=False)
    *signed, last = panels.ravel()
    for who, residual in ((base.BEFORE, before), (base.AFTER, after)):
        for k, ax in enumerate(signed or [last]):
            _curve(ax, rows, np.where(whole, 1e3 * residual[mask, k], np.nan), who)
            ax.set_title(f"Δ{'xyz'[k]}" if axes_too else "Error of the length")
        if axes_too:
            _curve(last, rows, 1e3 * labels.lengths_of(residual, c.used)[mask], who)
    if axes_too:
        last.set_title("Size of the error")
        last.set_ylim(bottom=0.0)
        # One scale for the three, so that they can be compared.
        reach = max(float(np.max(np.abs(ax.get_ylim()))) for ax in signed)
        for ax in signed:
            ax.set_ylim(-reach, reach)
    for ax in panels.ravel():
        ax.axhline(0.0, color=labels.INK, lw=0.7, zorder=1.5)
        ax.xaxis.set_major_locator(base.few_ticks(6 if axes_too else 10, whole=True))
        ax.set_ylabel("error [mm]")
    for ax in panels[-1]:
        ax.set_xlabel(f"{word} row")
    base.legend_above(drawn, _curve_handles(len(rows)))
    return drawn


def _by_row(c: Calibration, what: _What) -> Figure:
    """The size of each row's error: before and after above; after alone below."""
    m, rows, others = c.measurements, np.array(c.measurements.rows), ~labels.flagged_rows(c)
    before, after = (
        what.scale * what.size(r, c.used) for r in (c.residual_nominal, c.residual_calibrated)
    )
    drawn = base.new_figure(4.6)
    top, below = drawn.subplots(2, 1, sharex=True)
    _curve(top, rows, before, base.BEFORE)
    _curve(top, rows, after, base.AFTER)
    handles = _curve_handles(len(rows))
    kinds = [kind for kind in base.row_kinds(c) if np.any(np.isfinite(after[kind.mask]))]
    reach = float(np.nanmax(after[others], initial=1e-3))
    unseen = _left_out(c, c.cross_validation)
    if len(rows) > _MOST_LINES:
        _curve(below, rows, np.where(others, after, np.nan), base.AFTER)
        kinds = [kind for kind in kinds if kind.word == "outlier"]
    elif unseen is not None:
        dashes = np.where(others, what.scale * what.size(unseen, c.used), np.nan)
        reach = float(np.nanmax(dashes, initial=reach))
        look = {"ls": "none", "marker": "_", "ms": 7, "mew": 1.1, "color": labels.SOFT}
        below.plot(rows, dashes, **look)
        handles.append(base.line("left out of the fit", **look))
    # Outliers far above the others stand at the edge: above they are drawn to scale.
    after = np.where(others, after, np.minimum(after, 1.25 * reach))
    for kind in kinds:
        at = kind.mask & np.isfinite(after)
        if len(rows) <= _MOST_MARKERS:
            below.vlines(rows[at], 0.0, after[at], color=kind.colour, lw=0.9, alpha=0.6)
        below.plot(rows[at], after[at], **kind.style())
        handles.append(kind.handle())
    base.number_points(below, m.rows, np.stack([rows, after], axis=1), ~others)
    for ax, title in ((top, "Before and after"), (below, "After")):
        ax.set_title(title)
        ax.set_ylabel(f"size of the error [{what.unit}]")
        ax.xaxis.set_major_locator(base.few_ticks(9, whole=True))
    below.set_xlabel("row")
    top.set_ylim(bottom=0.0)
    below.set_ylim(0.0, 1.32 * reach)
    base.legend_above(drawn, handles, 3)
    return drawn


by_row = base.figure(
    "errors-by-pose",
    "errors",
    "Error by row",
    "Size of the error of the position, or of the length, " + _BY_ROW.replace("UNIT", "mm"),
    base.has_lengths,
)(lambda c: _by_row(c, _LENGTH))
turned_by_row = base.figure(
    "orientation-errors-by-pose",
    "errors",
    "Orientation error by row",
    "Angle between measured and predicted orientation " + _BY_ROW.replace("UNIT", "deg"),
    base.has_angles,
)(lambda c: _by_row(c, _ANGLE))


def _by_axis(c: Calibration, what: _What) -> Figure:
    """How errors along or about each axis spread: sets of rows before and after; after alone below, magnified."""
    m, flagged, columns = c.measurements, labels.flagged_rows(c), what.columns
    word, whole = "about" if what is _ANGLE else "along", np.all(c.used[:, columns], axis=1)
    before, after = (
        what.scale * r[:, columns] for r in (c.residual_nominal, c.residual_calibrated)
    )
    sets = [("estimation", m.estimation & whole), ("validation", m.validation & whole)]
    sets = [(name, mask) for name, mask in sets if np.any(mask)]
    drawn = base.new_figure(4.6)
    panels = drawn.subplots(2, len(sets), squeeze=False, sharey="row", sharex=True)
    for (upper, lower), (name, mask) in zip(panels.T, sets, strict=True):
        _boxes(upper, before[mask], -0.19, base.BEFORE)
        _boxes(upper, after[mask], 0.19, base.AFTER)
        _boxes(lower, after[mask & ~flagged], 0.0, base.AFTER)
        upper.set_title(base.rows_text(mask, name))
        lower.set_title("After, " + ("without outliers" if np.any(flagged[mask]) else "alone"))
        for ax in (upper, lower):
            ax.axhline(0.0, color=labels.INK, lw=0.7, zorder=1.5)
            ax.grid(visible=False, axis="x")
        lower.set_xticks(range(3), [f"about {axis}" if what is _ANGLE else axis for axis in "xyz"])
    for ax in panels[:, 0]:
        ax.set_ylabel(f"error {word} the axis [{what.unit}]")
    base.legend_above(drawn, _area_handles())
    return drawn


by_axis = base.figure(
    "errors-by-axis",
    "errors",
    "Position error by axis",
    "Errors along " + _BY_AXIS.replace("UNIT", "mm"),
    base.has_axes,
)(lambda c: _by_axis(c, _LENGTH))
turned_by_axis = base.figure(
    "orientation-errors-by-axis",
    "errors",
    "Orientation error by axis",
    "Errors about " + _BY_AXIS.replace("UNIT", "deg"),
    base.has_angles,
)(lambda c: _by_axis(c, _ANGLE))


@base.figure(
    "histograms",
    "errors",
    "How often which error occurs",
    "Left: size of the error of all rows, {rows}, before and after, on a logarithmic scale. Right: each number that "
    "was measured in the estimation rows, less what the calibrated robot predicts, over its estimated noise; if the "
    "model is complete, it follows the normal distribution.",
    base.always,
)
def histograms(c: Calibration) -> Figure:
    """How often which size of error occurs, and whether the residuals look like noise."""
    drawn = base.new_figure(2.9)
    left, right = drawn.subplots(1, 2)
    what = _LENGTH if base.has_lengths(c) else _ANGLE
    before, after = (
        what.scale * what.size(r, c.used) for r in (c.residual_nominal, c.residual_calibrated)
    )
    before, after = before[np.isfinite(before)], after[np.isfinite(after)]
    # Even in the logarithm; what is far below the median is put into the first bin.
    top = max(float(np.max([before, after])), 1e-6)
    low = min(max(0.05 * float(np.median(after)), 1e-6 * top), 0.5 * top)
    bins = np.geomspace(low, 1.001 * top, int(np.clip(2.0 * np.sqrt(len(after)) + 5, 9, 61)))
    look = {"histtype": "stepfilled", "lw": 1.2}
    for who, values in ((base.BEFORE, before), (base.AFTER, after)):
        left.hist(np.maximum(values, low), list(bins), color=who.colour, **look, **who.area)
    base.log_axis(left, "x")
    left.set_xlabel(f"size of the error [{what.unit}]")
    left.set_ylabel("rows")
    left.set_title(f"All {len(after):,} rows")
    values = scaled_residuals(c)
    edges = np.linspace(-_REACH, _REACH, int(np.clip(np.sqrt(len(values)) * 1.5, 8, 50)) + 1)
    right.hist(values, list(edges), color=base.AFTER.colour, **look, **base.AFTER.area)
    t = np.linspace(-_REACH, _REACH, 201)
    normal = np.exp(-0.5 * t**2) / np.sqrt(2.0 * np.pi) * len(values) * (edges[1] - edges[0])
    right.plot(t, normal, color=labels.INK, lw=1.2, ls="--", label="normal")
    right.set_xlabel("residual / its noise")
    right.set_ylabel("measured numbers")
    right.set_title(f"{len(values):,} numbers of estimation rows")
    outside = int(np.sum(np.abs(values) > _REACH))
    if outside:
        right.plot([], [], ls="none", label=f"{outside:,} beyond ±{_REACH:g}")
    right.legend(loc="upper right", handlelength=1.6)
    for ax in (left, right):
        ax.yaxis.set_major_locator(base.few_ticks(6, whole=True))
    base.legend_above(drawn, _area_handles())
    return drawn


def scaled_residuals(c: Calibration) -> Array:
    """Each measured number of the estimation rows minus predicted, over its estimated noise, shape (K,)."""
    problem = c.fitted.estimate.problem
    residual = c.residual_calibrated[c.measurements.estimation]
    return np.asarray((residual / problem.scales)[problem.rows.used])


def _curve(ax: Axes, rows: NDArray[np.int_], values: Array, who: base.Who) -> None:
    """A curve over rows; with markers where they are few, as pixels where they are many."""
    # A line leads over rows that hold nothing, such as the second ones of pairs: gaps would leave nothing of it.
    rows, values = rows[np.isfinite(values)], values[np.isfinite(values)]
    few = len(values) <= _MOST_MARKERS
    look: dict[str, Any] = {"color": who.colour, "ls": who.line if few else "-", "zorder": 3}
    look |= {"marker": who.marker if few else "", "ms": 4.2 if len(values) <= 40 else 3.0}
    many = len(values) > _MOST_LINES
    ax.plot(rows, values, lw=1.3 if few else 0.6, mec="white", mew=0.4, rasterized=many, **look)


def _curve_handles(count: int) -> list[Any]:
    """The legend of before and after over so many rows."""
    few = count <= _MOST_MARKERS
    look: dict[str, Any] = {"mec": "white", "mew": 0.4, "ms": 4.2}
    return [
        base.line(
            who.word,
            **look | {"color": who.colour, "ls": who.line if few else "-"},
            marker=who.marker if few else "",
        )
        for who in (base.BEFORE, base.AFTER)
    ]


def _boxes(ax: Axes, values: Array, shift: float, who: base.Who) -> None:
    """A box for each of three columns."""
    ax.boxplot(
        list(values.T),
        positions=[k + shift for k in range(3)],
        widths=0.3,
        whis=(5, 95),
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops={"facecolor": who.colour, "lw": 1.0, **who.area},
        medianprops={"color": labels.INK, "lw": 1.4},
        whiskerprops={"color": who.colour, "lw": 1.4},
        capprops={"color": who.colour, "lw": 1.4},
    )


def _area_handles() -> list[Any]:
    """The legend of boxes and bars."""
    return [
        base.area(who.word, facecolor=who.colour, **who.area) for who in (base.BEFORE, base.AFTER)
    ]
