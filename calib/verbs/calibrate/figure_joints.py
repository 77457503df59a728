"""The figure of the residuals against each joint's value: a slope or a wave is an error of that joint."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.calibration import Calibration
from calib.show.look import CALIBRATED, INK, row_kinds, short_names
from calib.show.measured_rows import setup_of_rows
from calib.show.plotting import MOST_SHAPES, few_ticks, legend_above, new_figure
from calib.show.words import joint_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Step of the central differences in a joint's value [rad or m].
_STEP = 1e-6

#: A joint that changes the lengths of a row by less than this has no direction there [m/rad or m/m].
_LEAST_LEVER = 2e-3

#: The running mean is drawn from so many rows on.
_FEWEST_ROWS = 24

#: The running mean is over so many runs of rows at most.
_MOST_RUNS = 12

#: Rows of a run at least.
_ROWS_PER_RUN = 8


def has_joint_parts(c: Calibration) -> Mask:
    """Return the rows whose residual has a part along joints' motions, shape (N,): those that measure a length.

    A length between two rows belongs to both poses, so it has none.
    """
    measures_length = np.any(c.rows.channels.where("m"), axis=1)
    return np.asarray(measures_length & ~c.fit.measurements.of_kind("pair"))


def residuals_by_joint(c: Calibration) -> Figure:
    """Draw the part of each residual along the motion of the target by each joint, over the joint's value.

    See `along_joints`; a panel for each joint.
    """
    names = short_names(c.nominal.joint_names)
    count = len(names)
    columns = 2 if count in (2, 4) else min(count, 3)
    lines = math.ceil(count / columns)
    figure = new_figure(1.65 * lines + 0.6)
    panels = figure.subplots(lines, columns, squeeze=False, sharey=True)
    for empty in panels.ravel()[count:]:
        empty.remove()
    parts = 1e3 * along_joints(c)
    parts[~has_joint_parts(c)] = np.nan
    largest = float(np.nanmax(np.abs(parts[~c.rows.flagged]), initial=0.0))
    reach = max(1.15 * largest, 1e-3)
    readings = c.fit.measurements.joints_for(c.nominal.joint_names)
    values_of_joints = c.nominal.input_values(readings)
    as_pixels = len(readings) > MOST_SHAPES
    fitted = c.fit.measurements.estimation & has_joint_parts(c) & ~c.rows.flagged
    for j, ax in enumerate(panels.ravel()[:count]):
        scale, unit = joint_unit(prismatic=c.nominal.inputs[j].type == "prismatic")
        values = scale * values_of_joints[:, j]
        ax.axhline(0.0, color=INK, lw=0.7, zorder=1.5)
        for kind in row_kinds(c):
            if np.any(kind.mask & has_joint_parts(c)):
                # Parts beyond the reach are drawn at the edge.
                shown = np.clip(parts[kind.mask, j], -reach, reach)
                ax.plot(values[kind.mask], shown, rasterized=as_pixels, zorder=2, **kind.style(0.8))
        has_part = np.isfinite(parts[fitted, j])
        if np.count_nonzero(has_part) >= _FEWEST_ROWS:
            _running_mean(ax, values[fitted], parts[fitted, j])
        ax.set_ylim(-1.08 * reach, 1.08 * reach)
        ax.set_xlabel(f"joint value [{unit}]")
        ax.xaxis.set_major_locator(few_ticks(4))
        ax.set_title(names[j], size=8.5)
    for ax in panels[:, 0]:
        ax.set_ylabel("residual [mm]")
    legend_above(figure)
    return figure


def along_joints(c: Calibration) -> Array:
    """Project each row's residual lengths onto the change of the predicted lengths by each joint.

        part_ij = r_i . g_ij / |g_ij|,    g_ij = d m_i / d q_ij

    with the residual r_i, measured minus predicted, and the prediction m_i, of the lengths that row i measures: the
    three coordinates of a point, the distance along a beam, or the lengths of a kind of your own.

    Args:
        c: The result, with N rows of m joint values.

    Returns:
        shape (N, m), [m], signed; NaN if the joint changes the lengths of the row by less than `_LEAST_LEVER`
            a unit.
    """
    rows, _ = rows_and_setup(c.nominal, c.fit.measurements, c.fit.cell)
    T_frame_base, T_tip_target = setup_of_rows(c.setup, c.fit.measurements)
    are_lengths = c.rows.channels.where("m")

    def lengths(values: Array) -> Array:
        """Residual lengths, shape (N, D), at joint values (N, m); 0 of the other scalars."""
        T_base_tip = c.robot.poses(c.robot.readings(values), rows.samples.chain)
        residual = rows.residual(T_frame_base @ T_base_tip @ T_tip_target)
        return np.where(are_lengths, residual, 0.0)

    q = c.robot.input_values(rows.joints)
    residual = np.where(are_lengths, c.rows.residual_calibrated, 0.0)
    parts = np.full(q.shape, np.nan)
    for j, step in enumerate(_STEP * np.eye(q.shape[1])):
        # The prediction enters the residual with a minus.
        change = lengths(q - step) - lengths(q + step)
        slope = change / (2.0 * _STEP)
        size = np.linalg.norm(slope, axis=1)
        part = np.sum(residual * slope, axis=1) / np.maximum(size, 1e-12)
        parts[:, j] = np.where(size > _LEAST_LEVER, part, np.nan)
    return parts


def _running_mean(ax: Axes, values: Array, parts: Array) -> None:
    """Draw the mean of parts (K,) [mm], NaN for none, over runs of rows with neighbouring joint values (K,).

    A band around it is two standard errors wide on either side.
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
    look: dict[str, Any] = {"color": CALIBRATED, "zorder": 3}
    label = "mean of the estimation rows ± 2 standard errors"
    ax.fill_between(x, low, high, alpha=0.45, lw=0, label=label, **look)
    ax.plot(x, mean, lw=1.3, **look)
