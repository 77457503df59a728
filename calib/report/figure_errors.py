"""Errors before and after: over the rows, by axis, how often which size occurs, and along each joint's motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import calib.report.figure_base as base
from calib.numerics.errors import CrossValidation
from calib.result.calibration import CalibrationValues
from calib.units import Array, Mask

#: More rows than this get no markers, and more than that are pixels in SVG and PDF.
_MOST_MARKERS, _MOST_LINES = 80, 1000

#: Residuals are drawn up to so many standard deviations.
_REACH = 5.0

#: A step that derivatives are taken with [rad] or [m]; a joint that moves the target less has no direction [m/rad].
_STEP, _NO_LEVER = 1e-6, 2e-3

#: The mean over runs of rows is drawn from so many rows on, over so many runs at most.
_FEWEST_ROWS, _MOST_RUNS = 24, 12


class What(NamedTuple):
    """Lengths, or orientations: their columns of the residuals, size, factor and unit, and what axes are to them."""

    columns: slice
    size: Callable[[Array, Mask], Array]
    scale: float
    unit: str
    word: str

    def both(self, c: CalibrationValues) -> list[Array]:
        """The size of each row's error, nominal and calibrated, in the unit."""
        residuals = c.residual_nominal, c.residual_calibrated
        return [self.scale * self.size(residual, c.used) for residual in residuals]


LENGTH = What(slice(0, 3), base.lengths_of, 1e3, "mm", "along")
ANGLE = What(slice(3, 6), base.angles_of, float(np.degrees(1.0)), "deg", "about")


def has_axes(c: CalibrationValues, rows: Mask | slice = slice(None)) -> bool:
    """Whether any row has errors along x, y and z."""
    used = c.used[rows]
    return used.shape[1] >= 3 and bool(np.any(np.all(used[:, :3], axis=1)))


def curve_rows(c: CalibrationValues) -> tuple[str, Mask, Array, Array]:
    """The rows of the error curves: what they are called, which they are, and both robots' residuals, (N, D).

    Those for validation if there are any, else the estimation rows as fits predict them that had not seen them, else
    the estimation rows.
    """
    m, measured = c.measurements, np.any(c.used[:, :3], axis=1)
    if np.any(m.validation & measured):
        return "validation", m.validation & measured, c.residual_nominal, c.residual_calibrated
    before, after = c.nominal_cross_validation, c.cross_validation
    if before is not None and after is not None:
        return "held-out", m.estimation & measured, _held_out(c, before), _held_out(c, after)
    return "estimation", m.estimation & measured, c.residual_nominal, c.residual_calibrated


def _held_out(c: CalibrationValues, found: CrossValidation) -> Array:
    """Measured minus predicted by fits that had not seen the row, shape (N, D), NaN for validation rows."""
    residual = np.full(c.residual_calibrated.shape, np.nan)
    residual[c.measurements.estimation] = found.residual
    return residual


def curves(c: CalibrationValues) -> Figure:
    """As the paper's figure 8. Lengths have one panel: their errors with their signs."""
    word, mask, before, after = curve_rows(c)
    axes_too, rows = has_axes(c, mask), np.array(c.measurements.rows)[mask]
    figure = base.new_figure(4.9 if axes_too else 2.8)
    panels = figure.subplots(*((2, 2) if axes_too else (1, 1)), sharex=True, squeeze=False)
    titles = ["Δx", "Δy", "Δz", "Size of the error"] if axes_too else ["Error of the length"]
    for who, residual in ((base.BEFORE, before), (base.AFTER, after)):
        values = np.where(c.used, residual, np.nan)[mask][:, : 3 if axes_too else 1]
        if axes_too:
            values = np.c_[values, base.lengths_of(residual, c.used)[mask]]
            values[np.isnan(values).any(axis=1), :3] = np.nan
        for ax, one in zip(panels.ravel(), 1e3 * values.T, strict=True):
            _curve(ax, rows, one, who)
    for ax, title in zip(panels.ravel(), titles, strict=True):
        ax.axhline(0.0, color=base.INK, lw=0.7, zorder=1.5)
        ax.xaxis.set_major_locator(base.few_ticks(6 if axes_too else 10, whole=True))
        ax.set(title=title, ylabel="error [mm]")
    if axes_too:  # one scale for the three, so that they can be compared
        reach = float(np.max(np.abs([ax.get_ylim() for ax in panels.ravel()[:3]])))
        for ax in panels.ravel()[:3]:
            ax.set_ylim(-reach, reach)
        panels[1, 1].set_ylim(bottom=0.0)
    for ax in panels[-1]:
        ax.set_xlabel(f"{word} row")
    base.legend_above(figure)
    return figure


def by_row(c: CalibrationValues, what: What = LENGTH) -> Figure:
    """The size of each row's error: before and after above; after alone below."""
    rows, others = np.array(c.measurements.rows), ~base.flagged_rows(c)
    before, after = what.both(c)
    figure = base.new_figure(4.6)
    top, below = figure.subplots(2, 1, sharex=True)
    _curve(top, rows, before, base.BEFORE)
    _curve(top, rows, after, base.AFTER)
    kinds = [kind for kind in base.row_kinds(c) if np.any(np.isfinite(after[kind.mask]))]
    reach = float(np.nanmax(after[others], initial=1e-3))
    if len(rows) > _MOST_LINES:
        _curve(below, rows, np.where(others, after, np.nan), base.AFTER)
        kinds = [kind for kind in kinds if kind.word == "outlier"]
    elif c.cross_validation is not None:
        unseen = what.size(_held_out(c, c.cross_validation), c.used)
        dashes = np.where(others, what.scale * unseen, np.nan)
        reach = float(np.nanmax(dashes, initial=reach))
        look = {"ls": "none", "marker": "_", "ms": 7, "mew": 1.1, "color": base.SOFT}
        below.plot(rows, dashes, label="left out of the fit", **look)
    # Outliers far above the others stand at the edge: above they are drawn to scale.
    after = np.where(others, after, np.minimum(after, 1.25 * reach))
    for kind in kinds:
        at = kind.mask & np.isfinite(after)
        if len(rows) <= _MOST_MARKERS:
            below.vlines(rows[at], 0.0, after[at], color=kind.colour, lw=0.9, alpha=0.6)
        below.plot(rows[at], after[at], **kind.style())
    base.number_points(below, c.measurements.rows, np.stack([rows, after], axis=1), ~others)
    for ax, title in ((top, "Before and after"), (below, "After")):
        ax.set_title(title)
        ax.set_ylabel(f"size of the error [{what.unit}]")
        ax.xaxis.set_major_locator(base.few_ticks(9, whole=True))
    below.set_xlabel("row")
    top.set_ylim(bottom=0.0)
    below.set_ylim(0.0, 1.32 * reach)
    base.legend_above(figure, 3)
    return figure


def by_axis(c: CalibrationValues, what: What = LENGTH) -> Figure:
    """How errors along or about each axis spread: sets of rows before and after; after alone below, magnified."""
    m, flagged, columns = c.measurements, base.flagged_rows(c), what.columns
    whole = np.all(c.used[:, columns], axis=1)
    before, after = (
        what.scale * r[:, columns] for r in (c.residual_nominal, c.residual_calibrated)
    )
    sets = [("estimation", m.estimation & whole), ("validation", m.validation & whole)]
    sets = [(name, mask) for name, mask in sets if np.any(mask)]
    figure = base.new_figure(4.6)
    panels = figure.subplots(2, len(sets), squeeze=False, sharey="row", sharex=True)
    for (upper, lower), (name, mask) in zip(panels.T, sets, strict=True):
        _boxes(upper, before[mask], -0.19, base.BEFORE)
        _boxes(upper, after[mask], 0.19, base.AFTER)
        _boxes(lower, after[mask & ~flagged], 0.0, base.AFTER)
        upper.set_title(base.rows_text(mask, name))
        lower.set_title("After, " + ("without outliers" if np.any(flagged[mask]) else "alone"))
        for ax in (upper, lower):
            ax.axhline(0.0, color=base.INK, lw=0.7, zorder=1.5)
            ax.grid(visible=False, axis="x")
        lower.set_xticks(range(3), [f"about {axis}" if what is ANGLE else axis for axis in "xyz"])
    for ax in panels[:, 0]:
        ax.set_ylabel(f"error {what.word} the axis [{what.unit}]")
    base.legend_above(figure)
    return figure


def histograms(c: CalibrationValues) -> Figure:
    """How often which size of error occurs, and whether the residuals look like noise."""
    figure = base.new_figure(2.9)
    left, right = figure.subplots(1, 2)
    what = LENGTH if np.any(c.used[:, :3]) else ANGLE
    before, after = (prior_std[np.isfinite(prior_std)] for prior_std in what.both(c))
    # Even in the logarithm; what is far below the median is put into the first bin.
    top = max(float(np.max([before, after])), 1e-6)
    low = min(max(0.05 * float(np.median(after)), 1e-6 * top), 0.5 * top)
    bins = np.geomspace(low, 1.001 * top, int(np.clip(2.0 * np.sqrt(len(after)) + 5, 9, 61)))
    for who, values in ((base.BEFORE, before), (base.AFTER, after)):
        shown = np.maximum(values, low)
        left.hist(shown, list(bins), histtype="stepfilled", label=who.word, **who.area)
    base.log_axis(left, "x")
    left.set(xlabel=f"size of the error [{what.unit}]", ylabel="rows")
    left.set_title(f"All {len(after):,} rows")
    values = scaled_residuals(c)
    edges = np.linspace(-_REACH, _REACH, int(np.clip(np.sqrt(len(values)) * 1.5, 8, 50)) + 1)
    right.hist(values, list(edges), histtype="stepfilled", **base.AFTER.area)
    t = np.linspace(-_REACH, _REACH, 201)
    normal = np.exp(-0.5 * t**2) / np.sqrt(2.0 * np.pi) * len(values) * (edges[1] - edges[0])
    right.plot(t, normal, color=base.INK, lw=1.2, ls="--", label="normal")
    right.set(xlabel="residual / its noise", ylabel="measured numbers")
    right.set_title(f"{len(values):,} numbers of estimation rows")
    outside = int(np.sum(np.abs(values) > _REACH))
    if outside:
        right.plot([], [], ls="none", label=f"{outside:,} beyond ±{_REACH:g}")
    for ax in (left, right):
        ax.yaxis.set_major_locator(base.few_ticks(6, whole=True))
    base.legend_above(figure)
    return figure


def scaled_residuals(c: CalibrationValues) -> Array:
    """Each measured number of the estimation rows minus predicted, over its estimated noise, shape (K,)."""
    problem = c.fitted.estimate.problem
    residual = c.residual_calibrated[c.measurements.estimation]
    return np.asarray((residual / problem.scales)[problem.rows.used])


def tells_of_joints(c: CalibrationValues) -> Mask:
    """The rows whose residual lies along joints' motions, shape (N,); lengths between two rows belong to both."""
    return np.asarray(c.used[:, 0] & ~c.measurements.of_kind("pair"))


def joints(c: CalibrationValues) -> Figure:
    """The part r.g / |g| of each residual r, g the derivative of the predicted position by the joint's value."""
    chosen, flagged = tells_of_joints(c), base.flagged_rows(c)
    parts = 1e3 * along_joints(c)
    parts[~chosen] = np.nan
    q = c.measurements.joints_for(c.nominal.joint_names)
    fitted = c.measurements.estimation & chosen & ~flagged
    names = base.short_names(c.nominal.joint_names)
    columns = 2 if len(names) in (2, 4) else min(len(names), 3)
    lines = -(-len(names) // columns)
    figure = base.new_figure(1.65 * lines + 0.6)
    panels = figure.subplots(lines, columns, squeeze=False, sharey=True)
    reach = max(1.15 * float(np.nanmax(np.abs(parts[~flagged]), initial=0.0)), 1e-3)
    for ax in panels.ravel()[len(names) :]:
        ax.remove()
    for j, (ax, joint) in enumerate(zip(panels.ravel(), c.nominal.inputs, strict=False)):
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (np.degrees(1.0), "deg")
        ax.axhline(0.0, color=base.INK, lw=0.7, zorder=1.5)
        for kind in base.row_kinds(c):
            if np.any(kind.mask & chosen):
                at = np.clip(parts[kind.mask, j], -reach, reach)
                look = {"rasterized": len(q) > base.MOST_SHAPES, "zorder": 2}
                ax.plot(scale * q[kind.mask, j], at, **look, **kind.style(0.8))
        if np.count_nonzero(np.isfinite(parts[fitted, j])) >= _FEWEST_ROWS:
            _mean(ax, scale * q[fitted, j], parts[fitted, j])
        ax.set_ylim(-1.08 * reach, 1.08 * reach)
        ax.set_title(names[j], size=8.5)
        ax.set_xlabel(f"joint value [{unit}]")
        ax.xaxis.set_major_locator(base.few_ticks(4))
    for ax in panels[:, 0]:
        ax.set_ylabel("residual [mm]")
    base.legend_above(figure)
    return figure


def along_joints(c: CalibrationValues) -> Array:
    """The part of each row's residual along each joint's motion of the target, shape (N, m), [m]; NaN without one."""
    m = c.measurements
    q = m.joints_for(c.nominal.joint_names)
    T_frame_base, T_tip_target = base.placed(c.setup, m)

    def places(q: Array) -> Array:
        """Predicted positions in the measurement frame."""
        return np.asarray((T_frame_base @ c.robot.poses(q) @ T_tip_target)[:, :3, 3])

    at = places(q)
    # Of a distance the part along the beam counts, of a plane that along its normal.
    beam = at / np.maximum(np.linalg.norm(at, axis=1, keepdims=True), 1e-12)
    distance, plane = m.of_kind("distance"), m.of_kind("plane")
    residual = np.where(c.used, c.residual_calibrated, 0.0)[:, :3]
    result = np.full(q.shape, np.nan)
    for j, step in enumerate(_STEP * np.eye(q.shape[1])):
        move = (places(q + step) - places(q - step)) / (2.0 * _STEP)
        move[distance, 0] = np.sum(beam[distance] * move[distance], axis=1)
        move[plane, 0] = move[plane, 2]
        move[distance | plane, 1:] = 0.0
        move = move[:, : residual.shape[1]]
        length = np.linalg.norm(move, axis=1)
        part = np.sum(residual * move, axis=1) / np.maximum(length, 1e-12)
        result[:, j] = np.where(length > _NO_LEVER, part, np.nan)
    return result


def _mean(ax: Axes, at: Array, parts: Array) -> None:
    """The mean over runs of rows that are neighbours in the joint's value, twice its standard error about it."""
    order = np.argsort(at, kind="stable")
    order = order[np.isfinite(parts[order])]
    count = min(len(order) // 8, _MOST_RUNS)
    runs = [(at[run], parts[run]) for run in np.array_split(order, count)]
    x, mean = np.array([(np.mean(q), np.mean(p)) for q, p in runs]).T
    error = np.array([np.std(p, ddof=1) / np.sqrt(len(p)) for _, p in runs])
    look: dict[str, Any] = {"color": base.CALIBRATED, "zorder": 3}
    label = "mean of the estimation rows ± 2 standard errors"
    ax.fill_between(x, mean - 2 * error, mean + 2 * error, alpha=0.45, lw=0, label=label, **look)
    ax.plot(x, mean, lw=1.3, **look)


def _curve(ax: Axes, rows: NDArray[np.int_], values: Array, who: base.Who) -> None:
    """A curve over rows; with markers where they are few, as pixels where they are many."""
    # A line leads over rows that hold nothing, such as the second ones of pairs: gaps would leave nothing of it.
    rows, values = rows[np.isfinite(values)], values[np.isfinite(values)]
    few = len(values) <= _MOST_MARKERS
    look: dict[str, Any] = {"color": who.colour, "label": who.word, "zorder": 3}
    look |= {"ls": who.line, "marker": who.marker, "ms": 3.6} if few else {}
    many = len(values) > _MOST_LINES
    ax.plot(rows, values, lw=1.3 if few else 0.6, mec="white", mew=0.4, rasterized=many, **look)


def _boxes(ax: Axes, values: Array, shift: float, who: base.Who) -> None:
    """A box for each of three columns."""
    line = {"color": who.colour, "lw": 1.4}
    found = ax.boxplot(
        list(values.T),
        positions=[k + shift for k in range(3)],
        widths=0.3,
        whis=(5, 95),
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops=who.area,
        medianprops={"color": base.INK, "lw": 1.4},
        whiskerprops=line,
        capprops=line,
    )
    found["boxes"][0].set_label(who.word)
