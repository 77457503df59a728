"""The density of a workspace and its region as a figure: three views through the whole, and three cuts.

Every picture has equal scales. A view adds up the density along the line of sight and shows the region's outline; a cut
shows density and region in a plane. PNG, SVG or PDF, by the ending of the file's name.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.design.workspace import Checked, Density, RegionView
from calib.errors import FileError, choices
from calib.files import write_atomically
from calib.report.figure_base import (
    ESTIMATION,
    INK,
    KINDS,
    LITTLE_TO_MUCH,
    VALIDATION,
    number_points,
    saved,
    styled,
    write_beside,
)
from calib.report.figure_space import VIEWS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Lines and labels beside the pictures.
_PALE, _GREY = "#9aa7b4", "#4a5866"


def check_ending(path: str | Path) -> str:
    """The kind of a picture's file by its name's ending; a FileError where it is none of `KINDS`."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in KINDS:
        endings = choices([f".{one}" for one in KINDS])
        raise FileError(
            f"{path}: the ending says what kind of picture is written; choose one of {endings}."
        )
    return kind


def headings(view: RegionView) -> tuple[str, str]:
    """Title and line below it of pictures and pages of a region."""
    region = view.region
    return (
        f"{view.robot.name}: positions of the target, {100 * region.share:.4g} %",
        f"{view.robot.base} to {view.robot.tip}; region {1e3 * region.volume:,.4g} litres, voxels of "
        f"{1e3 * region.voxel:g} mm, {view.density.samples:,} samples",
    )


def write_picture(view: RegionView, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the figure of a region; the file's ending says which of `KINDS`."""
    kind = check_ending(path)
    with styled():
        data = saved(draw_region(view), kind, *headings(view), dpi=150)
    return write_atomically(Path(path), data, overwrite=overwrite)


def draw_region(view: RegionView) -> Figure:
    """The figure of a region; it belongs to no window and no global state."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    density, region, checked = view.density, view.region, view.checked
    title, text = headings(view)
    wide = np.ptp(density.extent, axis=0).max() > 10.0
    scale, unit = (1.0, "m") if wide else (1e3, "mm")
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08, rect=(0, 0.01, 1, 0.9))
    figure = Figure(figsize=(13.0, 9.2), layout=layout)
    figure.text(0.02, 0.965, title, size=15, weight="bold", va="center")
    figure.text(0.02, 0.932, text, size=10, color=_GREY, va="center")
    axes = figure.subplots(2, 3)
    # The voxel at the mean of the samples.
    index = np.indices(density.counts.shape).reshape(3, -1)
    centre = np.round(index @ density.counts.ravel() / density.samples).astype(np.intp)
    limits = _limits(density, None if checked is None else checked.points)
    images = {}
    for column, (i, j, name) in enumerate(VIEWS):
        k = 3 - i - j
        at = density.origin[k] + (centre[k] + 0.5) * density.voxel
        shadow: Mask = np.any(region.cells, axis=k)
        cut = density.smooth.take(centre[k], axis=k), region.cells.take(centre[k], axis=k)
        for row, values, inside, heading in (
            (0, density.smooth.sum(axis=k), shadow, f"Seen {name}"),
            (1, *cut, f"Cut at {'xyz'[k]} = {scale * at:.0f} {unit}"),
        ):
            ax = axes[row, column]
            images[row] = _panel(ax, density, (i, j), values, inside)
            ax.set_title(heading, size=11, weight="normal", loc="center")
            _dress(ax, limits[:, (i, j)], (i, j), scale, unit)
    if checked is not None and len(checked.points):
        _mark(axes[0], checked, region.contains(checked.points), figure)
    for row, where in ((0, "along the line of sight"), (1, "in the cut")):
        bar = figure.colorbar(
            images[row], ax=list(axes[row]), shrink=0.85, pad=0.015, ticks=[0, 0.5, 1]
        )
        bar.set_label(f"how often {where}; 1: most often", size=9, color=_GREY)
        bar.ax.tick_params(labelsize=9, color=_PALE, labelcolor=_GREY)
        bar.outline.set_visible(False)
    return figure


def _panel(ax: Axes, density: Density, pair: tuple[int, int], values: Array, inside: Mask) -> Any:  # noqa: ANN401
    """Density and outline in the plane of two axes."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    low = density.origin[list(pair)]
    high = low + density.voxel * np.array(values.shape)
    image = ax.imshow(
        np.ma.masked_where(values.T <= 0.0, values.T / max(float(values.max()), 1e-300)),
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        cmap=LinearSegmentedColormap.from_list("often", list(LITTLE_TO_MUCH)),
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
        zorder=1,
    )
    edges = list(outline(inside, low, density.voxel))
    lines = LineCollection(edges, colors=INK, linewidths=1.3, capstyle="projecting", zorder=3)
    lines.set_label("outline of the region")
    ax.add_collection(lines)
    return image


def outline(inside: Mask, low: Array, step: float) -> Array:
    """Start and end, shape (K, 2, 2), of each edge between cells of a plane grid inside and those that are not.

    ``low``, shape (2,), is the grid's least corner, ``step`` the edge of a cell.
    """
    padded = np.pad(inside, 1)
    along = np.argwhere(padded[1:, :] != padded[:-1, :])  # edges in the second direction
    across = np.argwhere(padded[:, 1:] != padded[:, :-1])
    upright = np.stack([along - [0, 1], along], axis=1)
    level = np.stack([across - [1, 0], across], axis=1)
    return np.asarray(low + step * np.concatenate([upright, level]))


def _dress(ax: Axes, limits: Array, pair: tuple[int, int], scale: float, unit: str) -> None:
    """Limits, scales and labels of a panel, and where the base stands."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    ax.set_aspect("equal")
    ax.set_xlim(*limits[:, 0])
    ax.set_ylim(*limits[:, 1])
    text = FuncFormatter(lambda value, _: f"{scale * value:.4g}")
    for axis, letter in ((ax.xaxis, "xyz"[pair[0]]), (ax.yaxis, "xyz"[pair[1]])):
        axis.set_major_formatter(text)
        axis.set_major_locator(MaxNLocator(5))
        axis.set_label_text(f"{letter} [{unit}]", size=9, color=_GREY)
    ax.tick_params(labelsize=9, labelcolor=_GREY)
    ax.spines[:].set(visible=True, color="#c3ccd5")
    if np.all((limits[0] <= 0.0) & (limits[1] >= 0.0)):
        for width, colour in ((3.6, "white"), (1.6, INK)):
            ax.plot(0.0, 0.0, marker="+", color=colour, ms=10, mew=width, zorder=4)
        write_beside(ax, "base", np.zeros(2))


def _mark(axes: Any, checked: Checked, inside: Mask, figure: Figure) -> None:  # noqa: ANN401
    """The rows' points in each view, and what they mean."""
    rows, points = checked.rows, checked.points
    for chosen_set, colour, shape, size, word in (
        (rows.estimation, ESTIMATION, "o", 4.5, "estimation"),
        (rows.validation, VALIDATION, "D", 6.0, "validation"),
    ):
        for within, where in ((True, "inside"), (False, "outside")):
            chosen = chosen_set & (inside == within)
            if not chosen.any():
                continue
            look: dict[str, Any] = {"ls": "none", "marker": shape, "ms": size}
            look |= {"mfc": colour if within else "white", "mec": "white" if within else colour}
            look["mew"] = 0.7 if within else 1.4
            look["label"] = f"{np.count_nonzero(chosen)} {word} rows {where}"
            for ax, (i, j, _) in zip(axes, VIEWS, strict=True):
                ax.plot(points[chosen, i], points[chosen, j], zorder=4, **look)
    for ax, (i, j, _) in zip(axes, VIEWS, strict=True):
        places = points[:, [i, j]]
        number_points(ax, rows.rows, places, rows.validation | ~inside)
    handles, words = axes[0].get_legend_handles_labels()
    figure.legend(
        handles,
        words,
        loc="upper right",
        bbox_to_anchor=(0.985, 0.985),
        ncols=(len(handles) + 1) // 2,
        fontsize=9,
    )


def _limits(density: Density, points: Array | None) -> Array:
    """What the pictures show, shape (2, 3), [m]: the workspace and the points, with some room about them."""
    low, high = density.extent
    if points is not None:
        # A wild point must not make the workspace small.
        room = 0.5 * float(np.max(high - low))
        near = np.all((points > low - room) & (points < high + room), axis=1)
        shown = np.vstack([low, high, points[near]])
        low, high = shown.min(axis=0), shown.max(axis=0)
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    # A flat workspace gets some height, so that its picture is not a line.
    half = np.maximum(1.06 * half, 0.25 * half.max())
    return np.array([middle - half, middle + half])
