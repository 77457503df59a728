"""Registration: where targets and measurement frames stand, before anything about the robot is estimated.

A robust fit from a wrong start takes every row for an outlier, so these come first, by plain least squares on the
nominal robot: in closed form where the problem is linear, and else from several starts, the best of which are refined
by Levenberg-Marquardt.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError
from calib.identify.rows import NONE, Rows
from calib.identify.setup import Setup, along_own_axes
from calib.identify.solvers import levenberg_marquardt
from calib.identify.starts import (
    frames_around,
    linear_start,
    pose_start,
    turned_targets,
)
from calib.kinds import Kind
from calib.model import kernel
from calib.model.error_model import frame_and_target_model
from calib.model.observability import steps
from calib.model.parameters import ErrorModel
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: Distances from the tip at which a target is looked for when nothing is known of it [m].
_REACHES = (0.15, 0.7)

#: Of all starts so many are refined, those that fit best with the frames that suit them.
_REFINED = 5

#: Rows of each view of a target used to find a start; more do not make it better.
_ROWS = 200
_FEWEST_ROWS = 20

#: Columns of a residual that are lengths; angles are behind them.
_LENGTHS = 3

#: Directions of a frame that is wholly unknown, and the points that show all of them.
_ALL = 6
_FEWEST_POINTS = 3


def register(robot: Robot, setup: Setup, rows: Rows, *, tolerance: float = 1e-12) -> Setup:
    """The set-up with targets and frames where the nominal robot puts them best.

    What is not to be estimated stays as given, and so does what no row sees.

    Args:
        robot: The nominal robot.
        setup: What is known.
        rows: The rows.
        tolerance: See `calib.identify.solvers.levenberg_marquardt`.

    Raises:
        MeasurementError: Too few rows to find what is asked for.
    """
    if not setup.count:
        return setup
    _check_enough(setup, rows)
    rows = rows if _few(rows) else rows.select(_some(rows))
    return register_poses(robot.poses(rows.joints), setup, rows, tolerance=tolerance)


def register_seen(T_base_tip: Array, setup: Setup, rows: Rows) -> Setup:
    """`register` with the poses of the tip at all rows, shape (N, 4, 4), in place of a robot."""
    if not setup.count:
        return setup
    _check_enough(setup, rows)
    if _few(rows):
        return register_poses(T_base_tip, setup, rows)
    chosen = _some(rows)
    return register_poses(T_base_tip[chosen], setup, rows.select(chosen))


def register_poses(
    T_base_tip: Array, setup: Setup, rows: Rows, *, tolerance: float = 1e-12
) -> Setup:
    """`register` with the poses of the tip, shape (N, 4, 4), in place of a robot, and with every row."""
    if not setup.count:
        return setup
    linear = linear_start(setup, T_base_tip, rows)
    if linear is not None and np.all(rows.where(_is_linear)):
        return setup.placed(*linear)
    model = frame_and_target_model(
        setup.frame_unknowns,
        setup.unknown_targets,
        known_targets=setup.target_names,
        rotation=setup.rotation,
    )
    starts = [
        (frames, turned_targets(setup, frames, targets, T_base_tip, rows))
        for frames, targets in ([linear] if linear else _starts(setup, T_base_tip, rows))
    ]
    misfits = [_misfit(T_base_tip, rows, setup.placed(*start)) for start in starts]
    best: tuple[float, Setup] | None = None
    for i in np.argsort(misfits, kind="stable")[:_REFINED]:
        start = setup.placed(*starts[i])
        own = along_own_axes(model, start)
        solution = levenberg_marquardt(
            partial(_system, own, T_base_tip, rows, start),
            np.zeros(len(model)),
            step_size=steps(model.units),
            tolerance=tolerance,
        )
        if best is None or solution.cost < best[0]:
            best = (solution.cost, start.placed(*_at(own, start, solution.x)))
    assert best is not None
    return _settled(best[1], rows)


def _is_linear(kind: Kind) -> bool:
    """Whether rows of this kind are points, to which `linear_start` is the least-squares solution itself."""
    return kind.position and kind.size == 3


def _settled(setup: Setup, rows: Rows) -> Setup:
    """The set-up with frames put somewhere definite in directions that no row tells: a plane's turn about its normal.

    Without this the start that happened to win would decide it, by rounding.
    """
    T_frame_base = setup.T_frame_base.copy()
    for f, directions in enumerate(setup.unknown):
        for kind in rows.present:
            if kind.settle is None or not setup.own_axes[f] or directions != kind.directions:
                continue
            if np.any(rows.where(kind.__eq__) & (rows.samples.frame == f)):
                T_frame_base[f] = kind.settle(T_frame_base[f])
    return setup.placed(T_frame_base, setup.T_tip_target)


def _check_enough(setup: Setup, rows: Rows) -> None:
    """Refuse fewer numbers than unknowns, in all and for each frame."""
    parts = ["the measurement frames" if len(setup.groups) > 1 else "the measurement frame"]
    parts = [*(parts if any(setup.unknown) else []), *(["the target"] * setup.estimate_target)]
    whole = [len(directions) == _ALL for directions in setup.unknown]
    points = rows.where(lambda kind: kind.coordinates and not kind.orientation)
    least = _FEWEST_POINTS if any(whole) else 1
    if rows.count < setup.count or (np.all(points) and len(rows) < least):
        raise MeasurementError(
            f"{len(rows)} rows give {rows.count} numbers; {setup.count} are needed to find "
            f"{' and '.join(parts)} alone. Measure more poses, or give what is known of the set-up."
        )
    for f, directions in enumerate(setup.unknown):
        own = rows.samples.frame == f
        count, seen = int(np.sum(rows.used[own])), int(np.sum(own))
        # Two points leave the rotation about the line through them.
        too_few_points = whole[f] and bool(np.all(points[own])) and seen < _FEWEST_POINTS
        if seen and (count < len(directions) or too_few_points):
            raise MeasurementError(
                f"The set-up '{setup.groups[f]}' has {seen} row{'s' * (seen != 1)} with {count} numbers; its frame "
                f"has {len(directions)} unknowns. Measure {_FEWEST_POINTS if too_few_points else 'more'} poses there, "
                "or leave its rows out."
            )


def _few(rows: Rows) -> bool:
    """Whether all rows are needed to find a start."""
    samples = rows.samples
    one_view = len(rows) <= _ROWS and not (samples.frame.any() or samples.target.any())
    return one_view or len(rows) <= _FEWEST_ROWS


def _some(rows: Rows) -> NDArray[np.bool_]:
    """Rows that are enough to find a start, spread evenly over what each frame sees of each target; whole pairs."""
    told = np.flatnonzero(rows.kinds != NONE)
    seen = np.stack([rows.samples.frame, rows.samples.target], axis=1)[told]
    views, view = np.unique(seen, axis=0, return_inverse=True)
    most = max(_ROWS // len(views), _FEWEST_ROWS)
    mask = np.zeros(len(rows), dtype=bool)
    for v in range(len(views)):
        own = told[view.reshape(-1) == v]
        mask[own[np.linspace(0, len(own) - 1, min(len(own), most)).astype(int)]] = True
    mask[rows.partner[mask & (rows.partner >= 0)]] = True
    return mask


def _starts(setup: Setup, T_base_tip: Array, rows: Rows) -> list[tuple[Array, Array]]:
    """Targets to begin with, each with the frames that suit them."""
    oriented = pose_start(setup, T_base_tip, rows)
    if oriented is not None:
        return [oriented]
    places = [setup.T_tip_target]
    if setup.estimate_target:
        for reach in _REACHES:
            for axis in np.concatenate([np.eye(3), -np.eye(3)]):
                moved = setup.T_tip_target.copy()
                moved[setup.target_unknown, :3, 3] = reach * axis
                places.append(moved)
        if np.any(setup.target_given & setup.target_unknown):
            nowhere = setup.T_tip_target.copy()
            nowhere[setup.target_unknown, :3, 3] = 0.0
            places.append(nowhere)
    turned = [setup, *_turned(setup)]
    return [
        (frames_around(one, targets, T_base_tip, rows), targets)
        for one in turned
        for targets in places
    ]


def _turned(setup: Setup) -> list[Setup]:
    """Frames of which one rotation is unknown, but not all: turned by quarters, so that none is out of reach."""
    result = []
    for axis, name in enumerate(("rx", "ry", "rz")):
        partly = [f for f, d in enumerate(setup.unknown) if name in d and len(d) < 6]
        for quarter in (1, 2, 3) if partly and len(setup.groups) == 1 else ():
            R = np.eye(4)
            i, j = (axis + 1) % 3, (axis + 2) % 3
            c, s = float(np.cos(quarter * np.pi / 2)), float(np.sin(quarter * np.pi / 2))
            R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
            result.append(setup.placed(setup.T_frame_base @ R, setup.T_tip_target))
    return result


def _misfit(T_base_tip: Array, rows: Rows, setup: Setup) -> float:
    """The sum of squares at a start."""
    T_frame_tip = setup.T_frame_base[rows.samples.frame] @ T_base_tip
    residual = rows.residual(T_frame_tip @ setup.T_tip_target[rows.samples.target]) / rows.scales
    return float(np.sum(residual[rows.used] ** 2))


def _system(
    model: ErrorModel, T_base_tip: Array, rows: Rows, setup: Setup, x: Array
) -> tuple[Array, Array]:
    """The whitened residual and its own derivative, shapes (M,) and (M, p), over fixed poses of the tip."""
    displacement, directions = model.displacements(x)
    frames = len(setup.groups)
    T_frame_base = (setup.T_frame_base @ displacement[:frames])[rows.samples.frame]
    T_tip_target = (setup.T_tip_target @ displacement[frames + 1 :])[rows.samples.target]
    T_frame_target = T_frame_base @ T_base_tip @ T_tip_target
    local = directions.reshape(len(displacement), 6, -1)
    outer = np.array([T[:, :3].transpose(2, 1, 0) for T in (T_frame_base, T_frame_target)])
    moves = kernel.regressor(outer, outer[1, 3])
    columns = np.zeros((len(model), 6, len(rows)))
    for k, (at, which) in enumerate(
        ((local[:frames], rows.samples.frame), (local[frames + 1 :], rows.samples.target))
    ):
        kernel.add_columns(columns[:, :3], moves[k], at, which)
        if rows.width > _LENGTHS:
            kernel.add_columns(columns[:, 3:], outer[k, :3], at[:, 3:], which)
    twists = columns.transpose(2, 1, 0)
    used, scales = rows.used, rows.scales
    residual = (rows.residual(T_frame_target) / scales)[used]
    J = (rows.derivative(T_frame_target, twists) / -scales[:, :, None])[used]
    return residual, J


def _at(model: ErrorModel, setup: Setup, x: Array) -> tuple[Array, Array]:
    """Frames and targets at x, shapes (F, 4, 4) and (T, 4, 4)."""
    displacement, _ = model.displacements(x)
    frames = len(setup.groups)
    return setup.T_frame_base @ displacement[:frames], setup.T_tip_target @ displacement[
        frames + 1 :
    ]
