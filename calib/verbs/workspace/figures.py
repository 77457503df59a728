"""The figure of a workspace's density and region: three views through all of it, and three cuts.

Every panel has equal scales. A view adds up the density along the line of sight and shows the region's outline; a cut
shows density and region in a plane. PNG, SVG or PDF, by the ending of the file's name.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.files import write_atomically
from calib.show.look import ESTIMATION, INK, LITTLE_TO_MUCH, VALIDATION
from calib.show.plotting import (
    VIEWS,
    check_kind,
    new_figure,
    number_points,
    picture_bytes,
    require_matplotlib,
    set_view,
    styled,
    view_limits,
)
from calib.verbs.workspace.region import Density
from calib.verbs.workspace.region_rows import RegionView

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Height and width of the figure [in].
_SIZE = (9.2, 13.0)

#: Dots per inch of a picture that is pixels.
_DPI = 150


def check_ending(path: str | Path) -> str:
    """Return the kind of a picture file by its name's ending.

    Raises:
        FileError: It is none of `KINDS`.
    """
    kind = Path(path).suffix.lower().removeprefix(".")
    check_kind(kind)
    return kind


def headings(view: RegionView) -> tuple[str, str]:
    """Return the title, and the line below it, of pictures and pages of a region."""
    region = view.region
    return (
        f"{view.robot.name}: positions of the target, {100 * region.share:.4g} %",
        f"{view.robot.base} to {view.robot.tip}; region {1e3 * region.volume:,.4g} litres, voxels of "
        f"{1e3 * region.voxel:g} mm, {view.density.samples:,} samples",
    )


def write_picture(view: RegionView, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the figure of a region.

    Args:
        view: The region and the points of a table in it.
        path: Name of the file; its ending is one of `KINDS`.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        CalibError: Matplotlib is missing.
        FileError: Another ending, or the file exists or cannot be written.
    """
    kind = check_ending(path)
    require_matplotlib("A picture")
    with styled():
        data = picture_bytes(draw_region(view), kind, *headings(view), dpi=_DPI)
    return write_atomically(Path(path), data, overwrite=overwrite)


def draw_region(view: RegionView) -> Figure:
    """Draw a region: views in the upper row, cuts through the mean of the samples below."""
    figure = new_figure(*_SIZE)
    figure.suptitle("\n".join(headings(view)), x=0.01, ha="left")
    axes = figure.subplots(2, 3)
    limits = _limits(view)
    centre = _mean_voxel(view.density)
    for column, (i, j, name) in enumerate(VIEWS):
        upper, lower = axes[:, column]
        density = _draw_view(upper, view, (i, j))
        upper.set_title(f"Seen {name}")
        set_view(upper, limits, (i, j))
        cut = _draw_cut(lower, view, (i, j), centre)
        set_view(lower, limits, (i, j))
        _mark(upper, view, (i, j))
    _colour_bar(figure, density, axes[0], "density along the line of sight; 1: highest")
    _colour_bar(figure, cut, axes[1], "density in the cut; 1: highest")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _colour_bar(figure: Figure, image: Any, panels: Iterable[Axes], label: str) -> None:  # noqa: ANN401
    """Draw the scale of colours of an image, from 0 to 1, beside a row of panels."""
    bar = figure.colorbar(image, ax=list(panels), shrink=0.85, ticks=[0, 0.5, 1])
    bar.set_label(label)


def _limits(view: RegionView) -> Array:
    """Return the limits of all panels, shape (2, 3), [mm]: around the density and the points of the table."""
    points = np.zeros((0, 3)) if view.checked is None else view.checked.points
    return view_limits(1e3 * np.vstack([view.density.extent, points]))


def _mean_voxel(density: Density) -> Array:
    """Return the index of the voxel at the mean of the samples, shape (3,), integers from 0."""
    indices = np.indices(density.counts.shape).reshape(3, -1)
    mean = indices @ density.counts.ravel() / density.samples
    return np.round(mean).astype(np.intp)


def _draw_view(ax: Axes, view: RegionView, pair: tuple[int, int]) -> Any:  # noqa: ANN401  matplotlib's image
    """Draw the density added up along the line of sight; ``pair`` are the indices of the panel's axes."""
    along = 3 - sum(pair)
    density = view.density.smooth.sum(axis=along)
    inside = np.any(view.region.cells, axis=along)
    low = 1e3 * view.density.origin[list(pair)]
    return _panel(ax, density, inside, low, 1e3 * view.density.voxel)


def _draw_cut(ax: Axes, view: RegionView, pair: tuple[int, int], centre: Array) -> Any:  # noqa: ANN401  likewise
    """Draw the density in the plane of two axes through the voxel of index ``centre``, shape (3,)."""
    across = 3 - sum(pair)
    density = view.density.smooth.take(centre[across], axis=across)
    inside = view.region.cells.take(centre[across], axis=across)
    low = 1e3 * view.density.origin
    voxel = 1e3 * view.density.voxel
    height = low[across] + (centre[across] + 0.5) * voxel
    ax.set_title(f"Cut at {'xyz'[across]} = {height:.0f} mm")
    return _panel(ax, density, inside, low[list(pair)], voxel)


def _panel(ax: Axes, values: Array, inside: Mask, low: Array, voxel: float) -> Any:  # noqa: ANN401  matplotlib's image
    """Draw density and outline in the plane of two axes.

    Args:
        ax: The panel.
        values: shape (I, J), the density of cells along the horizontal and the vertical axis.
        inside: shape (I, J), the cells of the region.
        low: shape (2,), the least corner of the grid [mm].
        voxel: Edge of a cell [mm].

    Returns:
        The image, with colours from 0 to 1: the most.
    """
    from matplotlib.colors import LinearSegmentedColormap

    high = low + voxel * np.array(values.shape)
    share = values.T / max(float(values.max()), 1e-300)
    image = ax.imshow(
        np.ma.masked_where(values.T <= 0.0, share),
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        cmap=LinearSegmentedColormap.from_list("often", list(LITTLE_TO_MUCH)),
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
        zorder=1,
    )
    _draw_outline(ax, inside, low, voxel)
    return image


def _draw_outline(ax: Axes, inside: Mask, low: Array, voxel: float) -> None:
    """Draw the edges between cells inside and outside of the region; arguments as of `_panel`."""
    from matplotlib.collections import LineCollection

    padded = np.pad(inside, 1)
    along = np.argwhere(padded[1:, :] != padded[:-1, :])
    across = np.argwhere(padded[:, 1:] != padded[:, :-1])
    upright = np.stack([along - [0, 1], along], axis=1)
    level = np.stack([across - [1, 0], across], axis=1)
    edges = low + voxel * np.concatenate([upright, level])  # shape (K, 2, 2)
    lines = LineCollection(list(edges), colors=INK, linewidths=1.3, capstyle="projecting", zorder=3)
    lines.set_label("outline of the region")
    ax.add_collection(lines)


def _mark(ax: Axes, view: RegionView, pair: tuple[int, int]) -> None:
    """Mark the points of a table's rows in a view: filled inside of the region, hollow and numbered outside.

    Args:
        ax: The panel.
        view: The region and the points; without a table nothing is marked.
        pair: Indices of the panel's axes.
    """
    if view.checked is None:
        return
    rows = view.checked.rows
    places = 1e3 * view.checked.points[:, pair]
    inside = view.region.contains(view.checked.points)
    sets = (
        (rows.estimation, "estimation", {"marker": "o", "ms": 4.5}, ESTIMATION),
        (rows.validation, "validation", {"marker": "D", "ms": 6.0}, VALIDATION),
    )
    for mask, name, look, colour in sets:
        filled = {"mfc": colour, "mec": "white", **look}
        hollow = {"mfc": "white", "mec": colour, **look}
        _mark_rows(ax, places[mask & inside], f"{name} rows inside", filled)
        _mark_rows(ax, places[mask & ~inside], f"{name} rows outside", hollow)
    number_points(ax, rows.rows, places, rows.validation | ~inside)


def _mark_rows(ax: Axes, places: Array, noun: str, look: dict[str, Any]) -> None:
    """Mark points (K, 2) [mm], if there are any; the legend has their number and ``noun``."""
    if len(places):
        ax.plot(*places.T, ls="none", zorder=4, label=f"{len(places)} {noun}", **look)
