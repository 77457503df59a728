"""Inspection: which combinations of a model's parameters poses determine, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.data.cell import AUTO, Cell
from calib.data.inputs import (
    GENERIC_ANCHOR,
    GENERIC_TARGET,
    CellInput,
    RobotInput,
    TableInput,
    cell_of,
    inputs_of,
    robot_of,
    table_of_poses,
)
from calib.diagnosis.frame_drift import FrameDrift, find_frame_drift
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.task import Task
from calib.fit.registration.board_ends import numbered_from_one_end
from calib.fit.registration.registration import register
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup, known_distances
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.error_model import ErrorModel
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability
from calib.robot.other_reader import fault_by_yourdfpy
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot

#: The model that is inspected in place of ``"auto"``, and for a robot of several chains.
_MODEL = "dh"
_MODEL_OF_CHAINS = "placement"

#: Poses at which another reader of the URDF is compared.
_COMPARED = 5


@dataclass(frozen=True, slots=True)
class Inspection:
    """Observability of a model at the nominal robot."""

    #: The error model
    model: ErrorModel
    #: Rank and combinations of its parameters
    observability: Observability
    #: Number of poses
    poses: int
    #: File of the table they are from; None: spread over the joint limits
    source: str | None
    #: Parts of the cell that were put at a generic place: ``"target"``, ``"anchor"``
    assumed: tuple[str, ...] = ()
    #: Pictures whose corners were numbered from the other end, see `Measurements.other_end`
    other_end: tuple[str, ...] = ()
    #: What targets that stand still show of the drift of the measurement frames; None without such targets
    drift: FrameDrift | None = None
    #: What yourdfpy, another reader of the URDF, finds wrong with it; empty if it finds the same robot. None: it was
    #: not asked, because a table is inspected
    fault_by_yourdfpy: str | None = None


def inspect(
    robot: RobotInput,
    cell: CellInput = None,
    measurements: TableInput | None = None,
) -> Inspection:
    """Analyse which combinations of the cell's model a table, or poses over the joint limits, determine.

    Args:
        robot: The nominal robot; or the path of a URDF or xacro, or a name such as ``"ur3"``, with the cell's base and
            tip, or those that follow from the table's joint columns.
        cell: Its model is analysed, ``"auto"`` as ``"dh"``, of several chains as ``"placement"``; or the path of a cell
            file; None: the default cell. Errors of single corners of its boards are left out.
        measurements: Their estimation rows are analysed, with frames and targets registered; or the path of their
            table. None: 200 poses over the joint limits, with a target or anchor that the cell does not give at a
            generic place.

    Returns:
        The model with its observability at the nominal robot, the number of poses, their source, and what was put at a
        generic place.

    Raises:
        ArgumentError: Robot, cell or measurements are of another type.
        ModelError: An unknown model or parameter, or a kind of rows that poses alone do not make.
        MeasurementError: Too few rows for the registration.
    """
    assumed: tuple[str, ...] = ()
    source: str | None = None
    other_end: tuple[str, ...] = ()
    fault: str | None = None
    drift: FrameDrift | None = None
    if measurements is None:
        known = cell_of(cell)
        arm = robot_of(robot, known)
        rows, setup, assumed = _rows_over_joint_limits(arm, known)
        fault = fault_by_yourdfpy(arm, spread_poses(arm)[:_COMPARED])
    else:
        arm, table, known = inputs_of(robot, measurements, cell)
        # Corner errors have a narrow prior each, and without it any of them would be mistaken for an error of the robot
        # or of the print as a whole.
        boards = {name: replace(board, sigma_corner=0.0) for name, board in known.boards.items()}
        known = replace(known, boards=boards)
        table = numbered_from_one_end(arm, table, known)
        other_end = table.other_end
        rows, setup = rows_and_setup(arm, table, known)
        rows = rows.select(table.estimation)
        setup = register(arm.poses(rows.joints, rows.samples.chain), setup, rows)
        source = table.source
        shown = find_frame_drift(table, known.references)
        drift = None if shown is None else shown[0]
    name = known.model
    if name == AUTO:
        name = _MODEL_OF_CHAINS if arm.branches else _MODEL
    model = setup.turn_directions(Task(arm, known, setup, name).error_model())
    kinematics = Kinematics(arm, model, setup.T_frame_base, setup.T_tip_target)
    problem = Problem.initial(kinematics, rows, known_distances(known, setup))
    return Inspection(
        model=model,
        observability=problem.observability(np.zeros(len(model))),
        poses=len(rows),
        source=source,
        assumed=assumed,
        other_end=other_end,
        drift=drift,
        fault_by_yourdfpy=fault,
    )


def _rows_over_joint_limits(robot: Robot, cell: Cell) -> tuple[Rows, Setup, tuple[str, ...]]:
    """Make rows of perfect measurements at poses over the joint limits, with their frames and targets.

    The rows are of the cell's kind, points by default; raises `ModelError` for a kind that poses alone do not make.
    Also names what was put at a generic place, of ``"target"`` and ``"anchor"``.
    """
    q = spread_poses(robot)
    table = table_of_poses(robot, cell.kind or "point", q)
    if robot.branches:  # each target from each frame
        sights = [(group, tip) for group in cell.bases or ("",) for tip in cell.tips or ("target",)]
        table = table_of_poses(robot, cell.kind or "point", np.tile(q, (len(sights), 1)))
        table = replace(
            table,
            groups=tuple(group for group, _ in sights for _ in q),
            targets=tuple(target for _, target in sights for _ in q),
        )
    rows, setup = rows_and_setup(robot, table, cell)
    T_frame_base = setup.T_frame_base.copy()
    T_tip_target = setup.T_tip_target.copy()
    assumed = []
    if not np.all(setup.target_given):
        T_tip_target[:, :3, 3] = GENERIC_TARGET
        assumed.append("target")
    has_anchor = any(kind.name == "distance" for kind in rows.present)
    if has_anchor and not np.all(setup.frame_given):
        T_frame_base[:, :3, 3] = np.negative(GENERIC_ANCHOR)
        assumed.append("anchor")
    setup = setup.with_poses(T_frame_base, T_tip_target)
    T_frame_target = setup.target_poses(robot.poses(rows.joints, rows.samples.chain), rows.samples)
    return rows.as_measured_at(T_frame_target), setup, tuple(assumed)
