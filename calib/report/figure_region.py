"""The density of a workspace and its region as a figure: three views through the whole, and three cuts.

Every picture has equal scales. A view adds up the density along the line of sight and shows the region's outline; a cut
shows density and region in a plane. PNG, SVG or PDF, by the ending of the file's name.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import calib.report.figure_base as base
from calib.files import write_atomically
from calib.regions.region_rows import RegionView
from calib.report.figure_space import VIEWS, flat, limits_of
from calib.units import Array, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def check_ending(path: str | Path) -> str:
    """The kind of a picture's file by its name's ending; a FileError where it is none of `KINDS`."""
    kind = Path(path).suffix.lower().removeprefix(".")
    base.check_kind(kind)
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
    with base.styled():
        data = base.saved(draw_region(view), kind, *headings(view), dpi=150)
    return write_atomically(Path(path), data, overwrite=overwrite)


def draw_region(view: RegionView) -> Figure:
    """The figure of a region; it belongs to no window and no global state."""
    density, region = view.density, view.region
    figure = base.new_figure(9.2, 13.0)
    figure.suptitle("\n".join(headings(view)), x=0.01, ha="left")
    axes = figure.subplots(2, 3)
    points = np.zeros((0, 3)) if view.checked is None else view.checked.points
    limits = limits_of(1e3 * np.vstack([density.extent, points]))
    low, voxel = 1e3 * density.origin, 1e3 * density.voxel
    # The voxel at the mean of the samples.
    index = np.indices(density.counts.shape).reshape(3, -1)
    centre = np.round(index @ density.counts.ravel() / density.samples).astype(np.intp)
    images = {}
    for column, (i, j, name) in enumerate(VIEWS):
        k, pair = 3 - i - j, [i, j]
        at = low[k] + (centre[k] + 0.5) * voxel
        cut = density.smooth.take(centre[k], axis=k), region.cells.take(centre[k], axis=k)
        for row, values, inside, heading in (
            (0, density.smooth.sum(axis=k), np.any(region.cells, axis=k), f"Seen {name}"),
            (1, *cut, f"Cut at {'xyz'[k]} = {at:.0f} mm"),
        ):
            ax = axes[row, column]
            images[row] = _panel(ax, values, inside, low[pair], voxel)
            ax.set_title(heading)
            flat(ax, limits, (i, j))
        _mark(axes[0, column], view, (i, j))
    for row, where in ((0, "along the line of sight"), (1, "in the cut")):
        bar = figure.colorbar(images[row], ax=list(axes[row]), shrink=0.85, ticks=[0, 0.5, 1])
        bar.set_label(f"how often {where}; 1: most often")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _panel(ax: Axes, values: Array, inside: Mask, low: Array, voxel: float) -> Any:  # noqa: ANN401
    """Density and outline in the plane of two axes, from the grid's least corner ``low`` [mm]."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    high = low + voxel * np.array(values.shape)
    image = ax.imshow(
        np.ma.masked_where(values.T <= 0.0, values.T / max(float(values.max()), 1e-300)),
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        cmap=LinearSegmentedColormap.from_list("often", list(base.LITTLE_TO_MUCH)),
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
        zorder=1,
    )
    # The edges between cells inside and those that are not, shape (K, 2, 2).
    padded = np.pad(inside, 1)
    along = np.argwhere(padded[1:, :] != padded[:-1, :])
    across = np.argwhere(padded[:, 1:] != padded[:, :-1])
    upright = np.stack([along - [0, 1], along], axis=1)
    level = np.stack([across - [1, 0], across], axis=1)
    edges = list(low + voxel * np.concatenate([upright, level]))
    lines = LineCollection(edges, colors=base.INK, linewidths=1.3, capstyle="projecting", zorder=3)
    lines.set_label("outline of the region")
    ax.add_collection(lines)
    return image


def _mark(ax: Axes, view: RegionView, pair: tuple[int, int]) -> None:
    """The points of a table's rows in a view: filled inside of the region, hollow and numbered outside."""
    if view.checked is None:
        return
    rows, points = view.checked.rows, view.checked.points
    inside, places = view.region.contains(points), 1e3 * points[:, pair]
    for chosen_set, colour, marker, size, word in (
        (rows.estimation, base.ESTIMATION, "o", 4.5, "estimation"),
        (rows.validation, base.VALIDATION, "D", 6.0, "validation"),
    ):
        for within, where, face, edge in (
            (True, "inside", colour, "white"),
            (False, "outside", "white", colour),
        ):
            chosen = chosen_set & (inside == within)
            if chosen.any():
                label = f"{np.count_nonzero(chosen)} {word} rows {where}"
                look: dict[str, Any] = {
                    "marker": marker,
                    "ms": size,
                    "mfc": face,
                    "mec": edge,
                    "label": label,
                }
                ax.plot(*places[chosen].T, ls="none", zorder=4, **look)
    base.number_points(ax, rows.rows, places, rows.validation | ~inside)
