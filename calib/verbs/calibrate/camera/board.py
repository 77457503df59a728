"""The figure of the printed board: its corners as the fit estimated them, and what the images have beyond that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import calib.show.figure_base as base
from calib.basics.arrays import Array, Integers
from calib.verbs.calibrate.camera.panels import WIDTH, arrows, round_factor, times
from calib.verbs.calibrate.camera.seen_corners import SeenCorners

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Letters of a board's name in a title at most.
_LONGEST_NAME = 14

#: Millimetres per metre.
_MM = 1e3

#: Height of all boards together at most [in].
_MOST_HEIGHT = 7.5


def boards_of(cameras: Sequence[SeenCorners]) -> tuple[str, ...]:
    """Return the names of all boards, in the order of the table."""
    return tuple(dict.fromkeys(board for seen in cameras for board in seen.boards))


def corners(cameras: Sequence[SeenCorners]) -> Figure:
    """Draw each board's corners: errors of the print that the fit estimated, and mean residuals beyond them.

    Args:
        cameras: The corners that each camera saw.
    """
    boards = boards_of(cameras)
    figure = base.new_figure(min(3.1 * len(boards) + 0.4, _MOST_HEIGHT), WIDTH)
    panels = figure.subplots(len(boards), 2, squeeze=False)
    for (left, right), board in zip(panels, boards, strict=True):
        places, printed, residual = corner_errors(cameras, board)
        _draw_print(left, board, places, printed)
        _draw_residual(right, board, places, residual)
    return figure


def corner_errors(cameras: Sequence[SeenCorners], board: str) -> tuple[Array, Array, Array]:
    """Return the errors of the corners of one board.

    Args:
        cameras: The corners that each camera saw.
        board: Name of the board.

    Returns:
        The corners as designed, shape (n, 2); as printed less as designed, without the mean along the board,
        which moves all of it, shape (n, 3); and the displacement along the board that explains the residuals of each
        corner best, shape (n, 2); all along the board's axes [m]. Flagged corners do not count.
    """
    places: dict[str, Array] = {}
    printed: dict[str, Array] = {}
    residuals: dict[str, list[Array]] = {}
    for seen in cameras:
        for name, at in seen.of_board(board).items():
            places.setdefault(name, seen.designed[at[0], :2])
            printed.setdefault(name, seen.printed[at[0]] - seen.designed[at[0]])
            kept: Integers = at[~seen.flagged[at]]
            if len(kept):
                residuals.setdefault(name, []).append(seen.along_board(kept, seen.calibrated))
    of_print = np.array([*printed.values()])
    of_print[:, :2] -= of_print[:, :2].mean(axis=0)
    of_corners = [np.mean(residuals.get(name, [np.full(2, np.nan)]), axis=0) for name in places]
    return np.array([*places.values()]), of_print, np.array(of_corners)


def _draw_print(ax: Axes, board: str, places: Array, printed: Array) -> None:
    """Draw the errors of the print: arrows along the board, colours for the height above its plane."""
    from matplotlib.colors import LinearSegmentedColormap

    factor = round_factor(np.linalg.norm(printed[:, :2], axis=1), _longest(places))
    _board_panel(ax, f"{_title(board)}: print as fitted", places, times(factor))
    # z of a board points away from the camera: what bulges towards it is above the plane.
    height = -_MM * printed[:, 2]
    reach = max(float(np.abs(height).max()), 1e-3)
    colours = LinearSegmentedColormap.from_list("height", (base.NOMINAL, "#f2f2f2", "#b03a5b"))
    look: dict[str, Any] = {"vmin": -reach, "vmax": reach, "lw": 0.4, "ec": base.SOFT}
    x, y = _MM * places.T
    drawn = ax.scatter(x, y, 22, height, cmap=colours, **look)
    arrows(ax, _MM * places, _MM * printed[:, :2], factor, color=base.INK, width=0.008)
    bar = ax.figure.colorbar(drawn, ax=ax, location="bottom", shrink=0.8, pad=0.02, aspect=24)
    bar.set_label("bulge towards the camera [mm]")
    bar.locator = base.few_ticks(4)
    bar.outline.set_visible(False)


def _draw_residual(ax: Axes, board: str, places: Array, residual: Array) -> None:
    """Draw what the images have beyond the print as fitted: the mean residual of each corner."""
    known = np.isfinite(residual).all(axis=1)
    sizes = np.linalg.norm(residual[known], axis=1)
    factor = round_factor(sizes, _longest(places))
    _board_panel(ax, f"{_title(board)}: mean residual", places, times(factor))
    arrows(
        ax,
        _MM * places[known],
        _MM * residual[known],
        factor,
        sizes=_MM * sizes,
        unit="mm",
        location="bottom",
        width=0.008,
    )


def _longest(places: Array) -> float:
    """Return what a typical arrow takes at most on a board with corners at places (n, 2) [m]: half a square [m]."""
    least = np.array(
        [
            np.linalg.norm(np.delete(places, k, axis=0) - place, axis=1).min()
            for k, place in enumerate(places)
        ]
    )
    return 0.5 * float(np.median(least))


def _board_panel(ax: Axes, title: str, places: Array, drawn: str) -> None:
    """Make a panel a board seen from its front: x to the right, y down.

    Args:
        ax: The panel.
        title: Title of the panel.
        places: shape (n, 2), its corners [m].
        drawn: How arrows are drawn.
    """
    low = _MM * places.min(axis=0)
    high = _MM * places.max(axis=0)
    margin = 0.12 * float(np.max(high - low))
    ax.set(
        xlim=(low[0] - margin, high[0] + margin),
        ylim=(high[1] + margin, low[1] - margin),
        aspect="equal",
        title=f"{title}\n{drawn}",
        xlabel="x [mm]",
        ylabel="y [mm]",
    )
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(base.few_ticks(4))


def _title(board: str) -> str:
    """Return a board as titles of panels have it."""
    return base.short_names([board or "board"], _LONGEST_NAME)[0]
