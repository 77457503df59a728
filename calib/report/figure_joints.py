"""The figure of the residuals against each joint's value: a slope or a wave is an error of that joint."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import calib.report.figure_base as base
from calib.data.measurements import Measurements
from calib.report.row_values import flagged_rows, setup_of_rows
from calib.result.calibration import CalibrationValues
from calib.units import Array, Mask

#: Step of the central differences in a joint's value [rad or m].
_STEP = 1e-6

#: A joint that moves the target less than this has no direction at a row [m/rad or m/m].
_LEAST_LEVER = 2e-3

#: The running mean is drawn from so many rows on.
_FEWEST_ROWS = 24

#: The running mean is over so many runs of rows at most.
_MOST_RUNS = 12

#: Rows of a run at least.
_ROWS_PER_RUN = 8


def has_joint_parts(c: CalibrationValues) -> Mask:
    """Return the rows whose residual has a part along joints' motions, shape (N,).

    A length between two rows belongs to both poses, so it has none.
    """
    return np.asarray(c.used[:, 0] & ~c.measurements.of_kind("pair"))


def residuals_by_joint(c: CalibrationValues) -> Figure:
    """Draw the part of each residual along the motion of the target by each joint, over the joint's value.

    See `along_joints`; a panel for each joint.
    """
    names = base.short_names(c.nominal.joint_names)
    count = len(names)
    columns = 2 if count in (2, 4) else min(count, 3)
    lines = math.ceil(count / columns)
    figure = base.new_figure(1.65 * lines + 0.6)
    panels = figure.subplots(lines, columns, squeeze=False, sharey=True)
    for empty in panels.ravel()[count:]:
        empty.remove()
    parts = 1e3 * along_joints(c)
    parts[~has_joint_parts(c)] = np.nan
    largest = float(np.nanmax(np.abs(parts[~flagged_rows(c)]), initial=0.0))
    reach = max(1.15 * largest, 1e-3)
    for j, ax in enumerate(panels.ravel()[:count]):
        _joint_panel(ax, c, j, parts[:, j], reach)
        ax.set_title(names[j], size=8.5)
    for ax in panels[:, 0]:
        ax.set_ylabel("residual [mm]")
    base.legend_above(figure)
    return figure


def _joint_panel(ax: Axes, c: CalibrationValues, j: int, parts: Array, reach: float) -> None:
    """Draw the panel of one joint.

    Args:
        ax: The panel.
        c: The result.
        j: The joint's index among the robot's inputs.
        parts: shape (N,), parts of the residuals along its motion [mm]; NaN where a row has none.
        reach: Largest part drawn [mm]; parts beyond stand at the edge.
    """
    is_prismatic = c.nominal.inputs[j].type == "prismatic"
    scale, unit = (1e3, "mm") if is_prismatic else (np.degrees(1.0), "deg")
    joints = c.measurements.joints_for(c.nominal.joint_names)
    values = scale * joints[:, j]
    as_pixels = len(values) > base.MOST_SHAPES
    ax.axhline(0.0, color=base.INK, lw=0.7, zorder=1.5)
    for kind in base.row_kinds(c):
        if np.any(kind.mask & has_joint_parts(c)):
            shown = np.clip(parts[kind.mask], -reach, reach)
            ax.plot(values[kind.mask], shown, rasterized=as_pixels, zorder=2, **kind.style(0.8))
    fitted = c.measurements.estimation & has_joint_parts(c) & ~flagged_rows(c)
    has_part = np.isfinite(parts[fitted])
    if np.count_nonzero(has_part) >= _FEWEST_ROWS:
        _running_mean(ax, values[fitted], parts[fitted])
    ax.set_ylim(-1.08 * reach, 1.08 * reach)
    ax.set_xlabel(f"joint value [{unit}]")
    ax.xaxis.set_major_locator(base.few_ticks(4))


def along_joints(c: CalibrationValues) -> Array:
    """Project each row's calibrated residual onto the motion of the target by each joint.

        part_ij = r_i . g_ij / |g_ij|,    g_ij = d p_i / d q_ij

    with the residual r_i, measured minus predicted, and the predicted position p_i in the measurement frame. Of a
    distance the part of g along the beam counts, of a plane that along its normal.

    Args:
        c: The result, with N rows of m joint values.

    Returns:
        shape (N, m), [m], signed; NaN where the joint moves the target less than 2 mm/rad.
    """
    m = c.measurements
    q = m.joints_for(c.nominal.joint_names)
    positions = _predicted_positions(c, q)
    residual = np.where(c.used, c.residual_calibrated, 0.0)[:, :3]
    parts = np.full(q.shape, np.nan)
    for j, step in enumerate(_STEP * np.eye(q.shape[1])):
        change = _predicted_positions(c, q + step) - _predicted_positions(c, q - step)
        motion = _measured_motion(m, positions, change / (2.0 * _STEP))
        parts[:, j] = _parts_along(residual, motion[:, : residual.shape[1]])
    return parts


def _parts_along(residual: Array, motion: Array) -> Array:
    """Return the part of each row's residual along the motion of the target by a joint.

    Args:
        residual: shape (N, D), measured minus predicted [m]; 0 where nothing was measured.
        motion: shape (N, D), of what is measured per unit of the joint's value [m/rad] or [m/m].

    Returns:
        shape (N,), [m], signed; NaN where the joint moves the target less than 2 mm/rad.
    """
    lever = np.linalg.norm(motion, axis=1)
    part = np.sum(residual * motion, axis=1) / np.maximum(lever, 1e-12)
    return np.where(lever > _LEAST_LEVER, part, np.nan)


def _predicted_positions(c: CalibrationValues, q: Array) -> Array:
    """Return the predicted positions (N, 3) of the target in the measurement frame [m] at joint values (N, m)."""
    T_frame_base, T_tip_target = setup_of_rows(c.setup, c.measurements)
    T_frame_target = T_frame_base @ c.robot.poses(q) @ T_tip_target
    return np.asarray(T_frame_target[:, :3, 3])


def _measured_motion(m: Measurements, positions: Array, motion: Array) -> Array:
    """Reduce motions of the target to what the rows measure.

    Args:
        m: N rows.
        positions: shape (N, 3), the target in the measurement frame [m].
        motion: shape (N, 3), its motion per unit of a joint's value.

    Returns:
        shape (N, 3): of distances the component along the beam, of planes that along z, in the first column; of other
        rows the motion.
    """
    distances = np.linalg.norm(positions, axis=1, keepdims=True)
    beam = positions / np.maximum(distances, 1e-12)
    is_distance = m.of_kind("distance")
    is_plane = m.of_kind("plane")
    reduced: Array = motion.copy()
    reduced[is_distance, 0] = np.sum(beam[is_distance] * motion[is_distance], axis=1)
    reduced[is_plane, 0] = motion[is_plane, 2]
    reduced[is_distance | is_plane, 1:] = 0.0
    return reduced


def _running_mean(ax: Axes, values: Array, parts: Array) -> None:
    """Draw the mean over runs of rows neighbouring in the joint's value, and twice its standard error about it.

    Args:
        ax: The panel.
        values: shape (K,), joint values in the panel's unit.
        parts: shape (K,), parts of the residuals [mm]; NaN where a row has none.
    """
    order = np.argsort(values, kind="stable")
    order = order[np.isfinite(parts[order])]
    count = min(len(order) // _ROWS_PER_RUN, _MOST_RUNS)
    runs = np.array_split(order, count)
    x = np.array([np.mean(values[run]) for run in runs])
    mean = np.array([np.mean(parts[run]) for run in runs])
    standard_error = np.array([np.std(parts[run], ddof=1) / np.sqrt(len(run)) for run in runs])
    low = mean - 2 * standard_error
    high = mean + 2 * standard_error
    look: dict[str, Any] = {"color": base.CALIBRATED, "zorder": 3}
    label = "mean of the estimation rows ± 2 standard errors"
    ax.fill_between(x, low, high, alpha=0.45, lw=0, label=label, **look)
    ax.plot(x, mean, lw=1.3, **look)
