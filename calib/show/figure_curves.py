"""Errors before and after over the rows: curves as in the paper's figure 8, and the size of each row's error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.identify.result import Calibration
from calib.show.figure_base import legend_above, new_figure
from calib.show.figure_rows import (
    RowKind,
    angles_of,
    flagged_rows,
    has_axes,
    left_out,
    lengths_of,
    number_points,
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
_MOST_MARKERS, MOST_LINES = 80, 1000

#: Rows of one run of a band, at least, and the most runs.
_ROWS, _RUNS = 20, 120

#: More stretches of validation rows than this are not shaded.
_MOST_STRETCHES = 40


@dataclass(frozen=True, slots=True)
class Who:
    """How a robot is drawn.

    Attributes:
        word: In the legend.
        colour: As CSS has it.
        marker: Of matplotlib.
        line: Style of its line.
        hatch: Of its areas.
    """

    word: str
    colour: str
    marker: str
    line: str
    hatch: str


BEFORE = Who("before (nominal)", NOMINAL, "s", "--", "////")
AFTER = Who("after (calibrated)", CALIBRATED, "o", "-", "")


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
    before, after = left_out(c, c.nominal_cross_validation), left_out(c, c.cross_validation)
    if before is not None and after is not None:
        return "left-out", m.estimation & measured, before, after
    return "estimation", m.estimation & measured, c.residual_nominal, c.residual_calibrated


def curves_figure(c: Calibration) -> Figure:
    """Errors along x, y and z and their size over the rows, before and after; as the paper's figure 8.

    Lengths have one panel: their errors with their signs. Beside rows with three axes they have their size alone.
    """
    word, mask, before, after = curve_rows(c)
    rows = np.flatnonzero(mask)
    numbers = [c.measurements.rows[k] for k in rows]
    axes_too = has_axes(c, mask)
    whole = np.all(c.used[rows, :3], axis=1) if axes_too else c.used[rows, 0]
    figure = new_figure(4.9 if axes_too else 2.8)
    shape = (2, 2) if axes_too else (1, 1)
    panels = figure.subplots(*shape, sharex=True, squeeze=False)
    every = panels.ravel()
    signed = every[:-1] if axes_too else every
    for k, ax in enumerate(signed):
        for who, residual in ((BEFORE, before), (AFTER, after)):
            _curve(ax, np.where(whole, 1e3 * residual[rows, k], np.nan), who)
        ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
        ax.set_title(f"Δ{'xyz'[k]}" if axes_too else "Error of the length")
    if axes_too:
        for who, residual in ((BEFORE, before), (AFTER, after)):
            _curve(every[-1], 1e3 * lengths_of(c, residual)[rows], who)
        every[-1].set_title("Size of the error")
        every[-1].set_ylim(bottom=0.0)
        # One scale for the three, so that they can be compared.
        reach = max(float(np.max(np.abs(ax.get_ylim()))) for ax in every[:-1])
        for ax in every[:-1]:
            ax.set_ylim(-reach, reach)
    for ax in every:
        row_axis(ax, numbers, 6 if axes_too else 10)
        ax.set_ylabel("error [mm]")
    for ax in panels[-1]:
        ax.set_xlabel(f"{word} row")
    legend_above(figure, _who_handles(len(rows)))
    return figure


def _curve(ax: Axes, values: Array, who: Who, *, largest: bool = False) -> None:
    """A curve over rows; with markers where they are few, a band where they are many."""
    if len(values) > MOST_LINES:
        x, middle, low, high, top = _runs(values)
        ax.fill_between(x, low, high, color=who.colour, alpha=0.35, lw=0, zorder=2)
        ax.plot(x, middle, color=who.colour, ls=who.line, lw=1.3, zorder=3)
        if largest:
            ax.plot(x, top, color=who.colour, lw=0.6, alpha=0.8, zorder=2)
        return
    few = len(values) <= _MOST_MARKERS
    # A line leads over rows that hold nothing, such as the second ones of pairs: gaps would leave nothing of it.
    at = np.flatnonzero(np.isfinite(values))
    ax.plot(
        at,
        values[at],
        color=who.colour,
        ls=who.line,
        lw=1.3 if few else 0.8,
        marker=who.marker if few or len(values) == 1 else "",
        ms=4.2 if len(values) <= 40 else 3.0,
        mec="white",
        mew=0.4,
        zorder=3,
    )


def _run_count(count: int) -> int:
    """How many runs so many rows are summed up in."""
    return min(count // _ROWS, _RUNS)


def _runs(values: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Middle place, median, 5 % and 95 % quantile, and largest of runs of rows that hold numbers."""
    found = []
    for run in np.array_split(np.arange(len(values)), _run_count(len(values))):
        there = values[run][np.isfinite(values[run])]
        if len(there):
            largest = there[np.argmax(np.abs(there))]
            found.append((np.mean(run), *np.quantile(there, [0.5, 0.05, 0.95]), largest))
    x, middle, low, high, top = np.array(found).reshape(-1, 5).T
    return x, middle, low, high, top


def _who_handles(count: int, *, largest: bool = False) -> list[Any]:
    """The legend of before and after."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    few, many = count <= _MOST_MARKERS, count > MOST_LINES
    look = {"ms": 4.2, "mec": "white", "mew": 0.4}
    handles: list[Any] = [
        Line2D(
            [],
            [],
            color=who.colour,
            ls=who.line,
            marker=who.marker if few else "",
            label=f"{who.word}, median" if many else who.word,
            **look,  # type: ignore[arg-type]
        )
        for who in (BEFORE, AFTER)
    ]
    if many:
        each = round(count / _run_count(count))
        words = f"5 to 95 % of {each:,} rows each"
        handles.append(Patch(color=SOFT, alpha=0.35, lw=0, label=words))
        if largest:
            handles.append(Line2D([], [], color=SOFT, lw=0.6, label="largest of them"))
    return handles


def by_pose_figure(c: Calibration, *, angle: bool = False) -> Figure:
    """The size of each row's error: before and after above; after alone below, with what left-out rows show."""
    from matplotlib.lines import Line2D

    scale, unit = (float(np.degrees(1.0)), "deg") if angle else (1e3, "mm")
    size = angles_of if angle else lengths_of
    before, after = (scale * size(c, r) for r in (c.residual_nominal, c.residual_calibrated))
    count = len(before)
    figure = new_figure(4.6)
    top, below = figure.subplots(2, 1, sharex=True)
    for who, values in ((BEFORE, before), (AFTER, after)):
        _curve(top, values, who, largest=True)
    top.set_title("Before and after")
    kinds = [kind for kind in row_kinds(c) if np.any(np.isfinite(after[kind.mask]))]
    handles: list[Any] = list(_who_handles(count, largest=True))
    unseen = left_out(c, c.cross_validation)
    others = ~flagged_rows(c)
    reach = float(np.nanmax(after[others], initial=1e-3))
    if count > MOST_LINES:
        _curve(below, np.where(others, after, np.nan), AFTER, largest=True)
        kinds = [kind for kind in kinds if kind.word == "outlier"]
    else:
        if unseen is not None:
            dashes = np.where(others, scale * size(c, unseen), np.nan)
            reach = float(np.nanmax(dashes, initial=reach))
            look: dict[str, Any] = {
                "ls": "none",
                "marker": "_",
                "ms": 7 if count <= _MOST_MARKERS else 4,
                "mew": 1.1,
            }
            below.plot(dashes, color=SOFT, **look)
            handles.append(Line2D([], [], color=SOFT, label="left out of the fit", **look))
    # Outliers far above the others stand at the edge: above they are drawn to scale.
    after = np.where(others, after, np.minimum(after, 1.25 * reach))
    for kind in kinds:
        _stems(below, after, kind, count)
        handles.append(Line2D([], [], label=kind.label, **kind.style(1)))
    places = np.stack([np.arange(count), after], axis=1)
    number_points(below, c, places, only=("outlier",))
    below.set_title("After")
    below.set_xlabel("row")
    for ax in (top, below):
        ax.set_ylabel(f"size of the error [{unit}]")
        row_axis(ax, c.measurements.rows)
        _shade_validation(ax, c.measurements.validation)
    top.set_ylim(bottom=0.0)
    below.set_ylim(0.0, 1.32 * reach)
    legend_above(figure, handles, 3)
    return figure


def _stems(ax: Axes, values: Array, kind: RowKind, count: int) -> None:
    """Rows of one kind, on stems where they are few."""
    at = np.flatnonzero(kind.mask & np.isfinite(values))
    if count <= _MOST_MARKERS:
        ax.vlines(at, 0.0, values[at], color=kind.colour, lw=0.9, alpha=0.6)
    ax.plot(at, values[at], **kind.style(count))


def shaded(validation: Mask) -> list[tuple[int, int]]:
    """Where the stretches of validation rows that have a ground of their own begin and end; none if they are many.

    Args:
        validation: shape (N,), which rows validate.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], validation, [False]]).astype(int)))
    few = len(edges) <= 2 * _MOST_STRETCHES
    return [(int(start), int(end)) for start, end in edges.reshape(-1, 2)] if few else []


def _shade_validation(ax: Axes, validation: Mask) -> None:
    """The stretches of validation rows on a ground of their own."""
    for start, end in shaded(validation):
        ax.axvspan(start - 0.5, end - 0.5, color=VALIDATION, alpha=0.08, lw=0, zorder=0)
