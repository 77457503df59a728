"""Figures of image residuals: over the image, and image by image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import calib.show.figure_base as base
from calib.basics.arrays import Array, Integers, Mask
from calib.verbs.calibrate.camera.panels import (
    TYPICAL,
    WIDTH,
    arrows,
    image_panel,
    round_factor,
    stacked,
    times,
)
from calib.verbs.calibrate.camera.seen_corners import SeenCorners, rms

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Cells across an image in which residuals are averaged.
_CELLS = 12

#: Images with corners in a cell, at least, for a mean.
_FEWEST_IMAGES = 3

#: A mean of this many standard errors is not of chance.
_CLEAR = 3.0

#: Names of images stand below the bars if there are not more.
_MOST_NAMES = 30

#: Images with the largest errors that are named where there are more.
_WORST = 5


def over_image(cameras: Sequence[SeenCorners]) -> Figure:
    """Draw the residuals of the calibrated robot over the image: of each corner, and the mean of each cell.

    Args:
        cameras: The corners that each camera saw.
    """
    heights = [seen.size[1] / seen.size[0] for seen in cameras for _ in range(2)]
    figure = stacked(heights)
    panels = figure.subplots(len(heights), 1, squeeze=False)[:, 0]
    for k, seen in enumerate(cameras):
        _draw_corners(panels[2 * k], seen)
        _draw_means(panels[2 * k + 1], seen)
    return figure


def _draw_corners(ax: Axes, seen: SeenCorners) -> None:
    """Draw the residual of each corner that is not flagged, and mark those that are."""
    kept = ~seen.flagged
    residual = seen.calibrated[kept]
    sizes = np.linalg.norm(residual, axis=1)
    factor = round_factor(sizes, TYPICAL * seen.size[0])
    image_panel(ax, seen.size, f"{seen.label}: {len(seen):,} corners, {times(factor)}")
    arrows(ax, seen.measured[kept], residual, factor, sizes=sizes)
    if np.any(seen.flagged):
        label = base.rows_text(seen.flagged, "outlier", "")
        look: dict[str, Any] = {"ls": "none", "marker": "x", "ms": 4.0, "mew": 1.1}
        ax.plot(*seen.measured[seen.flagged].T, color=base.OUTLIER, label=label, **look)
        ax.legend(loc="lower right", frameon=True, framealpha=0.85)


def _draw_means(ax: Axes, seen: SeenCorners) -> None:
    """Draw the mean residual of each cell of the image: dark where it is not of chance, pale elsewhere."""
    means = cell_means(seen)
    lengths = np.linalg.norm(means.mean, axis=1)
    factor = round_factor(lengths, TYPICAL * seen.size[0])
    image_panel(ax, seen.size, f"{seen.label}: mean over cells of the image, {times(factor)}")
    for clear, colour, width, label in (
        (False, "#8fa1b3", 0.0032, "within chance"),
        (True, base.INK, 0.0045, f"beyond {_CLEAR:g} standard errors"),
    ):
        chosen = means.is_clear == clear
        if np.any(chosen):
            arrows(ax, means.centre[chosen], means.mean[chosen], factor, color=colour, width=width)
            ax.plot(
                *means.centre[chosen].T, ls="none", marker="o", ms=2.2, color=colour, label=label
            )
    if len(means.mean):
        ax.legend(loc="lower right", frameon=True, framealpha=0.85, markerscale=2.0)


@dataclass(frozen=True, slots=True, eq=False)
class CellMeans:
    """Mean residuals in cells of the image."""

    #: Shape (n, 2), middle of the corners in each cell [px]
    centre: Array
    #: Shape (n, 2), mean residual over the images that have corners there [px]
    mean: Array
    #: Shape (n,), means that are not of chance
    is_clear: Mask


def cell_means(seen: SeenCorners) -> CellMeans:
    """Average the residuals in cells of the image, where enough images have corners.

    Corners of one image are displaced together, by the robot's own errors; so each image counts once in a cell, and the
    scatter over images tells which means are of chance.
    """
    edge = seen.size[0] / _CELLS
    kept = np.flatnonzero(~seen.flagged)
    cells = np.floor((seen.measured[kept] + 0.5) / edge).astype(int)
    centres: list[Array] = []
    values: list[Array] = []
    is_clear: list[bool] = []
    names = np.array(seen.images)[kept]
    for cell in np.unique(cells, axis=0):
        of_cell = np.all(cells == cell, axis=1)
        of_images = [
            seen.calibrated[kept[of_cell & (names == name)]].mean(axis=0)
            for name in np.unique(names[of_cell])
        ]
        if len(of_images) < _FEWEST_IMAGES:
            continue
        mean = np.mean(of_images, axis=0)
        error = np.std(of_images, axis=0, ddof=1) / np.sqrt(len(of_images))
        centres.append(seen.measured[kept[of_cell]].mean(axis=0))
        values.append(mean)
        is_clear.append(bool(np.linalg.norm(mean) > _CLEAR * np.linalg.norm(error)))
    shape = (len(values), 2)
    return CellMeans(
        np.array(centres).reshape(shape),
        np.array(values).reshape(shape),
        np.array(is_clear, dtype=bool),
    )


def by_image(cameras: Sequence[SeenCorners]) -> Figure:
    """Draw the rms residual of each image as bars: fitted and validation images, and held-out predictions.

    Args:
        cameras: The corners that each camera saw.
    """
    named = max(len(seen.pictures) for seen in cameras) <= _MOST_NAMES
    figure = base.new_figure((3.1 if named else 2.5) * len(cameras) + 0.3, WIDTH)
    panels = figure.subplots(len(cameras), 1, squeeze=False)[:, 0]
    for ax, seen in zip(panels, cameras, strict=True):
        _draw_bars(ax, seen, named=named)
    base.legend_above(figure)
    return figure


def _draw_bars(ax: Axes, seen: SeenCorners, *, named: bool) -> None:
    """Draw the bars of one camera; with the names of images below them, or of the worst above."""
    pictures = seen.pictures
    values = image_rms(pictures, seen.calibrated)
    held_out = image_rms(pictures, seen.held_out)
    validation = np.array([bool(seen.validation[at].all()) for at in pictures.values()])
    numbers = np.arange(1, len(pictures) + 1)
    for chosen, colour, hatch, label in (
        (~validation, base.CALIBRATED, "", "fitted images"),
        (validation, base.VALIDATION, "////", "validation images"),
    ):
        if np.any(chosen):
            look: dict[str, Any] = {"fc": colour, "ec": colour, "alpha": 0.6, "hatch": hatch}
            ax.bar(numbers[chosen], values[chosen], width=0.74, label=label, **look)
    if np.any(np.isfinite(held_out)):
        size = 7.0 if named else 2.0
        look = {"ls": "none", "marker": "_", "ms": size, "mew": 1.4, "color": base.INK}
        ax.plot(numbers, held_out, label="held out", **look)
    ax.set(title=f"{seen.label}: {len(pictures):,} images", ylabel="rms in the image [px]")
    ax.set(xlim=(0.3, len(pictures) + 0.7), ylim=(0.0, None))
    ax.grid(visible=False, axis="x")
    names = base.short_names(list(pictures), 18)
    if named:
        ax.set_xticks(numbers, names, rotation=90)
        return
    ax.xaxis.set_major_locator(base.few_ticks(8, integers=True))
    ax.set_xlabel("image, in the order of the table")
    _name_worst(ax, np.fmax(values, held_out), names)


def image_rms(pictures: dict[str, Integers], residual: Array) -> Array:
    """Return the rms length of the residuals of each image; NaN where it has none.

    Args:
        pictures: Indices of the corners of each image.
        residual: shape (N, 2), [px].
    """
    values = []
    for at in pictures.values():
        known = residual[at]
        values.append(rms(known[np.isfinite(known).all(axis=1)]))
    return np.array(values)


def _name_worst(ax: Axes, heights: Array, names: Sequence[str]) -> None:
    """Write the names of the images with the largest errors above their bars; heights (n,), NaN for none."""
    worst = np.argsort(-np.nan_to_num(heights), kind="stable")[:_WORST]
    for k in worst.tolist():
        note = ax.annotate(
            names[k],
            (k + 1, heights[k]),
            xytext=(0.0, 3.0),
            textcoords="offset points",
            rotation=90,
            ha="center",
            va="bottom",
            size=7.5,
            color=base.INK,
        )
        note.set_in_layout(False)
    # Room for the names.
    ax.set_ylim(0.0, 1.9 * float(np.nanmax(heights, initial=1e-9)))
