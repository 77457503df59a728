"""Registration that is not linear: starts, refined by Levenberg-Marquardt, on given poses of the robot's tip.

A start has targets at one of several places, with the frames that suit them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.fit.registration.closed_form import (
    orientation_setup,
    with_frames_fitted,
    with_held_axes,
    with_measured_target_rotations,
)
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.model.error_model import ErrorModel
from calib.model.observability import steps
from calib.model.parameter_sets import frame_and_target_model
from calib.numerics.solvers import levenberg_marquardt
from calib.robot import kernel

#: Distances from the tip at which a target is tried if its place was not given [m]: a flange and a long tool.
_REACHES = (0.15, 0.7)

#: Rotations of a frame, by direction, and the axis they turn about.
_AXES = {"rx": "x", "ry": "y", "rz": "z"}

#: The most starts that are refined: those with the lowest cost.
_REFINED = 5


def find_starts(setup: Setup, T_base_tip: Array, rows: Rows) -> list[Setup]:
    """Return setups from which to refine a registration.

    Args:
        setup: Frames and targets, with what is estimated of them.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.

    Returns:
        One setup if measured orientations determine it (`orientation_setup`); else one for each place where the targets
        are tried, also with their z axes where they turn least if these are held (`with_held_axes`), and each turn of
        a single frame, with the frames fitted to their rows.
    """
    by_orientation = orientation_setup(setup, T_base_tip, rows)
    if by_orientation is not None:
        return [by_orientation]
    # A single frame is tried turned by quarters about each rotation that is estimated, if not all are: refinement
    # converges from any of them. A frame that is wholly unknown is fitted in closed form.
    frames = [setup.T_frame_base]
    if len(setup.groups) == 1 and not setup.wholly_unknown[0]:
        for direction, quarter in itertools.product(_AXES, (1, 2, 3)):
            if direction in setup.unknown[0]:
                R = np.eye(4)
                angle = quarter * np.pi / 2
                R[:3, :3] = Rotation.from_euler(_AXES[direction], angle).as_matrix()
                frames.append(setup.T_frame_base @ R)
    result = []
    targets = target_poses(setup)
    turned = with_held_axes(setup, T_base_tip, rows)
    if turned is not setup:
        targets += target_poses(turned)
    for T_frame_base, T_tip_target in itertools.product(frames, targets):
        start = setup.with_poses(T_frame_base, T_tip_target)
        result.append(with_frames_fitted(start, T_base_tip, rows))
    return result


def target_poses(setup: Setup) -> list[Array]:
    """Return poses of all targets in the tip from which to start.

    Args:
        setup: T targets, and which of them are estimated.

    Returns:
        Poses T_tip_target, each of shape (T, 4, 4) [m]: first all as they are; then, unless none is estimated, with all
        targets whose whole position is estimated moved to one place, at several distances from the tip along either
        side of each of its axes, and to the tip itself if the position of one was given. Orientations stay.
    """
    result = [setup.T_tip_target]
    if not np.any(setup.unknown_positions):
        return result
    axes = [*np.eye(3), *-np.eye(3)]
    offsets = [reach * axis for reach in _REACHES for axis in axes]
    if np.any(setup.target_given & setup.unknown_positions):
        offsets.append(np.zeros(3))
    for offset in offsets:
        moved = setup.T_tip_target.copy()
        moved[setup.unknown_positions, :3, 3] = offset
        result.append(moved)
    return result


def refine_best(starts: Iterable[Setup], T_base_tip: Array, rows: Rows, tolerance: float) -> Setup:
    """Refine the most promising of several starts, and return the setup of the lowest sum of squares.

    Args:
        starts: Setups of the same frames and targets at different poses.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.
        tolerance: Relative fall of the sum of squares at which a refinement ends.

    Raises:
        SolverError: The residual is not finite at a start.
    """

    def sum_of_squares(setup: Setup) -> float:
        """Return the sum of squared residuals of a setup, in units of each scalar's sigma."""
        residual = rows.residual(setup.sightings(T_base_tip, rows.samples)) / rows.scales
        return float(np.sum(residual[rows.used] ** 2))

    turned = [with_measured_target_rotations(start, T_base_tip, rows) for start in starts]
    promising = sorted(turned, key=sum_of_squares)[:_REFINED]
    minima = [refine(start, T_base_tip, rows, tolerance) for start in promising]
    _, best = min(minima, key=lambda minimum: minimum[0])
    return best


def refine(start: Setup, T_base_tip: Array, rows: Rows, tolerance: float) -> tuple[float, Setup]:
    """Minimise the sum of squares from a start, by Levenberg-Marquardt.

    Args:
        start: Frames and targets, with what is estimated of them.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.
        tolerance: Relative fall of the sum of squares at which the refinement ends.

    Returns:
        Half the sum of squared residuals, in units of each scalar's sigma, and the setup, at the minimum.

    Raises:
        SolverError: The residual is not finite at the start.
    """
    model = frame_and_target_model(start.frame_unknowns, start.target_unknowns, start.target_names)
    turned = start.turn_directions(model)
    system = partial(_system, turned, T_base_tip, rows, start)
    x0 = np.zeros(len(model))
    solution = levenberg_marquardt(system, x0, steps(model.units), tolerance=tolerance)
    displacement, _ = turned.displacements(solution.x)
    return solution.cost, start.displaced(displacement)


def _system(
    model: ErrorModel,
    T_base_tip: Array,
    rows: Rows,
    setup: Setup,
    x: Array,
) -> tuple[Array, Array]:
    """The residual of a registration, (M,), and its derivative by x, (M, p), in units of each scalar's sigma.

    The p parameters x, (p,) [m, rad], of the model are of frames and targets alone, and displace those of ``setup``.
    The tip is at T_base_tip at each of the N rows, (N, 4, 4) [m].
    """
    displacement, directions = model.displacements(x)
    displaced = setup.displaced(displacement)
    seen = displaced.sightings(T_base_tip, rows.samples)

    # Motion of each row's target by each parameter, along the frame's axes: v, then omega.
    T_frame_base = displaced.T_frame_base[rows.samples.frame]
    axes = np.array([_axes_first(T_frame_base), _axes_first(seen.T_frame_target)])
    by_frame, by_target = kernel.regressor(axes, axes[1, 3])
    frames = len(setup.groups)
    by_place = directions.reshape(-1, 6, len(model))
    at_frames = by_place[:frames]
    at_targets = by_place[frames + 1 :]  # the tip is between them
    twists = np.zeros((len(model), 6, len(rows)))
    kernel.add_columns(twists[:, :3], by_frame, at_frames, rows.samples.frame)
    kernel.add_columns(twists[:, :3], by_target, at_targets, rows.samples.target)
    if rows.depends_on_orientation:
        turns = twists[:, 3:]
        kernel.add_columns(turns, axes[0, :3], at_frames[:, 3:], rows.samples.frame)
        kernel.add_columns(turns, axes[1, :3], at_targets[:, 3:], rows.samples.target)

    scales = rows.scales
    residual = rows.residual(seen) / scales
    derivative = rows.derivative(replace(seen, twists=twists.transpose(2, 1, 0)))
    jacobian = derivative / -scales[:, :, None]
    return residual[rows.used], jacobian[rows.used]


def _axes_first(T: Array) -> Array:
    """Axes and origin of poses, shape (N, 4, 4), in the order that `kernel.regressor` takes, shape (4, 3, N)."""
    return np.asarray(T[:, :3].transpose(2, 1, 0))
