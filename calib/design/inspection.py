"""Inspection: what poses can tell of a model's parameters, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import calib.data.kinds as registry
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.estimate.problem import Problem
from calib.estimate.task import Task
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability
from calib.model.parameters import ErrorModel
from calib.registration.known_distances import known_distances
from calib.registration.registration import register
from calib.registration.table_rows import rows_and_setup
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.units import Array

#: A target where none is given: off every axis of the tip [m].
GENERIC_TARGET = (0.05, 0.07, 0.03)

#: An anchor where none is known: off the first axis, which its distance would not tell of [m].
GENERIC_ANCHOR = (0.7, -0.5, 0.3)


@dataclass(frozen=True, slots=True)
class Inspection:
    """What poses can tell."""

    model: ErrorModel  # The error model
    observability: Observability  # Rank and combinations at the nominal robot
    poses: int  # How many there are
    source: str | None  # The table that they are from; None: spread over the joint limits
    assumed: tuple[str, ...] = ()  # What was put at a generic place, ``"target"`` or ``"anchor"``


def inspect(robot: Robot, cell: Cell, measurements: Measurements | None = None) -> Inspection:
    """Rank of the cell's model at the nominal robot; ``"auto"`` is looked at as ``"dh"``.

    Judged are a table's estimation poses, with the target registered, or else 200 over the joint limits, with a target
    or anchor that is not given at a generic place.
    """
    assumed = []
    if measurements is None:
        table = table_of_poses(robot, cell.kind or "point", spread_poses(robot))
        rows, setup = rows_and_setup(robot, table, cell)
        frames, targets = setup.T_frame_base.copy(), setup.T_tip_target.copy()
        if not np.all(setup.target_given):
            targets[:, :3, 3] = GENERIC_TARGET
            assumed.append("target")
        if any(kind.name == "distance" for kind in rows.present) and not np.all(setup.frame_given):
            frames[:, :3, 3] = np.negative(GENERIC_ANCHOR)
            assumed.append("anchor")
        setup = setup.placed(frames, targets)
        rows = rows.as_measured_at(setup.target_poses(robot.poses(rows.joints), rows.samples))
    else:
        rows, setup = rows_and_setup(robot, measurements, cell)
        rows = rows.select(measurements.estimation)
        setup = register(robot.poses(rows.joints), setup, rows)
    name = cell.model if cell.model != AUTO else "dh"
    model = setup.aligned(Task(robot, cell, setup, name).error_model())
    kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
    problem = Problem.initial(kinematics, rows, known_distances(cell, setup))
    seen_by = problem.observability(np.zeros(len(model)))
    source = None if measurements is None else measurements.source
    return Inspection(model, seen_by, len(rows), source, tuple(assumed))


def table_of_poses(robot: Robot, name: str, joints: Array) -> Measurements:
    """A table of a kind of free poses, of which only poses, (N, m), [rad] or [m], and targets count."""
    kind, somewhere = registry.get(name), np.tile(np.eye(4), (len(joints), 1, 1))
    if kind.paired or kind.measure is None:
        raise ModelError(f"Poses alone say nothing of kind '{name}'. Give a table of such rows.")
    somewhere[:, :3, 3] = 1.0
    return Measurements(
        joint_names=robot.joint_names,
        joints=joints,
        kinds=(name,) * len(joints),
        **Measurements.columns_of(kind, kind.measure(somewhere)),
        prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
    )
