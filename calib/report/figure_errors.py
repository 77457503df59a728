"""Errors before and after: over the rows, by axis, and how often which size occurs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.estimate.statistics import CrossValidation
from calib.report.figure_base import (
    AFTER,
    BEFORE,
    Who,
    area,
    few_ticks,
    has_axes,
    legend_above,
    line,
    log_axis,
    new_figure,
    number_points,
    row_kinds,
    rows_text,
)
from calib.report.label_rows import INK, SOFT, VALIDATION, angles_of, flagged_rows, lengths_of
from calib.result.calibration import Calibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: More rows than this get no markers, and more than that are summed up in so many bands.
_MOST_MARKERS, MOST_LINES, _RUNS = 80, 1000, 50

#: More stretches of validation rows than this are not shaded.
_MOST_STRETCHES = 40

#: Fewer rows than this have no box, and more than that no single dots.
_FEWEST_IN_BOX, _MOST_DOTS = 5, 120

#: What is left over is drawn up to so many standard deviations.
_REACH = 5.0

#: Columns of the residuals, their size, factor and unit: of positions and lengths, and of orientations.
_LENGTH = slice(0, 3), lengths_of, 1e3, "mm"
_ANGLE = slice(3, 6), angles_of, float(np.degrees(1.0)), "deg"


def curve_rows(c: Calibration) -> tuple[str, Mask, Array, Array]:
    """The rows of the error curves: what they are called, which they are, and what both robots leave over there.

    Those for validation if there are any, else the estimation rows as fits predict them that had not seen them, the
    nominal robot with target and frame fitted to the other rows likewise, else the estimation rows.

    Returns:
        The word, shape (N,), and twice shape (N, D), measured minus predicted, before and after [m], [rad].
    """
    m = c.measurements
    measured = np.any(c.used[:, :3], axis=1)
    if np.any(m.validation & measured):
        return "validation", m.validation & measured, c.residual_nominal, c.residual_calibrated
    before, after = _left_out(c, c.nominal_cross_validation), _left_out(c, c.cross_validation)
    if before is not None and after is not None:
        return "left-out", m.estimation & measured, before, after
    return "estimation", m.estimation & measured, c.residual_nominal, c.residual_calibrated


def curves(c: Calibration) -> Figure:
    """Errors along x, y and z and their size over the rows, before and after; as the paper's figure 8.

    Lengths have one panel: their errors with their signs. Beside rows with three axes they have their size alone.
    """
    word, mask, before, after = curve_rows(c)
    rows = np.flatnonzero(mask)
    axes_too = has_axes(c, mask)
    whole = np.all(c.used[rows, :3], axis=1) if axes_too else c.used[rows, 0]
    figure = new_figure(4.9 if axes_too else 2.8)
    panels = figure.subplots(*((2, 2) if axes_too else (1, 1)), sharex=True, squeeze=False)
    *signed, last = panels.ravel()
    both = ((BEFORE, before), (AFTER, after))
    for k, ax in enumerate(signed or [last]):
        for who, residual in both:
            _curve(ax, np.where(whole, 1e3 * residual[rows, k], np.nan), who)
        ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
        ax.set_title(f"Δ{'xyz'[k]}" if axes_too else "Error of the length")
    if axes_too:
        for who, residual in both:
            _curve(last, 1e3 * lengths_of(residual, c.used)[rows], who)
        last.set_title("Size of the error")
        last.set_ylim(bottom=0.0)
        # One scale for the three, so that they can be compared.
        reach = max(float(np.max(np.abs(ax.get_ylim()))) for ax in signed)
        for ax in signed:
            ax.set_ylim(-reach, reach)
    numbers = [c.measurements.rows[k] for k in rows]
    for ax in panels.ravel():
        _row_axis(ax, numbers, 6 if axes_too else 10)
        ax.set_ylabel("error [mm]")
    for ax in panels[-1]:
        ax.set_xlabel(f"{word} row")
    legend_above(figure, _curve_handles(len(rows)))
    return figure


def by_row(c: Calibration, *, turned: bool = False) -> Figure:
    """The size of each row's error of length, or of orientation: before and after above; after alone below."""
    _, size, scale, unit = _ANGLE if turned else _LENGTH
    before, after = (scale * size(r, c.used) for r in (c.residual_nominal, c.residual_calibrated))
    count, many = len(before), len(before) > MOST_LINES
    figure = new_figure(4.6)
    top, below = figure.subplots(2, 1, sharex=True)
    for who, values in ((BEFORE, before), (AFTER, after)):
        _curve(top, values, who, largest=True)
    top.set_title("Before and after")
    handles = _curve_handles(count, largest=True)
    kinds = [kind for kind in row_kinds(c) if np.any(np.isfinite(after[kind.mask]))]
    others = ~flagged_rows(c)
    reach = float(np.nanmax(after[others], initial=1e-3))
    unseen = _left_out(c, c.cross_validation)
    if many:
        _curve(below, np.where(others, after, np.nan), AFTER, largest=True)
        kinds = [kind for kind in kinds if kind.word == "outlier"]
    elif unseen is not None:
        dashes = np.where(others, scale * size(unseen, c.used), np.nan)
        reach = float(np.nanmax(dashes, initial=reach))
        look = {"ls": "none", "marker": "_", "ms": 7 if count <= _MOST_MARKERS else 4, "mew": 1.1}
        below.plot(dashes, color=SOFT, **look)
        handles.append(line("left out of the fit", color=SOFT, **look))
    # Outliers far above the others stand at the edge: above they are drawn to scale.
    after = np.where(others, after, np.minimum(after, 1.25 * reach))
    for kind in kinds:
        at = np.flatnonzero(kind.mask & np.isfinite(after))
        if count <= _MOST_MARKERS:
            below.vlines(at, 0.0, after[at], color=kind.colour, lw=0.9, alpha=0.6)
        below.plot(at, after[at], **kind.style(count))
        handles.append(kind.handle())
    places = np.stack([np.arange(count), after], axis=1)
    number_points(below, c.measurements.rows, places, ~others)
    below.set_title("After")
    below.set_xlabel("row")
    for ax in (top, below):
        ax.set_ylabel(f"size of the error [{unit}]")
        _row_axis(ax, c.measurements.rows)
        _shade_validation(ax, c.measurements.validation)
    top.set_ylim(bottom=0.0)
    below.set_ylim(0.0, 1.32 * reach)
    legend_above(figure, handles, 3)
    return figure


def by_axis(c: Calibration, *, turned: bool = False) -> Figure:
    """How errors along each axis, or about it, spread: sets of rows before and after; after alone below, magnified."""
    columns, _, scale, unit = _ANGLE if turned else _LENGTH
    word = "about" if turned else "along"
    m, flagged = c.measurements, flagged_rows(c)
    sets = [
        (what, mask)
        for what, mask in (("estimation", m.estimation), ("validation", m.validation))
        if np.any(c.used[mask][:, columns])
    ]
    reach = 1e-3  # of the lower panels: rounding is no error
    figure = new_figure(4.6)
    panels = figure.subplots(2, len(sets), squeeze=False, sharey="row", sharex=True)
    for (upper, lower), (what, mask) in zip(panels.T, sets, strict=True):
        whole = mask & np.all(c.used[:, columns], axis=1)
        before, after = (scale * r[:, columns] for r in (c.residual_nominal, c.residual_calibrated))
        alone = after[whole & ~flagged]
        _boxes(upper, before[whole], -0.19, BEFORE)
        _boxes(upper, after[whole], 0.19, AFTER)
        _boxes(lower, alone, 0.0, AFTER)
        reach = max(reach, 1.1 * float(np.abs(alone).max(initial=0.0)))
        upper.set_title(rows_text(whole, what))
        lower.set_title("After, " + ("without outliers" if np.any(flagged[mask]) else "alone"))
        for ax in (upper, lower):
            ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
            ax.set_xlim(-0.6, 2.6)
            ax.grid(visible=False, axis="x")
        lower.set_xticks(range(3), [f"about {axis}" if turned else axis for axis in "xyz"])
    panels[1, 0].set_ylim(-reach, reach)
    for ax in panels[:, 0]:
        ax.set_ylabel(f"error {word} the axis [{unit}]")
    legend_above(figure, _area_handles())
    return figure


def histograms(c: Calibration) -> Figure:
    """How often which size of error occurs, and whether what is left over looks like noise."""
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)
    _, size, scale, unit = _LENGTH if np.any(c.used[:, :3]) else _ANGLE
    before, after = (scale * size(r, c.used) for r in (c.residual_nominal, c.residual_calibrated))
    before, after = before[np.isfinite(before)], after[np.isfinite(after)]
    bins = _bins(before, after)
    for who, values in ((BEFORE, before), (AFTER, after)):
        values = np.maximum(values, bins[0])
        left.hist(values, list(bins), color=who.colour, histtype="stepfilled", lw=1.2, **_area(who))
    log_axis(left, "x")
    left.set_xlabel(f"size of the error [{unit}]")
    left.set_ylabel("rows")
    left.set_title(f"All {len(after):,} rows" if len(after) > 1 else "The one row")
    _noise(right, c)
    for ax in (left, right):
        ax.yaxis.set_major_locator(few_ticks(6, whole=True))
    legend_above(figure, _area_handles())
    return figure


def _left_out(c: Calibration, found: CrossValidation | None) -> Array | None:
    """Measured minus predicted by fits that had not seen the row, shape (N, D), NaN for validation rows; or None."""
    if found is None:
        return None
    residual = np.full(c.residual_calibrated.shape, np.nan)
    residual[c.measurements.estimation] = found.residual
    return residual


def _curve(ax: Axes, values: Array, who: Who, *, largest: bool = False) -> None:
    """A curve over rows; with markers where they are few, a band where they are many."""
    look: dict[str, Any] = {"color": who.colour, "ls": who.line, "zorder": 3}
    if len(values) > MOST_LINES:
        every = np.array_split(np.arange(len(values)), _RUNS)
        runs = [run for run in (part[np.isfinite(values[part])] for part in every) if len(run)]
        x = [float(np.mean(run)) for run in runs]
        low, middle, high = np.transpose([np.quantile(values[r], [0.05, 0.5, 0.95]) for r in runs])
        ax.fill_between(x, low, high, color=who.colour, alpha=0.35, lw=0, zorder=2)
        ax.plot(x, middle, lw=1.3, **look)
        if largest:
            ax.plot(x, [values[r].max() for r in runs], color=who.colour, lw=0.6, alpha=0.8)
        return
    few = len(values) <= _MOST_MARKERS
    # A line leads over rows that hold nothing, such as the second ones of pairs: gaps would leave nothing of it.
    at = np.flatnonzero(np.isfinite(values))
    look |= {"marker": who.marker if few else "", "ms": 4.2 if len(values) <= 40 else 3.0}
    ax.plot(at, values[at], lw=1.3 if few else 0.8, mec="white", mew=0.4, **look)


def _curve_handles(count: int, *, largest: bool = False) -> list[Any]:
    """The legend of before and after over so many rows."""
    few, many = count <= _MOST_MARKERS, count > MOST_LINES
    handles = []
    for who in (BEFORE, AFTER):
        word, look = f"{who.word}, median" if many else who.word, {"mec": "white", "mew": 0.4}
        marker = who.marker if few else ""
        handles.append(line(word, color=who.colour, ls=who.line, marker=marker, ms=4.2, **look))
    if many:
        words = f"5 to 95 % of {round(count / _RUNS):,} rows each"
        handles.append(area(words, color=SOFT, alpha=0.35, lw=0))
        handles += [line("largest of them", color=SOFT, lw=0.6)] * largest
    return handles


def _row_axis(ax: Axes, numbers: Sequence[int], ticks: int = 9) -> None:
    """The x axis as places in the table, labelled with the rows' numbers, round ones where they run on."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    last = len(numbers) - 1
    low = numbers[0] if numbers[last] - numbers[0] == last else 0
    found = few_ticks(ticks, whole=True).tick_values(low, low + last)
    places = [round(value) - low for value in found if low <= round(value) <= low + last]
    ax.xaxis.set_major_locator(FixedLocator(places))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: str(numbers[round(value)])))
    room = max(0.5, 0.01 * len(numbers))
    ax.set_xlim(-room, last + room)


def _shade_validation(ax: Axes, validation: Mask) -> None:
    """The stretches of validation rows on a ground of their own, unless they are many."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], validation, [False]]).astype(int)))
    if len(edges) <= 2 * _MOST_STRETCHES:
        for start, end in edges.reshape(-1, 2):
            ax.axvspan(start - 0.5, end - 0.5, color=VALIDATION, alpha=0.08, lw=0, zorder=0)


def _boxes(ax: Axes, values: Array, shift: float, who: Who) -> None:
    """A box for each of three columns, with the rows' values where they are few, else the least and the largest."""
    count = len(values)
    if count >= _FEWEST_IN_BOX:
        drawn = ax.boxplot(
            list(values.T),
            positions=[k + shift for k in range(3)],
            widths=0.3,
            whis=(5, 95),
            showfliers=False,
            patch_artist=True,
            manage_ticks=False,
        )
        for box in drawn["boxes"]:
            box.set(facecolor=who.colour, lw=1.0, **_area(who))
        for part in ("whiskers", "caps", "medians"):
            for one in drawn[part]:
                one.set(color=INK if part == "medians" else who.colour, lw=1.4)
    if not count:
        return
    shown = values if count <= _MOST_DOTS else np.array([values.min(axis=0), values.max(axis=0)])
    aside = 0.09 * np.sin(2.4 * np.arange(len(shown))) * (count <= _MOST_DOTS)
    look: dict[str, Any] = {"marker": who.marker, "ms": 2.8, "mfc": who.colour}
    for k in range(3):
        at = k + shift + aside
        ax.plot(at, shown[:, k], ls="none", mec="white", mew=0.3, zorder=3, **look)


def _area(who: Who) -> dict[str, Any]:
    """How a robot's boxes and bars are drawn."""
    return {"alpha": 0.5, "edgecolor": who.colour, "hatch": who.hatch}


def _area_handles() -> list[Any]:
    """The legend of boxes and bars."""
    return [area(who.word, facecolor=who.colour, **_area(who)) for who in (BEFORE, AFTER)]


def _bins(before: Array, after: Array) -> Array:
    """Edges of the bins of both, even in their logarithm; what is far below the median is put into the first."""
    every = np.concatenate([before, after])
    top = max(float(every.max(initial=0.0)), 1e-6)
    low = max(float(every.min(initial=top)), 0.05 * float(np.median(after)), 1e-6 * top)
    count = int(np.clip(2.0 * np.sqrt(len(after)) + 4, 8, 60))
    return np.geomspace(0.999 * min(low, 0.5 * top), 1.001 * top, count + 1)


def left_over(c: Calibration) -> Array:
    """What is left over of each number of the estimation rows, over its estimated noise, shape (K,)."""
    problem = c.fitted.estimate.problem
    residual = c.residual_calibrated[c.measurements.estimation]
    return np.asarray((residual / problem.scales)[problem.rows.used])


def _noise(ax: Axes, c: Calibration) -> None:
    """What is left over beside the normal distribution."""
    values = left_over(c)
    count = int(np.clip(np.sqrt(len(values)) * 1.5, 8, 50))
    edges = list(np.linspace(-_REACH, _REACH, count + 1))
    look = {"color": AFTER.colour, "histtype": "stepfilled", "lw": 1.2, **_area(AFTER)}
    heights, _, _ = ax.hist(values, bins=edges, **look)
    t = np.linspace(-_REACH, _REACH, 201)
    normal = np.exp(-0.5 * t**2) / np.sqrt(2.0 * np.pi) * len(values) * 2.0 * _REACH / count
    ax.plot(t, normal, color=INK, lw=1.2, ls="--", label="normal")
    ax.set_ylim(0.0, 1.3 * max(float(normal.max()), float(np.max(heights)), 1.0))
    ax.set_xlim(-_REACH, _REACH)
    ax.set_xlabel("what is left over / its noise")
    ax.set_ylabel("measured numbers")
    ax.set_title(f"{len(values):,} numbers of estimation rows")
    outside = int(np.sum(np.abs(values) > _REACH))
    if outside:
        ax.plot([], [], ls="none", label=f"{outside:,} beyond ±{_REACH:g}")
    ax.legend(loc="upper right", handlelength=1.6)
