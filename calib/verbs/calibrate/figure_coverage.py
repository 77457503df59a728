"""Figures of what images cover: the image's area, tilts and distances of the board, and the joints' ranges."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.basics.arrays import Array
from calib.result.calibration import Calibration
from calib.show.look import AFTER, CALIBRATED, INK, LITTLE_TO_MUCH, SOFT, short_names
from calib.show.plotting import few_ticks, new_figure
from calib.show.words import joint_unit
from calib.verbs.calibrate.figure_images import IMAGE_WIDTH, image_panel
from calib.verbs.calibrate.seen_corners import SeenCorners, image_rows, seen_corners

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


def image_coverage(c: Calibration) -> Figure:
    """Draw, for each camera, the density of corners over the image, the boards' tilts, and their distances."""
    cameras = seen_corners(c)
    heights = [0.82 * IMAGE_WIDTH * seen.size[1] / seen.size[0] + 0.5 for seen in cameras]
    figure = new_figure(sum(heights) + 2.7 * len(cameras), IMAGE_WIDTH)
    parts: Any = figure.subfigures(len(cameras), 1, squeeze=False)
    for part, seen, height in zip(parts[:, 0], cameras, heights, strict=True):
        upper, lower = part.subfigures(2, 1, height_ratios=[height, 2.7])
        _draw_density(upper.subplots(), seen)
        tilt, facing, distance = seen.board_views()
        _draw_tilts(lower.add_subplot(1, 2, 1, projection="polar"), np.degrees(tilt), facing)

        ax = lower.add_subplot(1, 2, 2)
        bars = int(np.clip(np.sqrt(len(distance)) * 1.5, 4, _BARS))
        ax.hist(1e3 * distance, bars, **AFTER.area)
        ratio = float((1e3 * distance).max()) / float((1e3 * distance).min())
        ax.set(
            title=f"Distance: ratio {ratio:.2f}",
            xlabel="board from the camera [mm]",
            ylabel="images",
        )
        ax.yaxis.set_major_locator(few_ticks(5, integers=True))
        ax.xaxis.set_major_locator(few_ticks(4))
    return figure


def corner_density(seen: SeenCorners) -> tuple[Array, Array, Array]:
    """Count the corners in square cells of the image.

    Args:
        seen: The corners that a camera saw.

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

    counts, along_u, along_v = corner_density(seen)
    share = np.mean(counts == 0.0)
    title = f"{seen.label}: corners over the image, {100 * share:.0f} % of the cells empty"
    image_panel(ax, seen.size, title)
    colours = LinearSegmentedColormap.from_list("density", LITTLE_TO_MUCH)
    shown = np.ma.masked_equal(counts, 0.0)
    top = max(1.0, float(counts.max()))
    look: dict[str, Any] = {"edgecolors": "white", "linewidth": 0.5}
    drawn = ax.pcolormesh(along_u, along_v, shown, cmap=colours, vmin=0.0, vmax=top, **look)

    rows, columns = np.nonzero(counts == 0.0)
    u = 0.5 * (along_u[columns] + along_u[columns + 1])
    v = 0.5 * (along_v[rows] + along_v[rows + 1])
    ax.plot(u, v, ls="none", marker="x", ms=6.0, mew=1.0, color=SOFT)

    bar = ax.figure.colorbar(drawn, ax=ax, shrink=0.9, pad=0.02, aspect=28)
    bar.set_label("corners in a cell")
    bar.locator = few_ticks(5, integers=True)
    bar.outline.set_visible(False)


def _draw_tilts(ax: Any, tilt: Array, facing: Array) -> None:  # noqa: ANN401  matplotlib's polar axes have no types
    """Draw the board's tilt in V views, (V,) [deg], in the direction to which it faces in the image, (V,) [rad].

    Directions count from right over down.
    """
    size = 4.0 if len(tilt) <= 100 else 2.4
    look: dict[str, Any] = {"ls": "none", "marker": "o", "ms": size, "mec": "white", "mew": 0.4}
    ax.set_theta_direction(-1)  # rows of an image go down
    ax.plot(facing, tilt, color=CALIBRATED, **look)
    largest = float(tilt.max(initial=0.0))
    ring_above = next((ring for ring in _RINGS if ring >= largest), 90)
    ax.set_ylim(0.0, max(_RINGS[1], ring_above))
    rings = [ring for ring in (*_RINGS, 90) if ring <= ax.get_ylim()[1]]
    ax.set_yticks(rings, [f"{ring}°" for ring in rings])
    ax.set_rlabel_position(60)
    ax.set_xticks(np.radians([0, 90, 180, 270]), ["right", "down", "left", "up"])
    ax.tick_params(pad=0)
    ax.set_title(f"Tilt: {tilt.min():.0f} to {tilt.max():.0f}°", pad=17.0)


def joint_coverage(c: Calibration) -> Figure:
    """Draw the values of each joint in the fitted images, or in all if none was fitted, between the joint's limits."""
    m = c.fit.measurements
    chosen = image_rows(c) & m.estimation
    if not np.any(chosen):
        chosen = image_rows(c)
    q = m.joints_for(c.nominal.joint_names)[chosen]
    values_of_joints = c.nominal.input_values(np.unique(q, axis=0)).T
    joints = list(zip(c.nominal.inputs, values_of_joints, strict=True))
    # A chain from a camera on the hand to the board has them from the hand to the base.
    order = [joint.name for joint in c.nominal.urdf.joints]
    joints.sort(key=lambda pair: order.index(pair[0].name))

    figure = new_figure(0.34 * len(joints) + 0.95, IMAGE_WIDTH)
    ax = figure.subplots()
    for row, (joint, values) in enumerate(joints):
        slides = joint.type == "prismatic"
        low, high = float(values.min()), float(values.max())
        lower = math.nan if joint.lower is None else joint.lower
        upper = math.nan if joint.upper is None else joint.upper
        if not upper > lower:  # NaN: a joint without limits
            turn = 1.0 if slides else 2.0 * np.pi
            lower = 0.5 * (low + high) - 0.5 * max(turn, high - low)
            upper = lower + max(turn, high - low)
        part = 100.0 * (np.array([low, high, *values]) - lower) / (upper - lower)
        span = {"left": part[0], "height": 0.62, "color": CALIBRATED, "alpha": 0.45}
        ax.text(102.0, row, _span_text(low, high, slides=slides), va="center", size=7.5, color=INK)
        ax.barh(row, 100.0, height=0.62, color="#e6ebf0")
        ax.barh(row, part[1] - part[0], **span)
        ax.vlines(part[2:], row - 0.31, row + 0.31, color=INK, lw=0.7, alpha=0.8)
    ax.set_yticks(range(len(joints)), short_names([joint.name for joint, _ in joints], 20))
    ax.set(
        ylim=(len(joints) - 0.4, -0.6),
        xlim=(-4.0, 134.0),
        xlabel="part of the range between the joint's limits [%]",
    )
    ax.set_xticks([0, 25, 50, 75, 100])
    ax.grid(visible=False, axis="y")
    return figure


def _span_text(low: float, high: float, *, slides: bool) -> str:
    """Word the least and the greatest value of a joint, [rad], or [m] if it slides: ``-27 to 94°``, ``5 to 80 mm``."""
    factor, unit = joint_unit(prismatic=slides)
    low, high = factor * low, factor * high
    digits = 0 if high - low >= _WIDE_SPAN else 1
    symbol = "°" if unit == "deg" else f" {unit}"
    return (
        f"{round(low, digits) + 0.0:.{digits}f} to {round(high, digits) + 0.0:.{digits}f}{symbol}"
    )
