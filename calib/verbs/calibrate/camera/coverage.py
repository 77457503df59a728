"""Figures of what images cover: the image's area, tilts and distances of the board, and the joints' ranges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import calib.show.figure_base as base
from calib.basics.arrays import Array
from calib.verbs.calibrate.camera.of_calibration import JointSpan
from calib.verbs.calibrate.camera.panels import WIDTH, image_panel
from calib.verbs.calibrate.camera.seen_corners import SeenCorners, board_views

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Cells across an image.
_CELLS = 12

#: Rings of the polar plot of tilts [deg].
_RINGS = (15, 30, 45, 60)

#: A span from here on is written without decimals [deg] or [mm].
_WIDE_SPAN = 10.0

#: Bars of the histogram of distances, at most.
_BARS = 12


def of_images(cameras: Sequence[SeenCorners]) -> Figure:
    """Draw, for each camera, the density of corners over the image, the boards' tilts, and their distances.

    Args:
        cameras: The corners that each camera saw.
    """
    heights = [0.82 * WIDTH * seen.size[1] / seen.size[0] + 0.5 for seen in cameras]
    figure = base.new_figure(sum(heights) + 2.7 * len(cameras), WIDTH)
    parts: Any = figure.subfigures(len(cameras), 1, squeeze=False)
    for part, seen, height in zip(parts[:, 0], cameras, heights, strict=True):
        upper, lower = part.subfigures(2, 1, height_ratios=[height, 2.7])
        _draw_density(upper.subplots(), seen)
        _draw_tilts(lower.add_subplot(1, 2, 1, projection="polar"), seen)
        _draw_distances(lower.add_subplot(1, 2, 2), seen)
    return figure


def density(seen: SeenCorners) -> tuple[Array, Array, Array]:
    """Count the corners in square cells of the image.

    Returns:
        shape (rows, columns), the counts; and the edges of the cells along u and along v [px]. Cells at the right and
        at the foot may be cut by the image's edge.
    """
    width, height = seen.size
    edge = width / _CELLS
    along_u = np.linspace(-0.5, width - 0.5, _CELLS + 1)
    along_v = np.append(np.arange(-0.5, height - 0.5 - 0.2 * edge, edge), height - 0.5)
    counts, _, _ = np.histogram2d(seen.measured[:, 1], seen.measured[:, 0], [along_v, along_u])
    return counts, along_u, along_v


def _draw_density(ax: Axes, seen: SeenCorners) -> None:
    """Draw the number of corners in each cell of the image, and cross out cells without any."""
    from matplotlib.colors import LinearSegmentedColormap

    counts, along_u, along_v = density(seen)
    share = np.mean(counts == 0.0)
    image_panel(
        ax,
        seen.size,
        f"{seen.label}: corners over the image, {100 * share:.0f} % of the cells empty",
    )
    colours = LinearSegmentedColormap.from_list("density", base.LITTLE_TO_MUCH)
    shown = np.ma.masked_equal(counts, 0.0)
    top = max(1.0, float(counts.max()))
    look: dict[str, Any] = {"edgecolors": "white", "linewidth": 0.5}
    drawn = ax.pcolormesh(along_u, along_v, shown, cmap=colours, vmin=0.0, vmax=top, **look)
    _cross_out(ax, counts, along_u, along_v)
    bar = ax.figure.colorbar(drawn, ax=ax, shrink=0.9, pad=0.02, aspect=28)
    bar.set_label("corners in a cell")
    bar.locator = base.few_ticks(5, integers=True)
    bar.outline.set_visible(False)


def _cross_out(ax: Axes, counts: Array, along_u: Array, along_v: Array) -> None:
    """Draw a cross in each cell without corners."""
    rows, columns = np.nonzero(counts == 0.0)
    u = 0.5 * (along_u[columns] + along_u[columns + 1])
    v = 0.5 * (along_v[rows] + along_v[rows + 1])
    ax.plot(u, v, ls="none", marker="x", ms=6.0, mew=1.0, color=base.SOFT)


def _draw_tilts(ax: Any, seen: SeenCorners) -> None:  # noqa: ANN401  matplotlib's polar axes, which have no types
    """Draw the tilt of the board in each image, in the direction to which it faces as the image shows it."""
    views = board_views(seen)
    tilt = np.degrees(views.tilt)
    ax.set_theta_direction(-1)  # rows of an image go down
    ax.plot(
        views.facing,
        tilt,
        ls="none",
        marker="o",
        ms=4.0 if len(tilt) <= 100 else 2.4,
        color=base.CALIBRATED,
        mec="white",
        mew=0.4,
    )
    ax.set_ylim(0.0, max(_RINGS[1], _ring_above(float(tilt.max(initial=0.0)))))
    rings = [ring for ring in (*_RINGS, 90) if ring <= ax.get_ylim()[1]]
    ax.set_yticks(rings, [f"{ring}°" for ring in rings])
    ax.set_rlabel_position(60)
    ax.set_xticks(np.radians([0, 90, 180, 270]), ["right", "down", "left", "up"])
    ax.tick_params(pad=0)
    ax.set_title(f"Tilt: {tilt.min():.0f} to {tilt.max():.0f}°", pad=17.0)


def _ring_above(tilt: float) -> int:
    """Return the next ring above a tilt [deg]."""
    return next((ring for ring in _RINGS if ring >= tilt), 90)


def _draw_distances(ax: Axes, seen: SeenCorners) -> None:
    """Draw the distribution of the boards' distances from the camera."""
    distance = 1e3 * board_views(seen).distance
    low, high = float(distance.min()), float(distance.max())
    bars = int(np.clip(np.sqrt(len(distance)) * 1.5, 4, _BARS))
    ax.hist(distance, bars, **base.AFTER.area)
    ax.set(
        title=f"Distance: ratio {high / low:.2f}",
        xlabel="board from the camera [mm]",
        ylabel="images",
    )
    ax.yaxis.set_major_locator(base.few_ticks(5, integers=True))
    ax.xaxis.set_major_locator(base.few_ticks(4))


def of_joints(joints: Sequence[JointSpan]) -> Figure:
    """Draw the values of each joint in the images, and the span of them, between its limits.

    Args:
        joints: The joints, from the base to the tip.
    """
    figure = base.new_figure(0.34 * len(joints) + 0.95, WIDTH)
    ax = figure.subplots()
    names = base.short_names([joint.name for joint in joints], 20)
    labels = []
    for k, (joint, name) in enumerate(zip(joints, names, strict=True)):
        _draw_span(ax, k, joint)
        labels.append(name)
    ax.set_yticks(range(len(joints)), labels)
    ax.set(
        ylim=(len(joints) - 0.4, -0.6),
        xlim=(-4.0, 134.0),
        xlabel="part of the range between the joint's limits [%]",
    )
    ax.set_xticks([0, 25, 50, 75, 100])
    ax.grid(visible=False, axis="y")
    return figure


def _draw_span(ax: Axes, row: int, joint: JointSpan) -> None:
    """Draw one joint: its range as a pale bar, its span in the images in colour, each value as a line."""
    low, high = float(joint.values.min()), float(joint.values.max())
    lower, upper = joint.limits
    ax.text(102.0, row, _span_text(joint), va="center", size=7.5, color=base.INK)
    if not upper > lower:  # NaN: a joint without limits
        turn = 1.0 if joint.slides else 2.0 * np.pi
        lower = 0.5 * (low + high) - 0.5 * max(turn, high - low)
        upper = lower + max(turn, high - low)
    part = 100.0 * (np.array([low, high, *joint.values]) - lower) / (upper - lower)
    ax.barh(row, 100.0, height=0.62, color="#e6ebf0")
    ax.barh(row, part[1] - part[0], left=part[0], height=0.62, color=base.CALIBRATED, alpha=0.45)
    ax.vlines(part[2:], row - 0.31, row + 0.31, color=base.INK, lw=0.7, alpha=0.8)


def _span_text(joint: JointSpan) -> str:
    """Word the least and the greatest value of a joint: ``-27 to 94°``."""
    scale, unit = (1e3, " mm") if joint.slides else (float(np.degrees(1.0)), "°")
    low, high = scale * joint.values.min(), scale * joint.values.max()
    digits = 0 if high - low >= _WIDE_SPAN else 1
    return f"{round(low, digits) + 0.0:.{digits}f} to {round(high, digits) + 0.0:.{digits}f}{unit}"
