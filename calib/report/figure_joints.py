"""What is left over along each joint's motion, against the joint's value."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import calib.report.figure_base as base
import calib.report.label_rows as labels
from calib.result.calibration import Calibration

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: A step that derivatives are taken with [rad] or [m]; a joint that moves the target less has no direction [m/rad].
_STEP, _NO_LEVER = 1e-6, 2e-3

#: The mean over runs of rows is drawn from so many rows on, over so many runs at most.
_FEWEST_ROWS, _MOST_RUNS = 24, 12


def tells_of_joints(c: Calibration) -> Mask:
    """The rows whose residual lies along joints' motions, shape (N,); lengths between two rows belong to both."""
    return np.asarray(c.used[:, 0] & ~c.measurements.of_kind("pair"))


@base.figure(
    "residual-by-joint",
    "errors",
    "Residuals against each joint's value",
    "The part of each row's error after calibration that lies along the joint's motion of the target, [mm], against "
    "the joint's value, [deg] or [mm], of {rows}. Line and band: mean of the estimation rows without outliers over "
    f"runs of neighbouring joint values, ± 2 standard errors. {base.EDGE} A slope or a wave is an error of that joint "
    "that the model lacks, such as of its gear.",
    lambda c: bool(np.any(tells_of_joints(c))),
)
def joints(c: Calibration) -> Figure:
    """The part r.g / |g| of each residual r, g the derivative of the predicted position by the joint's value."""
    chosen, flagged = tells_of_joints(c), labels.flagged_rows(c)
    parts = 1e3 * along_joints(c)
    parts[~chosen] = np.nan
    q = c.measurements.joints_for(c.nominal.joint_names)
    fitted = c.measurements.estimation & chosen & ~flagged
    kinds = [kind for kind in base.row_kinds(c) if np.any(kind.mask & chosen)]
    names = base.short_names(c.nominal.joint_names)
    columns = 2 if len(names) in (2, 4) else min(len(names), 3)
    drawn = base.new_figure(1.65 * -(-len(names) // columns) + 0.6)
    grid = -(-len(names) // columns), columns
    panels = drawn.subplots(*grid, squeeze=False, sharey=True)
    reach = max(1.15 * float(np.nanmax(np.abs(parts[~flagged]), initial=0.0)), 1e-3)
    for ax in panels.ravel()[len(names) :]:
        ax.set_visible(False)
    for j, (ax, joint) in enumerate(zip(panels.ravel(), c.nominal.inputs, strict=False)):
        scale, unit = (1e3, "mm") if joint.type == "prismatic" else (np.degrees(1.0), "deg")
        ax.axhline(0.0, color=labels.INK, lw=0.7, zorder=1.5)
        for kind in kinds:
            at = np.clip(parts[kind.mask, j], -reach, reach)
            pixels = len(q) > base.MOST_SHAPES
            ax.plot(scale * q[kind.mask, j], at, rasterized=pixels, zorder=2, **kind.style(0.8))
        if np.all(np.isnan(parts[:, j])):
            word = "does not move the target"
            ax.text(0.5, 0.7, word, transform=ax.transAxes, ha="center", color=labels.SOFT)
        elif np.count_nonzero(fitted) >= _FEWEST_ROWS:
            _mean(ax, scale * q[fitted, j], parts[fitted, j])
        ax.set_ylim(-1.08 * reach, 1.08 * reach)
        ax.set_title(names[j], size=8.5)
        ax.set_xlabel(f"joint value [{unit}]")
        ax.xaxis.set_major_locator(base.few_ticks(4))
    for ax in panels[:, 0]:
        ax.set_ylabel("residual [mm]")
    handles: list[Any] = [kind.handle() for kind in kinds]
    if np.count_nonzero(fitted) >= _FEWEST_ROWS:
        label = "mean of the estimation rows ± 2 standard errors"
        handles.append(base.area(label, facecolor=labels.CALIBRATED, alpha=0.4))
    base.legend_above(drawn, handles)
    return drawn


def along_joints(c: Calibration) -> Array:
    """The part of each row's residual along each joint's motion of the target, shape (N, m), [m]; NaN without one."""
    m = c.measurements
    q = m.joints_for(c.nominal.joint_names)
    T_frame_base, T_tip_target = labels.placed(c.setup, m)

    def places(q: Array) -> Array:
        """Predicted positions in the measurement frame."""
        points = labels.target_places(c, q, T_tip_target)
        return np.asarray(
            np.einsum("nij,nj->ni", T_frame_base[:, :3, :3], points) + T_frame_base[:, :3, 3]
        )

    at = places(q)
    # Of a distance the part along the beam counts, of a plane that along its normal.
    beam = at / np.maximum(np.linalg.norm(at, axis=1, keepdims=True), 1e-12)
    distance, plane = m.of_kind("distance"), m.of_kind("plane")
    residual = np.where(c.used, c.residual_calibrated, 0.0)[:, :3]
    result = np.full(q.shape, np.nan)
    for j, step in enumerate(_STEP * np.eye(q.shape[1])):
        move = (places(q + step) - places(q - step)) / (2.0 * _STEP)
        move[distance, 0] = np.sum(beam[distance] * move[distance], axis=1)
        move[plane, 0] = move[plane, 2]
        move[distance | plane, 1:] = 0.0
        move = move[:, : residual.shape[1]]
        length = np.linalg.norm(move, axis=1)
        part = np.sum(residual * move, axis=1) / np.maximum(length, 1e-12)
        result[:, j] = np.where(length > _NO_LEVER, part, np.nan)
    return result


def _mean(ax: Axes, at: Array, parts: Array) -> None:
    """The mean over runs of rows that are neighbours in the joint's value, twice its standard error about it."""
    order = np.argsort(at[np.isfinite(parts)], kind="stable")
    at, parts = at[np.isfinite(parts)][order], parts[np.isfinite(parts)][order]
    count = min(len(at) // 8, _MOST_RUNS)
    runs = list(zip(np.array_split(at, count), np.array_split(parts, count), strict=True))
    x, mean = np.array([(np.mean(q), np.mean(p)) for q, p in runs]).T
    error = np.array([np.std(p, ddof=1) / np.sqrt(len(p)) for _, p in runs])
    look: dict[str, Any] = {"color": labels.CALIBRATED, "zorder": 3}
    ax.fill_between(x, mean - 2 * error, mean + 2 * error, alpha=0.45, lw=0, **look)
    ax.plot(x, mean, lw=1.3, **look)
