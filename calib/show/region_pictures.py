"""The density of a workspace and its region as a figure: three views through the whole, and three cuts.

Every picture has equal scales. A view adds up the density along the line of sight and shows the region's outline; a cut
shows density and region in a plane. PNG, SVG or PDF, by the ending of the file's name.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.design.region import Region
from calib.design.workspace import Density
from calib.errors import FileError, choices
from calib.model.files import write_atomically
from calib.model.robot import read_only
from calib.show.palette import ESTIMATION, INK, LITTLE_TO_MUCH, VALIDATION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Endings of picture files.
ENDINGS = (".png", ".svg", ".pdf")

#: The two axes of each picture, and what it is called.
_VIEWS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))

#: Rows are numbered in the picture if there are not more than this.
_MOST_NUMBERS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Marked:
    """Points of a table.

    Attributes:
        points: shape (N, 3), in the base frame [m].
        rows: Their row numbers.
        validation: shape (N,), whether a row is held back to validate with.
    """

    points: Array
    rows: tuple[int, ...]
    validation: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        object.__setattr__(self, "points", read_only(self.points))
        mask = np.array(self.validation, dtype=np.bool_)
        mask.setflags(write=False)
        object.__setattr__(self, "validation", mask)


def check_ending(path: str | Path) -> str:
    """The ending of a picture's file name, in small letters.

    Raises:
        FileError: It is none of `ENDINGS`.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        message = f"{path}: the ending says what kind of picture is written; choose one of {choices(ENDINGS)}."
        raise FileError(message)
    return ending


def write_picture(
    density: Density,
    region: Region,
    path: str | Path,
    *,
    title: str,
    subtitle: str = "",
    marked: Marked | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the figure of a region.

    Args:
        density: The density.
        region: A region of it.
        path: File to write; its ending is one of `ENDINGS`.
        title: Heading, plain text.
        subtitle: A line below it, plain text.
        marked: Points of a table; None for none.
        overwrite: Whether a file that exists may be replaced.

    Raises:
        FileError: Another ending, or the file exists or cannot be written.
    """
    from matplotlib import rc_context

    ending = check_ending(path)
    figure = draw_region(density, region, title=title, subtitle=subtitle, marked=marked)
    data = io.BytesIO()
    # The same figure is the same bytes: no dates.
    dates: dict[str, dict[str, Any]] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    # Names inside of an SVG are made from a salt, random if there is none; it is set for this one writing.
    with rc_context({"svg.hashsalt": "calib"}), warnings.catch_warnings():
        # A name in letters that the font lacks is drawn as boxes; the terminal is no place to say so.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        figure.savefig(data, format=ending[1:], dpi=150, metadata=dates.get(ending))
    return write_atomically(Path(path), data.getvalue(), overwrite=overwrite)


def draw_region(
    density: Density,
    region: Region,
    *,
    title: str,
    subtitle: str = "",
    marked: Marked | None = None,
) -> Figure:
    """The figure of a region; see `write_picture`. It belongs to no window and no global state."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    scale, unit = _unit(density)
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08, rect=(0, 0.01, 1, 0.9))
    figure = Figure(figsize=(13.0, 9.2), layout=layout, facecolor="white")
    figure.text(
        0.02, 0.965, title, size=15, weight="bold", color=INK, parse_math=False, va="center"
    )
    figure.text(0.02, 0.932, subtitle, size=10, color="#4a5866", parse_math=False, va="center")
    axes = figure.subplots(2, 3)
    centre = _middle_voxel(density)
    limits = _limits(density, marked)
    for column, (i, j, name) in enumerate(_VIEWS):
        k = 3 - i - j
        seen = density.smooth.sum(axis=k)
        shadow: NDArray[np.bool_] = np.any(region.cells, axis=k)
        whole = _panel(axes[0, column], density, region, (i, j), seen, shadow)
        cut = density.smooth.take(centre[k], axis=k)
        inside = region.cells.take(centre[k], axis=k)
        sliced = _panel(axes[1, column], density, region, (i, j), cut, inside)
        at = density.origin[k] + (centre[k] + 0.5) * density.voxel
        axes[0, column].set_title(f"Seen {name}", size=11, color=INK)
        axes[1, column].set_title(
            f"Cut at {'xyz'[k]} = {scale * at:.0f} {unit}", size=11, color=INK
        )
        for ax in axes[:, column]:
            _dress(ax, limits[:, (i, j)], (i, j), scale, unit)
    if marked is not None and len(marked.points):
        _mark(axes[0], marked, region.contains(marked.points), figure)
    for row, image, where in ((0, whole, "along the line of sight"), (1, sliced, "in the cut")):
        bar = figure.colorbar(image, ax=list(axes[row]), shrink=0.85, pad=0.015, ticks=[0, 0.5, 1])
        bar.set_label(f"how often {where}; 1: most often", size=9, color="#4a5866")
        bar.ax.tick_params(labelsize=9, color="#9aa7b4", labelcolor="#4a5866")
        bar.outline.set_visible(False)
    return figure


def _panel(
    ax: Axes,
    density: Density,
    region: Region,
    pair: tuple[int, int],
    values: Array,
    inside: NDArray[np.bool_],
) -> Any:  # noqa: ANN401  an image of matplotlib
    """Density and outline in the plane of two axes."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Rectangle

    colours = LinearSegmentedColormap.from_list("often", list(LITTLE_TO_MUCH))
    low = density.origin[list(pair)]
    high = low + density.voxel * np.array(values.shape)
    largest = max(float(values.max()), 1e-300)
    shown = np.ma.masked_where(values.T <= 0.0, values.T / largest)
    image = ax.imshow(
        shown,
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        cmap=colours,
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
        zorder=1,
    )
    corners = region.box[:, list(pair)]
    # Edges of voxels that the box cuts off lie on the box.
    edges = np.clip(outline(inside, low, density.voxel), corners[0], corners[1])
    ax.add_collection(
        LineCollection(list(edges), colors=INK, linewidths=1.3, capstyle="projecting", zorder=3)
    )
    if np.isfinite(corners).any():
        # An open side of the box ends outside of the picture.
        ends = np.clip(corners, low - 2 * (high - low), high + 2 * (high - low))
        start, size = ends[0].tolist(), (ends[1] - ends[0]).tolist()
        frame = Rectangle(start, *size, fill=False, ls="--", lw=1.0, ec="#4a5866", zorder=2)
        frame.set_in_layout(False)
        ax.add_patch(frame)
    return image


def outline(inside: NDArray[np.bool_], low: Array, step: float) -> Array:
    """The edges between the cells of a plane grid that are inside and those that are not.

    Args:
        inside: shape (n, m).
        low: shape (2,), the grid's least corner.
        step: Edge of a cell.

    Returns:
        shape (K, 2, 2): start and end of each edge.
    """
    padded = np.pad(inside, 1)
    along = np.argwhere(padded[1:, :] != padded[:-1, :])  # edges in the second direction
    across = np.argwhere(padded[:, 1:] != padded[:, :-1])
    upright = np.stack([along - [0, 1], along], axis=1)
    level = np.stack([across - [1, 0], across], axis=1)
    result: Array = low + step * np.concatenate([upright, level])
    return result


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
        axis.set_label_text(f"{letter} [{unit}]", size=9, color="#4a5866")
    ax.tick_params(labelsize=9, color="#9aa7b4", labelcolor="#4a5866")
    ax.grid(color="#e3e8ed", linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ax.spines.values():
        side.set_color("#c3ccd5")
    if np.all((limits[0] <= 0.0) & (limits[1] >= 0.0)):
        for width, colour in ((3.6, "white"), (1.6, INK)):
            ax.plot(0.0, 0.0, marker="+", color=colour, ms=10, mew=width, zorder=4)
        _word(ax, "base", np.zeros(2))


def _mark(axes: Any, marked: Marked, inside: NDArray[np.bool_], figure: Figure) -> None:  # noqa: ANN401
    """The rows' points in each view, and what they mean."""
    from matplotlib.lines import Line2D

    handles: list[Any] = [Line2D([], [], color=INK, lw=1.5, label="outline of the region")]
    for chosen, colour, shape, size, word in (
        (~marked.validation, ESTIMATION, "o", 4.5, "estimation"),
        (marked.validation, VALIDATION, "D", 6.0, "validation"),
    ):
        if not chosen.any():
            continue
        for within, fill in ((True, colour), (False, "white")):
            rows = chosen & (inside == within)
            if not rows.any():
                continue
            style: dict[str, Any] = {
                "ls": "none",
                "marker": shape,
                "ms": size,
                "mfc": fill,
                "mec": "white" if within else colour,
                "mew": 0.7 if within else 1.4,
            }
            for ax, (i, j, _) in zip(axes, _VIEWS, strict=True):
                ax.plot(marked.points[rows, i], marked.points[rows, j], zorder=4, **style)
            where = "inside" if within else "outside"
            label = f"{np.count_nonzero(rows)} {word} rows {where}"
            handles.append(Line2D([], [], label=label, **style))
    numbered = marked.validation | ~inside
    if np.count_nonzero(numbered) <= _MOST_NUMBERS:
        for ax, (i, j, _) in zip(axes, _VIEWS, strict=True):
            points = marked.points[numbered][:, [i, j]]
            sides = _free_sides(points, float(np.ptp(ax.get_xlim())))
            rows = np.flatnonzero(numbered)
            for k, point, side in zip(rows, points, sides, strict=True):
                _word(ax, str(marked.rows[k]), point, side)
    figure.legend(
        handles=handles,
        loc="upper right",
        bbox_to_anchor=(0.985, 0.985),
        ncols=(len(handles) + 1) // 2,
        frameon=False,
        fontsize=9,
        handletextpad=0.3,
        columnspacing=1.4,
    )


def _free_sides(points: Array, width: float) -> list[tuple[int, int]]:
    """On which side of each point its number stands: where the least of the others is, right above in doubt.

    Args:
        points: shape (N, 2).
        width: Of the panel, in the same unit.
    """
    sides = [(1, 1), (-1, 1), (1, -1), (-1, -1)]
    taken = [*points]
    chosen = []
    for i, point in enumerate(points):
        places = [point + 0.035 * width * np.array(side) for side in sides]
        others = np.array([*taken[:i], *taken[i + 1 :]]).reshape(-1, 2)
        gaps = [float(np.linalg.norm(others - p, axis=1).min(initial=width)) for p in places]
        # Rounded, so that the first one wins unless another has clearly more room.
        best = int(np.argmax(np.round(np.minimum(gaps, 0.08 * width) / (0.02 * width))))
        chosen.append(sides[best])
        taken.append(places[best])
    return chosen


def _word(ax: Axes, text: str, at: Array, side: tuple[int, int] = (1, 1)) -> None:
    """A short text beside a point."""
    from matplotlib.patheffects import withStroke

    ax.annotate(
        text,
        (float(at[0]), float(at[1])),
        (5 * side[0], 4 * side[1]),
        ha="left" if side[0] > 0 else "right",
        va="bottom" if side[1] > 0 else "top",
        textcoords="offset points",
        size=8.5,
        color=INK,
        zorder=5,
        path_effects=[withStroke(linewidth=2.2, foreground="white")],
    )


def _middle_voxel(density: Density) -> NDArray[np.intp]:
    """The voxel at the mean of the samples, shape (3,)."""
    sides = [np.arange(n) for n in density.counts.shape]
    sums = [density.counts.sum(axis=tuple({0, 1, 2} - {axis})) for axis in range(3)]
    means = [(side @ total) / total.sum() for side, total in zip(sides, sums, strict=True)]
    return np.round(means).astype(np.intp)


def _limits(density: Density, marked: Marked | None) -> Array:
    """What the pictures show, shape (2, 3), [m]: the workspace and the points, with some room about them."""
    low, high = density.extent
    if marked is not None and len(marked.points):
        # A wild point must not make the workspace small.
        room = 0.5 * float(np.max(high - low))
        near = np.all((marked.points > low - room) & (marked.points < high + room), axis=1)
        if near.any():
            low = np.minimum(low, marked.points[near].min(axis=0))
            high = np.maximum(high, marked.points[near].max(axis=0))
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    # A flat workspace gets some height, so that its picture is not a line.
    half = np.maximum(1.06 * half, 0.25 * half.max())
    return np.array([middle - half, middle + half])


def _unit(density: Density) -> tuple[float, str]:
    """The unit of the scales."""
    return (1.0, "m") if np.ptp(density.extent, axis=0).max() > 10.0 else (1e3, "mm")
