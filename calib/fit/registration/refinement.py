"""Refinement of a registration from a start, by Levenberg-Marquardt, on given poses of the robot's tip."""

from __future__ import annotations

from functools import partial

import numpy as np

from calib.basics.arrays import Array
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.model.error_model import frame_and_target_model
from calib.model.observability import steps
from calib.model.parameters import ErrorModel
from calib.numerics.solvers import levenberg_marquardt
from calib.robot import kernel


def sum_of_squares(setup: Setup, T_base_tip: Array, rows: Rows) -> float:
    """Return the sum of squared residuals of a setup, in units of each scalar's sigma.

    Args:
        setup: Frames and targets.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.
    """
    T_frame_target = setup.target_poses(T_base_tip, rows.samples)
    residual = rows.residual(T_frame_target, setup.optics_at(rows.samples)) / rows.scales
    return float(np.sum(residual[rows.used] ** 2))


def refined(start: Setup, T_base_tip: Array, rows: Rows, tolerance: float) -> tuple[float, Setup]:
    """Minimise the sum of squares from a start, by Levenberg-Marquardt.

    Args:
        start: Frames and targets, with what is estimated of them.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.
        tolerance: Relative fall of the sum of squares at which the refinement ends.

    Returns:
        Half the sum of squared residuals, in units of each scalar's sigma, and the setup, at the minimum.
    """
    model = frame_and_target_model(
        start.frame_unknowns, start.unknown_targets, start.target_names, rotation=start.rotation
    )
    aligned = start.aligned(model)
    system = partial(_system, aligned, T_base_tip, rows, start)
    x0 = np.zeros(len(model))
    solution = levenberg_marquardt(system, x0, steps(model.units), tolerance=tolerance)
    displacement, _ = aligned.displacements(solution.x)
    return solution.cost, start.displaced(displacement)


def _system(
    model: ErrorModel,
    T_base_tip: Array,
    rows: Rows,
    setup: Setup,
    x: Array,
) -> tuple[Array, Array]:
    """The residual of a registration and its Jacobian, in units of each scalar's sigma.

    Args:
        model: Parameters of frames and targets alone, p of them.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows with M measured scalars.
        setup: Frames and targets that x displaces.
        x: shape (p,), [m] and [rad].

    Returns:
        Measured minus predicted, shape (M,), and its derivative, shape (M, p).
    """
    displacement, directions = model.displacements(x)
    displaced = setup.displaced(displacement)
    T_frame_target = displaced.target_poses(T_base_tip, rows.samples)
    twists = _twists(model, directions, displaced, T_frame_target, rows)
    scales = rows.scales
    optics = setup.optics_at(rows.samples)
    residual = rows.residual(T_frame_target, optics) / scales
    derivative = rows.derivative(T_frame_target, twists.transpose(2, 1, 0), optics)
    jacobian = derivative / -scales[:, :, None]
    return residual[rows.used], jacobian[rows.used]


def _twists(
    model: ErrorModel,
    directions: Array,
    setup: Setup,
    T_frame_target: Array,
    rows: Rows,
) -> Array:
    """Motion of each row's target by each parameter, along the frame's axes, shape (p, 6, N): v, then omega.

    Args:
        model: Its p parameters are of frames and targets alone; its places are frames, tip, targets.
        directions: shape (6 places, p), twists at each place: `ErrorModel.displacements`.
        setup: Frames and targets as displaced.
        T_frame_target: shape (N, 4, 4), pose of each row's target [m].
        rows: N rows.
    """
    T_frame_base = setup.T_frame_base[rows.samples.frame]
    axes = np.array([_axes_first(T_frame_base), _axes_first(T_frame_target)])
    by_frame, by_target = kernel.regressor(axes, axes[1, 3])
    twists = directions.reshape(-1, 6, len(model))
    frames = len(setup.groups)
    at_frames = twists[:frames]
    at_targets = twists[frames + 1 :]  # the tip is between them
    columns = np.zeros((len(model), 6, len(rows)))
    kernel.add_columns(columns[:, :3], by_frame, at_frames, rows.samples.frame)
    kernel.add_columns(columns[:, :3], by_target, at_targets, rows.samples.target)
    if rows.depends_on_orientation:
        turns = columns[:, 3:]
        kernel.add_columns(turns, axes[0, :3], at_frames[:, 3:], rows.samples.frame)
        kernel.add_columns(turns, axes[1, :3], at_targets[:, 3:], rows.samples.target)
    return columns


def _axes_first(T: Array) -> Array:
    """Axes and origin of poses, shape (N, 4, 4), in the order that `kernel.regressor` takes, shape (4, 3, N)."""
    return np.asarray(T[:, :3].transpose(2, 1, 0))
