"""The figure of a workspace's density and region: three views through all of it, and three cuts.

A view adds up the density along the line of sight and shows the outline of the region; a cut shows both in a plane.
Every panel has equal scales. The file is PNG, SVG or PDF, by the ending of its name.
"""

from __future__ import annotations

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
from calib.verbs.workspace.region_rows import RegionView

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Height and width of the figure [in].
_SIZE = (9.2, 13.0)

#: Resolution of a picture of pixels [dots per inch].
_DPI = 150


def check_ending(path: str | Path) -> str:
    """Return the format of a picture file by the ending of its name; raises `FileError` for another than `KINDS`."""
    kind = Path(path).suffix.lower().removeprefix(".")
    check_kind(kind)
    return kind


def headings(view: RegionView) -> tuple[str, str]:
    """Return the title of the picture and the page of a region, and the line below it."""
    region = view.region
    return (
        f"{view.robot.name}: positions of the target, {100 * region.share:.4g} %",
        f"{view.robot.base} to {view.robot.tip}; region {1e3 * region.volume:,.4g} litres, voxels of "
        f"{1e3 * region.voxel:g} mm, {view.density.samples:,} samples",
    )


def write_picture(view: RegionView, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the figure of a region.

    Args:
        view: The region, and the rows of a table.
        path: The file; the ending of its name is one of `calib.show.plotting.KINDS`.
        overwrite: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        CalibError: Matplotlib is missing.
        FileError: The name has another ending, or the file exists or cannot be written.
    """
    kind = check_ending(path)
    require_matplotlib("A picture")
    with styled():
        data = picture_bytes(draw_region(view), kind, *headings(view), dpi=_DPI)
    return write_atomically(Path(path), data, overwrite=overwrite)


def draw_region(view: RegionView) -> Figure:
    """Draw a region: three views with the rows of a table above, cuts through the mean of the samples below."""
    density = view.density
    voxel, low = 1e3 * density.voxel, 1e3 * density.origin
    indices = np.indices(density.counts.shape).reshape(3, -1)
    mean = indices @ density.counts.ravel() / density.samples
    centre = np.round(mean).astype(np.intp)  # the voxel at the mean of the samples
    points = np.zeros((0, 3)) if view.checked is None else view.checked.points
    limits = view_limits(1e3 * np.vstack([density.extent, points]))

    figure = new_figure(*_SIZE)
    figure.suptitle("\n".join(headings(view)), x=0.01, ha="left")
    axes = figure.subplots(2, 3)
    for column, (i, j, name) in enumerate(VIEWS):
        upper, lower = axes[:, column]
        across, pair = 3 - i - j, [i, j]
        inside = np.any(view.region.cells, axis=across)
        seen = _draw_panel(upper, density.smooth.sum(axis=across), inside, low[pair], voxel)
        upper.set_title(f"Seen {name}")
        set_view(upper, limits, (i, j))
        inside = view.region.cells.take(centre[across], axis=across)
        values = density.smooth.take(centre[across], axis=across)
        cut = _draw_panel(lower, values, inside, low[pair], voxel)
        height = low[across] + (centre[across] + 0.5) * voxel
        lower.set_title(f"Cut at {'xyz'[across]} = {height:.0f} mm")
        set_view(lower, limits, (i, j))
        _mark_rows(upper, view, (i, j))
    for image, panels, place in (
        (seen, axes[0], "along the line of sight"),
        (cut, axes[1], "in the cut"),
    ):
        bar = figure.colorbar(image, ax=list(panels), shrink=0.85, ticks=[0, 0.5, 1])
        bar.set_label(f"density {place}; 1: highest")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _draw_panel(ax: Axes, values: Array, inside: Mask, low: Array, voxel: float) -> Any:  # noqa: ANN401  an image
    """Draw the density and the outline of the region in the plane of two axes; returns matplotlib's image.

    Density and region are given for the cells along the horizontal and the vertical axis (I, J), with the least corner
    of the grid (2,) and the edge of a cell [mm].
    """
    from matplotlib.collections import LineCollection
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
    # Edges between cells inside and outside.
    padded = np.pad(inside, 1)
    along = np.argwhere(padded[1:, :] != padded[:-1, :])
    across = np.argwhere(padded[:, 1:] != padded[:, :-1])
    upright = np.stack([along - [0, 1], along], axis=1)
    level = np.stack([across - [1, 0], across], axis=1)
    edges = low + voxel * np.concatenate([upright, level])  # shape (K, 2, 2)
    lines = LineCollection(list(edges), colors=INK, linewidths=1.3, capstyle="projecting", zorder=3)
    lines.set_label("outline of the region")
    ax.add_collection(lines)
    return image


def _mark_rows(ax: Axes, view: RegionView, pair: tuple[int, int]) -> None:
    """Mark the rows of a table in the plane of two axes: filled inside the region, hollow and numbered outside.

    The axes are given as indices of x, y, z, the horizontal one first. Validation rows are always numbered.
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
        filled: dict[str, Any] = {"mfc": colour, "mec": "white", **look}
        hollow: dict[str, Any] = {"mfc": "white", "mec": colour, **look}
        for place, chosen, style in (("inside", inside, filled), ("outside", ~inside, hollow)):
            marked = places[mask & chosen]
            if len(marked):
                label = f"{len(marked)} {name} rows {place}"
                ax.plot(*marked.T, ls="none", zorder=4, label=label, **style)
    number_points(ax, rows.rows, places, rows.validation | ~inside)
