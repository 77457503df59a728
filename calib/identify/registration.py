"""Registration: where the target and the measurement frame stand, before anything about the robot is estimated.

A robust fit from a wrong start takes every row for an outlier, so these come first, by plain least squares on the
nominal robot: in closed form where only the target or only the frame is unknown, and from several starts where both
are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError
from calib.identify.problem import Problem
from calib.identify.solvers import levenberg_marquardt
from calib.measure.cell import Cell
from calib.model.error_model import FRAME, TARGET, error_model
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: Distances from the tip at which a target is looked for when nothing is known of it [m].
_REACH = 0.15

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
    return _both(robot, cell, joints[chosen], poses, seen)


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


def _both(robot: Robot, cell: Cell, joints: Array, poses: Array, points: Array) -> Cell:
    """Frame and target together: Levenberg-Marquardt from several targets, each with its best frame."""
    model = error_model(robot, "frames", frame=True, target=True)
    size = steps([p.unit for p in model.parameters])
    corners = np.array(
        [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    )
    starts = list(_REACH * corners)
    if cell.target is not None:
        starts.insert(0, cell.target)
    best: tuple[float, Cell] | None = None
    for start in starts:
        T_frame_base, T_tip_target = _frame(poses, start, points), np.eye(4)
        T_tip_target[:3, 3] = start
        kinematics = Kinematics(robot, model, T_frame_base, T_tip_target)
        sigma, ones = np.full(len(points), 1e-3), np.ones(len(points))
        problem = Problem(kinematics, joints, points, sigma, ones, np.zeros(len(model)))
        solution = levenberg_marquardt(problem.system, np.zeros(len(model)), step_size=size)
        if best is None or solution.cost < best[0]:
            displacement, _ = model.displacements(solution.x)
            at_frame, at_target = model.places.index(FRAME), model.places.index(TARGET)
            found = replace(
                cell,
                T_frame_base=read_only(T_frame_base @ displacement[at_frame]),
                target=read_only((T_tip_target @ displacement[at_target])[:3, 3]),
            )
            best = (solution.cost, found)
    assert best is not None
    return best[1]
