"""Registration: where the target and the measurement frame stand, before anything about the robot is estimated.

A robust fit from a wrong start takes every row for an outlier, so these come first, by plain least squares on the
nominal robot: in closed form where only the target or only the frame is unknown, and from several starts where both
are.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib.errors import MeasurementError
from calib.identify.solvers import levenberg_marquardt
from calib.measure.cell import Cell
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Distances from the tip at which a target is looked for when nothing is known of it [m].
_REACHES = (0.15, 0.7)

#: Of all starts so many are refined, those that fit best with the frame that suits them.
_REFINED = 5

#: Rows used to find a start; more do not make it better.
_ROWS = 200


def register(robot: Robot, cell: Cell, joints: Array, points: Array) -> Cell:
    """The cell with target and frame where the nominal robot puts them best.

    What the cell does not ask to be estimated stays as given; a known frame that is not given is the base frame.

    Args:
        robot: The nominal robot.
        cell: What is known.
        joints: shape (N, n), [rad] or [m].
        points: shape (N, 3), [m].

    Raises:
        MeasurementError: Too few rows to find what is asked for.
    """
    if not cell.estimate_frame and cell.T_frame_base is None:
        cell = replace(cell, T_frame_base=read_only(np.eye(4)))
    unknown = 3 * cell.estimate_target + 6 * cell.estimate_frame
    if not unknown:
        return cell
    if 3 * len(points) < unknown or (cell.estimate_frame and len(points) < 3):
        message = (
            f"{len(points)} rows give {3 * len(points)} numbers; {unknown} are needed to find "
            f"{_asked(cell)} alone. Measure more poses, or give what is known of the set-up."
        )
        raise MeasurementError(message)
    chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), _ROWS)).astype(int))
    poses, seen = robot.poses(joints[chosen]), points[chosen]
    if not cell.estimate_frame:
        assert cell.T_frame_base is not None
        return replace(cell, target=_target(cell.T_frame_base @ poses, seen))
    if not cell.estimate_target:
        assert cell.target is not None
        return replace(cell, T_frame_base=_frame(poses, cell.target, seen))
    return _both(cell, poses, seen)


def _asked(cell: Cell) -> str:
    """What is to be found, in words."""
    parts = ["the measurement frame"] * cell.estimate_frame + ["the target"] * cell.estimate_target
    return " and ".join(parts)


def _target(T_frame_tip: Array, points: Array) -> Array:
    """The target in the tip: least squares of R_i t + p_i = m_i, in closed form, shape (3,)."""
    R, p = T_frame_tip[:, :3, :3], T_frame_tip[:, :3, 3]
    return read_only(np.einsum("nji,nj->i", R, points - p) / len(points))


def _frame(T_base_tip: Array, target: Array, points: Array) -> Array:
    """The base in the measurement frame: the rotation and translation that fit best (W. Kabsch, 1976), (4, 4)."""
    predicted = T_base_tip[:, :3, :3] @ target + T_base_tip[:, :3, 3]
    centre, seen = predicted.mean(axis=0), points.mean(axis=0)
    U, _, V = np.linalg.svd((points - seen).T @ (predicted - centre))
    T = np.eye(4)
    T[:3, :3] = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V
    T[:3, 3] = seen - T[:3, :3] @ centre
    return read_only(T)


def _both(cell: Cell, poses: Array, points: Array) -> Cell:
    """Frame and target together: Levenberg-Marquardt from several targets, each with its best frame."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    starts = [np.zeros(3), *(reach * axis for reach in _REACHES for axis in axes)]
    if cell.target is not None:
        starts.insert(0, cell.target)

    def misfit(framed: tuple[Array, Array]) -> float:
        residual, _ = _both_system(framed[0], framed[1], poses, points, np.zeros(9))
        return float(residual @ residual)

    framed = sorted(((_frame(poses, start, points), start) for start in starts), key=misfit)
    best: tuple[float, Array, Array] | None = None
    for T_frame_base, start in framed[:_REFINED]:
        system = partial(_both_system, T_frame_base, start, poses, points)
        solution = levenberg_marquardt(system, np.zeros(9), step_size=np.full(9, 1e-3))
        if best is None or solution.cost < best[0]:
            best = (solution.cost, *_displaced(T_frame_base, start, solution.x))
    assert best is not None
    return replace(cell, T_frame_base=read_only(best[1]), target=read_only(best[2]))


def _both_system(
    T_frame_base: Array, target: Array, poses: Array, points: Array, x: Array
) -> tuple[Array, Array]:
    """Residual m_i - R_f (R_i t + p_i) - p_f [m] and its derivative.

    Args:
        T_frame_base: shape (4, 4), where x begins [m].
        target: shape (3,), likewise.
        poses: shape (N, 4, 4), T_base_tip.
        points: shape (N, 3).
        x: shape (9,), shift of the base [m], rotation vector of the base in its own frame [rad], change of the
            target [m].

    Returns:
        shapes (3 N,) and (3 N, 9).
    """
    T, t = _displaced(T_frame_base, target, x)
    in_base = poses[:, :3, :3] @ t + poses[:, :3, 3]
    R = T[:3, :3]
    J = np.empty((len(points), 3, 9))
    J[:, :, :3] = -np.eye(3)
    # d(exp(w) b) = -exp(w) [b]x Jexp(w) dw, for each row's point b in the base.
    J[:, :, 3:6] = R @ _skew(in_base) @ pin.Jexp3(x[3:6])
    J[:, :, 6:] = -R @ poses[:, :3, :3]
    residual = points - in_base @ R.T - T[:3, 3]
    return residual.ravel(), J.reshape(-1, 9)


def _displaced(T_frame_base: Array, target: Array, x: Array) -> tuple[Array, Array]:
    """Frame and target at x, shapes (4, 4) and (3,)."""
    T = T_frame_base.copy()
    T[:3, :3] = T_frame_base[:3, :3] @ pin.exp3(x[3:6])
    T[:3, 3] += x[:3]
    return T, target + x[6:]


def _skew(v: Array) -> Array:
    """The matrices of the cross products, [v]x w = v x w, shape (N, 3, 3)."""
    result = np.zeros((len(v), 3, 3))
    result[:, 0, 1], result[:, 0, 2], result[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return np.asarray(result - result.transpose(0, 2, 1))
