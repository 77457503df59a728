"""Where further robots of a cell stand: their bases in that of the first, registered before their errors are estimated.

A row between the links of two robots is predicted by

    T_frame_target = T_frame_base  C_1(q)^-1  M  C_2(q)  T_tip_target

with the mount M of the second robot in the root of the first. M is refined together with frames and targets from the
pose that the URDF has, or, if that is the identity, from each of the 24 right-angled rotations. Of images the poses of
their boards are registered first: corners lead nowhere from a start at which cameras look away.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.errors import SolverError
from calib.fit.registration.registration import register
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.views import views_as_poses
from calib.model.error_model import ErrorModel
from calib.model.kinematics import Kinematics
from calib.model.observability import steps
from calib.model.parameter_sets import error_model
from calib.numerics.solvers import levenberg_marquardt
from calib.robot.robot import Robot

#: Rows that are enough to find a mount.
_ROWS = 400

#: Relative fall of the sum of squares at which a refinement ends.
_TOLERANCE = 1e-10


def with_mounts_found(robot: Robot, setup: Setup, rows: Rows) -> Robot:
    """Return a robot whose mounts are registered to rows, with frames and targets, on the nominal arms.

    Args:
        robot: The robots of a cell.
        setup: Frames and targets, with what is estimated of them.
        rows: N rows.

    Returns:
        The robot, with the poses of its mounts at the least sum of squares.

    Raises:
        MeasurementError: As of `register`.
        SolverError: The residual is not finite at any start.
    """
    searched = views_as_poses(rows)[0] if np.any(rows.has_views) else rows
    searched = searched.select(searched.evenly(_ROWS))
    # The rotations of a cube: from one of them, refinement converges.
    turns = np.tile(np.eye(4), (24, 1, 1))
    turns[:, :3, :3] = Rotation.create_group("O").as_matrix()
    starts = []
    for name in robot.mounts:
        T_root_base = robot.urdf.joint(name).T_parent_joint
        starts.append(list(turns) if np.array_equal(T_root_base, np.eye(4)) else [T_root_base])
    placements = [limb.placements for limb in robot.limbs]
    minima: list[tuple[float, Robot, ErrorModel, Array]] = []
    fault: SolverError | None = None
    for poses in itertools.product(*starts):
        start = robot.with_limbs(placements, dict(zip(robot.mounts, poses, strict=True)))
        try:
            cost, model, x = _refined(start, setup, searched)
        except SolverError as error:
            fault = error
            continue
        minima.append((cost, start, model, x))
    if not minima:
        assert fault is not None
        raise fault
    _, start, model, x = min(minima, key=lambda minimum: minimum[0])
    found = model.apply(start, x)
    if np.any(rows.has_views):
        _, model, x = _refined(found, setup, rows.select(rows.evenly(_ROWS)))
        found = model.apply(found, x)
    return found


def _refined(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, ErrorModel, Array]:
    """Minimise the sum of squares over mounts, frames and targets: return half of it, the model, and its x, (p,)."""
    T_base_tip = robot.poses(rows.joints, rows.samples.chain)
    registered = register(T_base_tip, setup, rows, tolerance=_TOLERANCE)
    model = error_model(
        robot,
        "frames",
        frame=registered.frame_unknowns,
        target=registered.target_unknowns,
        targets=registered.target_names,
    )
    model = registered.turn_directions(model)
    kinematics = Kinematics(robot, model, registered.T_frame_base, registered.T_tip_target)
    scales = rows.scales
    used = rows.used

    def system(x: Array) -> tuple[Array, Array]:
        """Return the residual, (M,), and its derivative by x, (M, p), in units of each scalar's sigma."""
        seen = kinematics.linearised(x, rows.samples)
        residual = rows.residual(seen) / scales
        jacobian = rows.derivative(seen) / -scales[:, :, None]
        return residual[used], jacobian[used]

    x0 = np.zeros(len(model))
    solution = levenberg_marquardt(system, x0, steps(model.units), tolerance=_TOLERANCE)
    return solution.cost, model, solution.x
