"""How errors spread: by axis, before and after, and how often which size occurs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.show.figure_base import legend_above, log_axis, new_figure
from calib.show.figure_curves import AFTER, BEFORE, Who
from calib.show.figure_rows import angles_of, flagged_rows, lengths_of
from calib.show.palette import CALIBRATED, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Fewer rows than this have no box, and more than that no single dots.
_FEWEST_IN_BOX, _MOST_DOTS = 5, 120

#: What is left over is drawn up to so many standard deviations.
_REACH = 5.0


def by_axis_figure(c: Calibration, *, angle: bool = False) -> Figure:
    """How errors along (or about) each axis spread, for each set of rows; after alone once more below, magnified."""
    m = c.measurements
    columns = slice(3, 6) if angle else slice(0, 3)
    scale, unit = (float(np.degrees(1.0)), "deg") if angle else (1e3, "mm")
    names = ("about x", "about y", "about z") if angle else ("x", "y", "z")
    sets = [
        (word, mask)
        for word, mask in (("estimation", m.estimation), ("validation", m.validation))
        if np.any(c.used[mask][:, columns])
    ]
    flagged = flagged_rows(c)
    reach = 1e-3  # of the lower panels: rounding is no error
    figure = new_figure(4.6)
    panels = figure.subplots(2, len(sets), squeeze=False, sharey="row", sharex=True)
    for (upper, lower), (word, mask) in zip(panels.T, sets, strict=True):
        used = np.all(c.used[mask][:, columns], axis=1)
        before, after = (
            scale * residual[mask][used][:, columns]
            for residual in (c.residual_nominal, c.residual_calibrated)
        )
        _boxes(upper, before, -0.19, BEFORE)
        _boxes(upper, after, 0.19, AFTER)
        alone = after[~flagged[mask][used]]
        _boxes(lower, alone, 0.0, AFTER)
        reach = max(reach, 1.1 * float(np.abs(alone).max(initial=0.0)))
        upper.set_title(f"{len(after):,} {word} row{'s' * (len(after) != 1)}")
        what = "without outliers" if np.any(flagged[mask]) else "alone"
        lower.set_title(f"After, {what}")
        for ax in (upper, lower):
            ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
            ax.set_xlim(-0.6, 2.6)
            ax.grid(visible=False, axis="x")
        lower.set_xticks(range(3), names)
    panels[1, 0].set_ylim(-reach, reach)
    for ax in panels[:, 0]:
        ax.set_ylabel(f"error {'about' if angle else 'along'} the axis [{unit}]")
    legend_above(figure, _area_handles())
    return figure


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
            box.set(facecolor=who.colour, alpha=0.5, edgecolor=who.colour, hatch=who.hatch, lw=1.0)
        for part in ("whiskers", "caps", "medians"):
            for line in drawn[part]:
                line.set(color=INK if part == "medians" else who.colour, lw=1.4)
    few = count <= _MOST_DOTS
    for k in range(3 if count else 0):
        shown = values[:, k] if few else np.array([values[:, k].min(), values[:, k].max()])
        aside = 0.09 * np.sin(2.4 * np.arange(len(shown))) if few else np.zeros(2)
        ax.plot(
            k + shift + aside,
            shown,
            ls="none",
            marker=who.marker,
            ms=2.8,
            mfc=who.colour,
            mec="white",
            mew=0.3,
            zorder=3,
        )


def _area_handles() -> list[Any]:
    """The legend of boxes and bars."""
    from matplotlib.patches import Patch

    return [
        Patch(facecolor=who.colour, alpha=0.5, ec=who.colour, hatch=who.hatch, label=who.word)
        for who in (BEFORE, AFTER)
    ]


def histogram_figure(c: Calibration) -> Figure:
    """How often which size of error occurs, and whether what is left over looks like noise."""
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)
    scale, unit, size = 1e3, "mm", lengths_of
    if not np.any(c.used[:, :3]):
        scale, unit, size = float(np.degrees(1.0)), "deg", angles_of
    before, after = (scale * size(c, r) for r in (c.residual_nominal, c.residual_calibrated))
    before, after = before[np.isfinite(before)], after[np.isfinite(after)]
    bins = _bins(before, after)
    for who, values in ((BEFORE, before), (AFTER, after)):
        left.hist(
            np.maximum(values, bins[0]),
            bins=list(bins),
            histtype="stepfilled",
            color=who.colour,
            alpha=0.5,
            hatch=who.hatch,
            edgecolor=who.colour,
            lw=1.2,
        )
    log_axis(left, "x")
    left.set_xlabel(f"size of the error [{unit}]")
    left.set_ylabel("rows")
    left.set_title(f"All {len(after):,} rows" if len(after) > 1 else "The one row")
    _noise(right, c)
    for ax in (left, right):
        ax.yaxis.set_major_locator(
            MaxNLocator(nbins=6, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10])
        )
    legend_above(figure, _area_handles())
    return figure


def _bins(before: Array, after: Array) -> Array:
    """Edges of the bins of both, even in their logarithm; what is far below the median is put into the first."""
    every = np.concatenate([before, after])
    top = max(float(every.max(initial=0.0)), 1e-6)
    low = max(float(every.min(initial=top)), 0.05 * float(np.median(after)), 1e-6 * top)
    low = min(low, 0.5 * top)
    count = int(np.clip(2.0 * np.sqrt(len(after)) + 4, 8, 60))
    return np.geomspace(0.999 * low, 1.001 * top, count + 1)


def left_over(c: Calibration) -> Array:
    """What is left over of each number of the estimation rows, over its estimated noise, shape (K,)."""
    problem = c.fitted.estimate.problem
    residual = c.residual_calibrated[c.measurements.estimation]
    return np.asarray((residual / problem.scales)[problem.rows.used])


def _noise(ax: Axes, c: Calibration) -> None:
    """What is left over beside the normal distribution."""
    values = left_over(c)
    count = int(np.clip(np.sqrt(len(values)) * 1.5, 8, 50))
    heights, _, _ = ax.hist(
        values,
        bins=list(np.linspace(-_REACH, _REACH, count + 1)),
        histtype="stepfilled",
        color=CALIBRATED,
        alpha=0.5,
        edgecolor=CALIBRATED,
        lw=1.2,
    )
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
