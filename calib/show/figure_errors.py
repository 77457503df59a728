"""Errors before and after: curves over the rows, by pose, by axis, and how often which size occurs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.show.figure_base import (
    RowKind,
    angles_of,
    has_axes,
    left_out,
    legend_above,
    lengths_of,
    log_axis,
    new_figure,
    row_axis,
    row_kinds,
)
from calib.show.palette import CALIBRATED, INK, NOMINAL, SOFT, VALIDATION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: More rows than this get no markers, and more than that are summed up in bands.
_MOST_MARKERS, _MOST_LINES = 80, 1500

#: Bands are made of so many runs of rows.
_RUNS = 200

#: The rows' values of a box plot are drawn too if there are not more.
_MOST_DOTS = 300


@dataclass(frozen=True, slots=True)
class _Who:
    """How a robot is drawn: colour, marker, line and hatch."""

    word: str
    colour: str
    marker: str
    line: str
    hatch: str


_BEFORE = _Who("before (nominal)", NOMINAL, "s", "--", "////")
_AFTER = _Who("after (calibrated)", CALIBRATED, "o", "-", "")


def curve_rows(c: Calibration) -> tuple[str, Mask, Array]:
    """The rows of the error curves, what they are called, and the calibrated robot's residual there.

    Those for validation if there are any, else the estimation rows as fits predict them that had not seen them, else
    the estimation rows.
    """
    m = c.measurements
    measured = np.any(c.used[:, :3], axis=1)
    if np.any(m.validation & measured):
        return "validation", m.validation & measured, c.residual_calibrated
    unseen = left_out(c)
    if unseen is not None:
        return "left-out", m.estimation & measured, unseen
    return "estimation", m.estimation & measured, c.residual_calibrated


def curves_figure(c: Calibration) -> Figure:
    """Errors along x, y and z and their norm over the rows, before and after; as the paper's figure 8."""
    word, mask, after = curve_rows(c)
    rows = np.flatnonzero(mask)
    numbers = [c.measurements.rows[k] for k in rows]
    axes_too = has_axes(c)
    figure = new_figure(5.0 if axes_too else 2.9)
    panels = (
        figure.subplots(2, 2, sharex=True) if axes_too else figure.subplots(1, 1, squeeze=False)
    )
    every = panels.ravel()
    for k, ax in enumerate(every[:-1]):
        for who, residual in ((_BEFORE, c.residual_nominal), (_AFTER, after)):
            values = np.where(c.used[rows, k], 1e3 * residual[rows, k], np.nan)
            _curve(ax, values, who)
        ax.axhline(0.0, color=INK, lw=0.7)
        ax.set_title(f"Δ{'xyz'[k]}")
    for who, residual in ((_BEFORE, c.residual_nominal), (_AFTER, after)):
        _curve(every[-1], 1e3 * lengths_of(c, residual)[rows], who)
    every[-1].set_title("Size of the error" if axes_too else "Size of the error of the length")
    every[-1].set_ylim(bottom=0.0)
    if axes_too:  # one scale for the three, so that they can be compared
        reach = max(float(np.max(np.abs(ax.get_ylim()))) for ax in every[:-1])
        for ax in every[:-1]:
            ax.set_ylim(-reach, reach)
    for ax in every:
        row_axis(ax, numbers)
        ax.set_ylabel("error [mm]")
    for ax in panels[-1]:
        ax.set_xlabel(f"{word} row")
    legend_above(figure, _who_handles(len(rows)))
    return figure


def _curve(ax: Axes, values: Array, who: _Who) -> None:
    """A curve over rows; with markers where they are few, a band where they are many."""
    at = np.arange(len(values))
    if len(values) > _MOST_LINES:
        middle, low, high, top = _runs(values)
        x = np.linspace(0, len(values) - 1, len(middle))
        ax.fill_between(x, low, high, color=who.colour, alpha=0.35, lw=0)
        ax.plot(x, middle, color=who.colour, ls=who.line, lw=1.2)
        ax.plot(x, top, color=who.colour, lw=0.5, alpha=0.8)
        return
    few = len(values) <= _MOST_MARKERS
    ax.plot(
        at,
        values,
        color=who.colour,
        ls=who.line,
        lw=1.3 if few else 0.7,
        marker=who.marker if few else "",
        ms=4.2 if len(values) <= 40 else 3.0,
        mec="white",
        mew=0.4,
    )


def _runs(values: Array) -> tuple[Array, Array, Array, Array]:
    """Median, 5 % and 95 % quantile, and largest of runs of rows."""
    found = []
    for run in np.array_split(values, _RUNS):
        there = run[np.isfinite(run)]
        if len(there):
            largest = there[np.argmax(np.abs(there))]
            found.append((*np.quantile(there, [0.5, 0.05, 0.95]), largest))
        else:
            found.append((np.nan,) * 4)
    middle, low, high, top = np.array(found).T
    return middle, low, high, top


def _who_handles(count: int) -> list[Any]:
    """The legend of before and after."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    few = count <= _MOST_MARKERS
    handles: list[Any] = [
        Line2D(
            [],
            [],
            color=who.colour,
            ls=who.line,
            marker=who.marker if few else "",
            ms=4.2,
            mec="white",
            mew=0.4,
            label=who.word,
        )
        for who in (_BEFORE, _AFTER)
    ]
    if count > _MOST_LINES:
        each = -(-count // _RUNS)
        handles.append(
            Patch(color=SOFT, alpha=0.35, lw=0, label=f"5 to 95 % of {each:,} rows each")
        )
        handles.append(Line2D([], [], color=SOFT, lw=0.5, label="largest of them"))
    return handles


def by_pose_figure(c: Calibration, *, angle: bool = False) -> Figure:
    """The size of each row's error: before and after above, after alone below with what left-out rows show."""
    from matplotlib.lines import Line2D

    scale, unit = (float(np.degrees(1.0)), "deg") if angle else (1e3, "mm")
    size = angles_of if angle else lengths_of
    before, after = (scale * size(c, r) for r in (c.residual_nominal, c.residual_calibrated))
    count = len(before)
    figure = new_figure(4.6)
    top, below = figure.subplots(2, 1, sharex=True)
    for who, values in ((_BEFORE, before), (_AFTER, after)):
        _curve(top, values, who)
    top.set_ylim(bottom=0.0)
    top.set_title("Before and after")
    kinds = row_kinds(c)
    handles: list[Any] = list(_who_handles(count))
    if count > _MOST_LINES:
        _curve(below, after, _AFTER)
        kinds = tuple(kind for kind in kinds if kind.word == "outlier")
    else:
        unseen = left_out(c)
        if unseen is not None:
            _left_out_marks(below, scale * size(c, unseen))
            mark = Line2D(
                [], [], ls="none", marker="_", ms=7, mew=1.1, color=SOFT, label="left out"
            )
            handles.append(mark)
    for kind in kinds:
        _stems(below, after, kind, count)
        handles.append(Line2D([], [], label=kind.label, **kind.style(1)))
    below.set_title("After")
    below.set_ylim(bottom=0.0)
    below.set_xlabel("row")
    for ax in (top, below):
        ax.set_ylabel(f"size of the error [{unit}]")
        row_axis(ax, c.measurements.rows)
        _shade_validation(ax, c.measurements.validation)
    legend_above(figure, handles, 3)
    return figure


def _left_out_marks(ax: Axes, values: Array) -> None:
    """What rows show that were left out, as dashes."""
    ax.plot(values, ls="none", marker="_", ms=7 if len(values) <= 80 else 4, mew=1.1, color=SOFT)


def _stems(ax: Axes, values: Array, kind: RowKind, count: int) -> None:
    """Rows of one kind, on stems where they are few."""
    at = np.flatnonzero(kind.mask & np.isfinite(values))
    if count <= _MOST_MARKERS:
        ax.vlines(at, 0.0, values[at], color=kind.colour, lw=0.9, alpha=0.6)
    ax.plot(at, values[at], rasterized=len(at) > 1000, **kind.style(count if count > 400 else None))


def _shade_validation(ax: Axes, validation: Mask) -> None:
    """The stretches of validation rows on a ground of their own, if they are few."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], validation, [False]]).astype(int)))
    if len(edges) <= 40:
        for start, end in edges.reshape(-1, 2):
            ax.axvspan(start - 0.5, end - 0.5, color=VALIDATION, alpha=0.08, lw=0, zorder=0)


def by_axis_figure(c: Calibration) -> Figure:
    """How errors along and about each axis spread, before and after, for each set of rows."""
    m = c.measurements
    sets = [
        (w, k) for w, k in (("estimation", m.estimation), ("validation", m.validation)) if k.any()
    ]
    parts = [(slice(0, 3), 1e3, "mm", "error along the axis [mm]", "xyz")]
    if np.any(c.used[:, 3:]):
        turns = ("about x", "about y", "about z")
        parts.append(
            (slice(3, 6), float(np.degrees(1.0)), "deg", "error about the axis [deg]", turns)
        )
    figure = new_figure(2.9 * len(parts) + 0.2)
    panels = figure.subplots(len(parts), len(sets), squeeze=False, sharey="row")
    for row, (columns, scale, _, label, names) in zip(panels, parts, strict=True):
        for ax, (word, mask) in zip(row, sets, strict=True):
            used = c.used[mask][:, columns]
            for who, residual, shift in (
                (_BEFORE, c.residual_nominal, -0.19),
                (_AFTER, c.residual_calibrated, 0.19),
            ):
                values = scale * residual[mask][:, columns]
                _boxes(ax, [values[used[:, k], k] for k in range(3)], shift, who)
            ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
            ax.set_xticks(range(3), names)
            ax.set_xlim(-0.6, 2.6)
            ax.grid(visible=False, axis="x")
            count = int(np.sum(np.any(used, axis=1)))
            ax.set_title(f"{count:,} {word} row{'s' * (count != 1)}")
        row[0].set_ylabel(label)
    legend_above(figure, _box_handles())
    return figure


def _boxes(ax: Axes, columns: list[Array], shift: float, who: _Who) -> None:
    """A box for each axis, with the rows' values where they are few."""
    there = [(k, values) for k, values in enumerate(columns) if len(values)]
    if not there:
        return
    at = [k + shift for k, _ in there]
    few = len(there[0][1]) <= _MOST_DOTS
    if len(there[0][1]) >= 4:
        drawn = ax.boxplot(
            [values for _, values in there],
            positions=at,
            widths=0.3,
            whis=(5, 95),
            showfliers=False,
            patch_artist=True,
            manage_ticks=False,
        )
        for box in drawn["boxes"]:
            box.set(facecolor=who.colour, alpha=0.55, edgecolor=who.colour, hatch=who.hatch, lw=1.0)
        for part in ("whiskers", "caps", "medians"):
            for line in drawn[part]:
                line.set(color=INK if part == "medians" else who.colour, lw=1.4)
    for x, (_, values) in zip(at, there, strict=True):
        shown = values if few else np.array([values.min(), values.max()])
        spread = 0.09 * np.sin(2.4 * np.arange(len(shown))) if few else np.zeros(2)
        ax.plot(
            x + spread,
            shown,
            ls="none",
            marker=who.marker,
            ms=2.6,
            mfc=who.colour,
            mec="white",
            mew=0.3,
            zorder=3,
        )


def _box_handles() -> list[Any]:
    """The legend of boxes."""
    from matplotlib.patches import Patch

    return [
        Patch(
            facecolor=who.colour, alpha=0.55, edgecolor=who.colour, hatch=who.hatch, label=who.word
        )
        for who in (_BEFORE, _AFTER)
    ]


def histogram_figure(c: Calibration) -> Figure:
    """How often which size of error occurs, and whether what is left over looks like noise."""
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)
    before, after = (1e3 * lengths_of(c, r) for r in (c.residual_nominal, c.residual_calibrated))
    unit = "mm"
    if not np.any(np.isfinite(before)):
        unit = "deg"
        before, after = (
            np.degrees(angles_of(c, r)) for r in (c.residual_nominal, c.residual_calibrated)
        )
    before, after = before[np.isfinite(before)], after[np.isfinite(after)]
    bins = _bins(before, after)
    for who, values in ((_BEFORE, before), (_AFTER, after)):
        left.hist(
            np.clip(values, bins[0], None),
            bins=list(bins),
            histtype="stepfilled",
            color=who.colour,
            alpha=0.55,
            hatch=who.hatch,
            edgecolor=who.colour,
            lw=1.2,
        )
    log_axis(left, "x")
    left.set_xlabel(f"size of the error [{unit}]")
    left.set_ylabel("rows")
    left.set_title(f"All {len(after):,} rows")
    _noise(right, c)
    legend_above(figure, _box_handles())
    return figure


def _bins(before: Array, after: Array) -> Array:
    """Edges of the bins of sizes, even in their logarithm, for both."""
    every = np.concatenate([before, after])
    top = max(float(every.max()), 1e-6)
    # What is far below the median is put into the first bin.
    low = max(float(every.min()), 0.02 * float(np.median(after)), 1e-6 * top)
    low = min(low, 0.5 * top)
    count = int(np.clip(2.0 * np.sqrt(len(after)) + 4, 8, 60))
    return np.geomspace(0.999 * low, 1.001 * top, count + 1)


def _noise(ax: Axes, c: Calibration) -> None:
    """What is left over of each scalar, over its estimated noise, beside the normal distribution."""
    estimate = c.fitted.estimate
    used = estimate.problem.rows.used
    residual = c.residual_calibrated[c.measurements.estimation]
    values = (residual / estimate.problem.scales)[used]
    outside = int(np.sum(np.abs(values) > 5.0))
    count = int(np.clip(np.sqrt(len(values)) * 1.5, 8, 50))
    heights, _, _ = ax.hist(
        values,
        bins=list(np.linspace(-5.0, 5.0, count + 1)),
        histtype="stepfilled",
        color=CALIBRATED,
        alpha=0.55,
        edgecolor=CALIBRATED,
        lw=1.2,
    )
    t = np.linspace(-5.0, 5.0, 201)
    normal = np.exp(-0.5 * t**2) / np.sqrt(2.0 * np.pi) * len(values) * 10.0 / count
    ax.plot(t, normal, color=INK, lw=1.2, ls="--", label="normal distribution")
    ax.set_ylim(0.0, 1.25 * max(float(normal.max()), float(np.max(heights)), 1.0))
    ax.set_xlim(-5.0, 5.0)
    ax.set_xlabel("what is left over / estimated noise")
    ax.set_ylabel("numbers")
    beyond = f", {outside:,} beyond ±5" if outside else ""
    ax.set_title(f"{len(values):,} numbers of estimation rows{beyond}")
    ax.legend(loc="upper right", handlelength=1.6)
