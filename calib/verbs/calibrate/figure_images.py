"""Figures of image residuals: over the image, image by image, and over the corners of the boards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.result.calibration import Calibration
from calib.show.look import (
    CALIBRATED,
    INK,
    LITTLE_TO_MUCH,
    NOMINAL,
    OUTLIER,
    SOFT,
    VALIDATION,
    rows_text,
    short_names,
)
from calib.show.plotting import MOST_SHAPES, few_ticks, legend_above, new_figure
from calib.verbs.calibrate.seen_corners import SeenCorners, seen_corners

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Width of a figure of images [in]: less than a page's, so that its text can be read on a phone.
IMAGE_WIDTH = 5.2

#: Most height of the panel of an image, and of all boards together [in].
_MOST_IMAGE_HEIGHT, _MOST_BOARDS_HEIGHT = 4.4, 7.5

#: Factors of arrows: these times powers of ten.
_STEPS = (1.0, 2.0, 3.0, 5.0)

#: Colours of arrows from short to long; dark enough for lines on white.
_SHORT_TO_LONG = ("#e0a030", *LITTLE_TO_MUCH[2:], "#3a0d33")

#: Part of an image's width that a typical arrow takes at most.
_TYPICAL = 0.045

#: Cells across an image in which residuals are averaged.
_CELLS = 12

#: Images with corners in a cell, at least, for a mean.
_FEWEST_IMAGES = 3

#: A mean of this many standard errors is not by chance.
_CLEAR = 3.0

#: Names of images stand below the bars if there are not more.
_MOST_NAMES = 30

#: Images with the largest errors that are named if there are more.
_WORST = 5

#: Letters of a board's name in a title at most.
_LONGEST_NAME = 14

#: Millimetres per metre.
_MM = 1e3


# Over the image


def over_image(c: Calibration) -> Figure:
    """Draw the residuals of the calibrated robot over each camera's image: of each corner, and means of its cells.

    They are arrows, magnified as the titles say. Flagged corners are crosses, and left out of the means.
    """
    cameras = seen_corners(c)
    heights = [
        min(0.86 * IMAGE_WIDTH * seen.size[1] / seen.size[0], _MOST_IMAGE_HEIGHT) + 0.5
        for seen in cameras
    ]
    figure = new_figure(2 * sum(heights), IMAGE_WIDTH)
    panels = figure.subplots(2 * len(cameras), 1, squeeze=False)[:, 0]
    for upper, lower, seen in zip(panels[::2], panels[1::2], cameras, strict=True):
        # The residual of each corner that is not flagged, and marks for those that are.
        kept = ~seen.flagged
        residual = seen.calibrated[kept]
        sizes = np.linalg.norm(residual, axis=1)
        factor = _round_factor(sizes, _TYPICAL * seen.size[0])
        image_panel(upper, seen.size, f"{seen.label}: {len(seen):,} corners, {_times(factor)}")
        _arrows(upper, seen.measured[kept], residual, factor, sizes=sizes)
        if np.any(seen.flagged):
            label = rows_text(seen.flagged, "outlier", "")
            cross: dict[str, Any] = {"ls": "none", "marker": "x", "ms": 4.0, "mew": 1.1}
            upper.plot(*seen.measured[seen.flagged].T, color=OUTLIER, label=label, **cross)
            upper.legend(loc="lower right", frameon=True, framealpha=0.85)

        # The mean residual of each cell of the image: dark if it is not by chance, otherwise pale.
        centres, means, is_clear = cell_means(seen)
        factor = _round_factor(np.linalg.norm(means, axis=1), _TYPICAL * seen.size[0])
        title = f"{seen.label}: mean over cells of the image, {_times(factor)}"
        image_panel(lower, seen.size, title)
        for clear, colour, width, label in (
            (False, "#8fa1b3", 0.0032, "within chance"),
            (True, INK, 0.0045, f"beyond {_CLEAR:g} standard errors"),
        ):
            chosen = is_clear == clear
            if np.any(chosen):
                dot: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 2.2, "label": label}
                _arrows(lower, centres[chosen], means[chosen], factor, color=colour, width=width)
                lower.plot(*centres[chosen].T, color=colour, **dot)
        if len(means):
            lower.legend(loc="lower right", frameon=True, framealpha=0.85, markerscale=2.0)
    return figure


def cell_means(seen: SeenCorners) -> tuple[Array, Array, Mask]:
    """Average the residuals of the corners that are not flagged in cells of the image that enough images cover.

    Corners of one image are displaced together, by the robot's own errors; so each image counts once in a cell, and the
    scatter over images shows which means are due to chance.

    Args:
        seen: The corners that a camera saw.

    Returns:
        Of n cells the middle of their corners, shape (n, 2) [px]; the mean residual over the images, shape (n, 2) [px];
        and the means that are not by chance, shape (n,).
    """
    edge = seen.size[0] / _CELLS
    kept = np.flatnonzero(~seen.flagged)
    cells = np.floor((seen.measured[kept] + 0.5) / edge).astype(int)
    centres: list[Array] = []
    means: list[Array] = []
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
        means.append(mean)
        is_clear.append(bool(np.linalg.norm(mean) > _CLEAR * np.linalg.norm(error)))
    shape = (len(means), 2)
    return (
        np.array(centres).reshape(shape),
        np.array(means).reshape(shape),
        np.array(is_clear, dtype=bool),
    )


# Image by image


def by_image(c: Calibration) -> Figure:
    """Draw the rms residual of each image as bars: fitted and validation images, and held-out predictions."""
    cameras = seen_corners(c)
    named = max(len(seen.by_image) for seen in cameras) <= _MOST_NAMES
    figure = new_figure((3.1 if named else 2.5) * len(cameras) + 0.3, IMAGE_WIDTH)
    panels = figure.subplots(len(cameras), 1, squeeze=False)[:, 0]
    for ax, seen in zip(panels, cameras, strict=True):
        _draw_bars(ax, seen, named=named)
    legend_above(figure)
    return figure


def _draw_bars(ax: Axes, seen: SeenCorners, *, named: bool) -> None:
    """Draw the rms residual [px] of each image of one camera as a bar, and its held-out one as a dash.

    All images are named below their bars if ``named``, otherwise the worst above theirs.
    """
    images = seen.by_image
    values = image_rms(images, seen.calibrated)
    held_out = image_rms(images, seen.held_out)
    validation = np.array([bool(seen.validation[at].all()) for at in images.values()])
    numbers = np.arange(1, len(images) + 1)
    for chosen, colour, hatch, label in (
        (~validation, CALIBRATED, "", "fitted images"),
        (validation, VALIDATION, "////", "validation images"),
    ):
        if np.any(chosen):
            look: dict[str, Any] = {"fc": colour, "ec": colour, "alpha": 0.6, "hatch": hatch}
            ax.bar(numbers[chosen], values[chosen], width=0.74, label=label, **look)
    if np.any(np.isfinite(held_out)):
        size = 7.0 if named else 2.0
        look = {"ls": "none", "marker": "_", "ms": size, "mew": 1.4, "color": INK}
        ax.plot(numbers, held_out, label="held out", **look)
    ax.set(title=f"{seen.label}: {len(images):,} images", ylabel="rms in the image [px]")
    ax.set(xlim=(0.3, len(images) + 0.7), ylim=(0.0, None))
    ax.grid(visible=False, axis="x")

    names = short_names(list(images), 18)
    if named:
        ax.set_xticks(numbers, names, rotation=90)
        return
    ax.xaxis.set_major_locator(few_ticks(8, integers=True))
    ax.set_xlabel("image, in the order of the measurement")
    heights = np.fmax(values, held_out)
    worst = np.argsort(-np.nan_to_num(heights), kind="stable")[:_WORST]
    place: dict[str, Any] = {"xytext": (0.0, 3.0), "textcoords": "offset points", "rotation": 90}
    for k in worst.tolist():
        at = (k + 1, heights[k])
        note = ax.annotate(names[k], at, ha="center", va="bottom", size=7.5, color=INK, **place)
        note.set_in_layout(False)
    # Room for the names.
    ax.set_ylim(0.0, 1.9 * float(np.nanmax(heights, initial=1e-9)))


def image_rms(images: dict[str, Integers], residual: Array) -> Array:
    """Return the rms length of the residuals of each image, without corners that have none.

    Args:
        images: Indices of the corners of each image, from 0, by its name.
        residual: shape (N, 2), [px], of all corners; NaN for none.

    Returns:
        [px], in the order of the images; NaN for an image without residuals.
    """
    values = []
    for at in images.values():
        known = residual[at]
        known = known[np.isfinite(known).all(axis=1)]
        values.append(np.sqrt(np.mean(np.sum(known**2, axis=1))) if len(known) else np.nan)
    return np.array(values)


# Over the boards


def board_corners(c: Calibration) -> Figure:
    """Draw each board's corners: errors of the print that the fit estimated, and mean residuals beyond them.

    Both are arrows along the board, magnified as the titles say; colours show the bulge towards the camera [mm].
    """
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("height", (NOMINAL, "#f2f2f2", "#b03a5b"))
    cameras = seen_corners(c)
    boards = list(dict.fromkeys(board for seen in cameras for board in seen.boards))
    figure = new_figure(min(3.1 * len(boards) + 0.4, _MOST_BOARDS_HEIGHT), IMAGE_WIDTH)
    panels = figure.subplots(len(boards), 2, squeeze=False)
    for (left, right), board in zip(panels, boards, strict=True):
        places, printed, residual = corner_errors(cameras, board)
        title = short_names([board or "board"], _LONGEST_NAME)[0]
        longest = _longest_arrow(places)
        corners = _MM * places

        # The errors of the print: arrows along the board, colours for the height above its plane.
        factor = _round_factor(np.linalg.norm(printed[:, :2], axis=1), longest)
        _board_panel(left, f"{title}: print as fitted\n{_times(factor)}", places)
        # z of a board points away from the camera: what bulges towards it is above the plane.
        height = -_MM * printed[:, 2]
        reach = max(float(np.abs(height).max()), 1e-3)
        look: dict[str, Any] = {"vmin": -reach, "vmax": reach, "lw": 0.4, "ec": SOFT}
        drawn = left.scatter(*corners.T, 22, height, cmap=colours, **look)
        _arrows(left, corners, _MM * printed[:, :2], factor, color=INK, width=0.008)
        bar = figure.colorbar(drawn, ax=left, location="bottom", shrink=0.8, pad=0.02, aspect=24)
        bar.set_label("bulge towards the camera [mm]")
        bar.locator = few_ticks(4)
        bar.outline.set_visible(False)

        # Beyond the print as fitted: the mean residual of each corner in the images.
        known = np.isfinite(residual).all(axis=1)
        sizes = np.linalg.norm(residual[known], axis=1)
        factor = _round_factor(sizes, longest)
        _board_panel(right, f"{title}: mean residual\n{_times(factor)}", places)
        _arrows(
            right,
            corners[known],
            _MM * residual[known],
            factor,
            sizes=_MM * sizes,
            unit="mm",
            location="bottom",
            width=0.008,
        )
    return figure


def corner_errors(cameras: Sequence[SeenCorners], board: str) -> tuple[Array, Array, Array]:
    """Return the errors of the corners of one board.

    Args:
        cameras: The corners that each camera saw.
        board: Name of the board.

    Returns:
        The corners on the board's sheet, shape (n, 2); as printed less as designed, without the mean along the board,
        which moves all of it, shape (n, 3); and the displacement along the board that explains the residuals of each
        corner best, shape (n, 2); all along the sheet's axes [m]. Flagged corners do not count for the displacement,
        which is NaN for a corner that was flagged in all images.
    """
    places: dict[str, Array] = {}
    axes: dict[str, Array] = {}
    printed: dict[str, Array] = {}
    residuals: dict[str, list[Array]] = {}
    for seen in cameras:
        for name, at in seen.of_board(board).items():
            places.setdefault(name, seen.on_sheet[at[0]])
            axes.setdefault(name, seen.R_board_sheet[at[0]])
            printed.setdefault(name, seen.printed[at[0]] - seen.designed[at[0]])
            kept: Integers = at[~seen.flagged[at]]
            if len(kept):
                residuals.setdefault(name, []).append(seen.along_board(kept, seen.calibrated))
    R = np.array([*axes.values()])
    of_board = np.array([*printed.values()])
    is_flat = np.array_equal(R, np.broadcast_to(np.eye(3), R.shape))
    # A flat board that lies deeper sags, and a body that does is elsewhere.
    of_board -= of_board.mean(axis=0) * [1.0, 1.0, 0.0 if is_flat else 1.0]
    of_print = np.einsum("nij,ni->nj", R, of_board)
    of_corners = [np.mean(residuals.get(name, [np.full(2, np.nan)]), axis=0) for name in places]
    return np.array([*places.values()]), of_print, np.array(of_corners)


def _longest_arrow(places: Array) -> float:
    """Return the longest that a typical arrow may be on a board with corners at (n, 2) [m]: half their spacing [m]."""
    least = np.array(
        [
            np.linalg.norm(np.delete(places, k, axis=0) - place, axis=1).min()
            for k, place in enumerate(places)
        ]
    )
    return 0.5 * float(np.median(least))


def _board_panel(ax: Axes, title: str, places: Array) -> None:
    """Set up a panel in mm for a board with corners at places (n, 2) [m], from its front: x to the right, y down."""
    low = _MM * places.min(axis=0)
    high = _MM * places.max(axis=0)
    margin = 0.12 * float(np.max(high - low))
    ax.set(
        xlim=(low[0] - margin, high[0] + margin),
        ylim=(high[1] + margin, low[1] - margin),
        aspect="equal",
        title=title,
        xlabel="x [mm]",
        ylabel="y [mm]",
    )
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(few_ticks(4))


# Panels of images and arrows


def image_panel(ax: Axes, size: tuple[int, int], title: str) -> None:
    """Set up a panel to show an image: axes in pixels, rows downwards, its edge drawn.

    Args:
        ax: The panel.
        size: Columns and rows of the image [px].
        title: Title of the panel.
    """
    width, height = size
    ax.set(
        xlim=(-0.5, width - 0.5),
        ylim=(height - 0.5, -0.5),
        aspect="equal",
        title=title,
        xlabel="u [px]",
        ylabel="v [px]",
    )
    ax.grid(visible=False)
    for side in ("right", "top"):
        ax.spines[side].set_visible(True)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(few_ticks(6))


def _round_factor(lengths: Array, longest: float) -> float:
    """Return the largest factor, 1, 2, 3 or 5 times a power of ten, that keeps the rms of lengths (n,) to ``longest``.

    NaN does not count; it is 1 if no length is left, or all are 0.
    """
    lengths = lengths[np.isfinite(lengths)]
    typical = float(np.sqrt(np.mean(lengths**2))) if len(lengths) else 0.0
    if not typical > 0.0:
        return 1.0
    wanted = longest / typical
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in _STEPS if step * power <= wanted * (1.0 + 1e-9)))


def _times(factor: float) -> str:
    """Word a factor of arrows: ``arrows × 200``."""
    return f"arrows × {factor:,g}"


def _arrows(
    ax: Axes,
    starts: Array,
    vectors: Array,
    factor: float,
    *,
    sizes: Array | None = None,
    unit: str = "px",
    location: str = "right",
    **look: Any,  # noqa: ANN401  matplotlib's properties
) -> None:
    """Draw arrows from starts (n, 2), vectors (n, 2) times a factor, in the units of the panel.

    They are coloured by ``sizes`` (n,), in ``unit``, with a scale beside the panel; or without sizes in one colour.
    """
    from matplotlib.colors import LinearSegmentedColormap

    common: dict[str, Any] = {
        "angles": "xy",
        "scale_units": "xy",
        "scale": 1.0 / factor,
        "width": 0.0032,
        "headwidth": 3.6,
        "headlength": 4.2,
        "headaxislength": 3.8,
        "rasterized": len(starts) > MOST_SHAPES,
        **look,
    }
    if sizes is None:
        ax.quiver(*starts.T, *vectors.T, **common)
        return
    colours = LinearSegmentedColormap.from_list("short to long", _SHORT_TO_LONG)
    # A few wild corners must not make all others look alike.
    top = float(np.quantile(sizes, 0.98)) if len(sizes) else 1.0
    common |= {"cmap": colours, "clim": (0.0, max(top, 1e-9))}
    drawn = ax.quiver(*starts.T, *vectors.T, sizes, **common)
    scale: dict[str, Any] = {"shrink": 0.85, "pad": 0.02, "aspect": 26, "extend": "max"}
    bar = ax.figure.colorbar(drawn, ax=ax, location=location, **scale)
    bar.locator = few_ticks(4)
    bar.set_label(f"size [{unit}]")
    bar.outline.set_visible(False)
