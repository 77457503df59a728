"""Figures in space: the measured points, and the uncertainty of predicted positions over the workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calib.basics.arrays import Array
from calib.result.calibration import Calibration
from calib.show.look import INK, SOFT, SURE_TO_UNSURE, row_kinds
from calib.show.measured_rows import chains_of_rows, measured_in_base, setup_of_rows
from calib.show.plotting import (
    MOST_SHAPES,
    VIEWS,
    WIDTH,
    few_ticks,
    legend_above,
    new_figure,
    number_points,
    set_view,
    view_limits,
)
from calib.show.uncertainty_map import uncertainty_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Least height of the view from above [in].
_LEAST_HEIGHT = 2.2

#: Most height of all views together [in]: a page with a caption holds that.
_MOST_HEIGHT = 5.8

#: Number of poses over the joint limits at which the uncertainty is drawn.
POSES = 4000

#: Hexagons across a view.
_CELLS = 22

#: Measured points drawn in a view of the uncertainty, about; of more an even choice is drawn.
_MEASURED_POINTS = 150


def measured_places(c: Calibration) -> Array:
    """Return the target's positions in the base frame, shape (N, 3), [m].

    Measured ones; of rows that measure no position, those that the calibrated robot predicts.
    """
    m = c.fit.measurements
    T_frame_base, T_tip_target = setup_of_rows(c.setup, m)
    places = measured_in_base(m, T_frame_base)
    chain = chains_of_rows(c.robot, c.setup, m)
    T_base_target = c.robot.poses(m.joints_for(c.nominal.joint_names), chain) @ T_tip_target
    return np.where(np.isfinite(places), places, T_base_target[:, :3, 3])


def points(c: Calibration) -> Figure:
    """Draw the measured points in the base frame: in space, and from three sides; as the paper's figure 7."""
    places = 1e3 * measured_places(c)
    limits = view_limits(places)
    # Panels of one scale, and one in perspective.
    x, y, z = limits[1] - limits[0]
    right = max(y, 0.7 * x)
    scale = min(0.85 * WIDTH / (x + right), _MOST_HEIGHT / (y + z))
    upper = max(scale * y, _LEAST_HEIGHT)
    figure = new_figure(upper + scale * z + 1.4)
    panels: dict[str, Any] = figure.subplot_mosaic(
        [["from above", "space"], ["from the front", "from the side"]],
        width_ratios=[x, right],
        height_ratios=[upper, scale * z],
        per_subplot_kw={"space": {"projection": "3d"}},
    )

    numbered = c.fit.measurements.validation | c.rows.flagged
    pixels = len(places) > MOST_SHAPES
    kinds = row_kinds(c)
    for i, j, name in VIEWS:
        ax = panels[name]
        ax.set_title(f"Seen {name}")
        for order, kind in enumerate(kinds, start=2):
            at = places[kind.mask][:, [i, j]].T
            ax.plot(*at, rasterized=pixels, zorder=order, **kind.style(0.85))
        set_view(ax, limits, (i, j))
        number_points(ax, c.fit.measurements.rows, places[:, [i, j]], numbered)

    ax = panels["space"]
    for kind in kinds:
        ax.plot(*places[kind.mask].T, rasterized=pixels, **kind.style())
    ax.set_box_aspect(limits[1] - limits[0], zoom=0.85)
    ax.set(xlim=limits[:, 0], ylim=limits[:, 1], zlim=limits[:, 2], title="In space, base frame")
    ax.title.set_y(1.0)  # axes in space put it lower, into the picture
    for letter, axis in zip("xyz", (ax.xaxis, ax.yaxis, ax.zaxis), strict=True):
        axis.set_label_text(f"{letter} [mm]")
        axis.labelpad = 1.5
        axis.set_major_locator(few_ticks(4))
    ax.tick_params(labelsize=7.5, pad=1)
    ax.view_init(elev=20, azim=-62)
    legend_above(figure)
    return figure


def uncertainty(c: Calibration) -> Figure:
    """Draw the expanded uncertainty of predicted positions over the joint limits: three views, and its distribution."""
    shown = uncertainty_map(c, POSES)
    places = 1e3 * shown.places
    expanded = 1e3 * shown.position
    limits = view_limits(places)
    measured = 1e3 * measured_places(c)
    measured = measured[:: 1 + len(measured) // _MEASURED_POINTS]

    figure = new_figure(6.2)
    *views, last = figure.subplots(2, 2).ravel()
    ring: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 3.0, "mfc": "white", "mew": 0.6}
    cells = []
    for ax, (i, j, name) in zip(views, VIEWS, strict=True):
        cells.append(_draw_cells(ax, places[:, [i, j]], expanded, limits[:, [i, j]]))
        ax.plot(*measured[:, [i, j]].T, mec=INK, label="measured rows", **ring)
        ax.set_title(f"Seen {name}")
        set_view(ax, limits, (i, j))

    # One scale of colours, on which a single cell does not make all others alike.
    values = np.concatenate([np.asarray(of_view.get_array()) for of_view in cells])
    low = float(values.min())
    high = float(np.quantile(values, 0.98))
    for of_view in cells:
        of_view.set_clim(low, max(high, 1.01 * low + 1e-9))
    bar = figure.colorbar(cells[1], ax=views[1], shrink=0.95, pad=0.02, extend="max")
    bar.set_label("U [mm]")

    # The share of poses below each uncertainty, with that of the measured poses.
    last.ecdf(expanded, color=INK, lw=1.4)
    q = c.fit.measurements.joints_for(c.nominal.joint_names)[c.rows.estimation]
    at_measured = 1e3 * c.uncertainty(q[:: 1 + len(q) // POSES], non_geometric=False).position
    lines = (
        (float(np.median(at_measured)), ":", "median, measured poses"),
        (float(np.median(expanded)), "--", "median, joint limits"),
        (float(np.quantile(expanded, 0.95)), "-.", "95 % of the joint limits"),
    )
    for value, style, meaning in lines:
        label = f"{value:.3f} mm: {meaning}"
        last.vlines(value, 0, 1, colors=SOFT, ls=style, lw=1.1, label=label)
    nearly_largest = float(np.quantile(expanded, 0.99))
    last.set_xlim(0.0, 1.08 * max(nearly_largest, float(np.median(at_measured)), 1e-9))
    last.set_ylim(0.0, 1.45)  # room for the legend above the curve
    last.set_yticks(np.linspace(0.0, 1.0, 6), [f"{share}" for share in range(0, 101, 20)])
    last.set(xlabel="U [mm]", ylabel="poses below [%]")
    last.set_title("Distribution over the joint limits")
    last.legend(loc="upper left", fontsize=7.5)
    legend_above(figure)
    return figure


def _draw_cells(ax: Axes, places: Array, expanded: Array, limits: Array) -> Any:  # noqa: ANN401  a collection of matplotlib
    """Draw the rms of uncertainties (N,) [mm] at places (N, 2) [mm] in each hexagon of a view; return hexagons.

    The view's least and greatest corner are ``limits``, (2, 2) [mm].
    """
    from matplotlib.colors import LinearSegmentedColormap

    size = limits[1] - limits[0]
    across, up = _CELLS * size / np.max(size)
    columns = max(int(across), 4)
    rows = max(int(up / np.sqrt(3.0)), 3)
    return ax.hexbin(
        places[:, 0],
        places[:, 1],
        C=expanded**2,
        reduce_C_function=lambda squares: float(np.sqrt(np.mean(squares))),
        gridsize=(columns, rows),
        extent=limits.T.ravel().tolist(),
        cmap=LinearSegmentedColormap.from_list("uncertainty", list(SURE_TO_UNSURE)),
        linewidths=0.15,
        edgecolors="face",
        zorder=2,
    )
