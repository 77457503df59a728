"""inspect: which parameters of a robot can be identified from poses, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.data.cell import AUTO, Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.estimate.fitting import Task, model_of
from calib.estimate.problem import Problem
from calib.estimate.registration import register
from calib.estimate.setup import known_distances, rows_of
from calib.model.kinematics import ErrorModel, Kinematics
from calib.model.observability import Observability, analyse
from calib.robot.readback import spread_poses
from calib.robot.robot import Robot

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

    Judged are a table's estimation poses or, without one, 200 poses of a Sobol sequence over the joint limits, of the
    cell's kind. A target or anchor that is not given is registered to the table, or stands at a generic place.
    """
    assumed = []
    if measurements is None:
        rows, setup = rows_of(robot, _everywhere(robot, cell), cell)
        frames, targets = setup.T_frame_base.copy(), setup.T_tip_target.copy()
        if not np.all(setup.target_given):
            targets[:, :3, 3] = GENERIC_TARGET
            assumed.append("target")
        if any(kind.name == "distance" for kind in rows.present) and not np.all(setup.frame_given):
            frames[:, :3, 3] = np.negative(GENERIC_ANCHOR)
            assumed.append("anchor")
        setup = setup.placed(frames, targets)
        rows = rows.as_measured_at(setup.seen(robot.poses(rows.joints), rows.samples))
    else:
        rows, setup = rows_of(robot, measurements, cell)
        rows = rows.select(measurements.estimation)
        setup = register(robot, setup, rows)
    name = cell.model if cell.model != AUTO else "dh"
    seen = set(rows.samples.frame.tolist())
    distances = tuple(d for d in known_distances(cell, setup) if {d.first, d.second} <= seen)
    model = setup.aligned(model_of(Task(robot, cell, setup, name, distances)))
    kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
    x = np.zeros(len(model))
    jacobian = rows.derivative(*kinematics.twists(x, rows.samples))
    jacobian = jacobian * (rows.scales[:, :1] / rows.scales)[:, :, None]
    known = Problem.first(kinematics, rows, distances).known_slopes(x)
    jacobian = np.concatenate([jacobian[rows.used], known])
    seen_by = analyse(jacobian, model.names, model.units)
    source = None if measurements is None else measurements.source
    return Inspection(model, seen_by, len(rows), source, tuple(assumed))


def _everywhere(robot: Robot, cell: Cell) -> Measurements:
    """Poses spread over the joint limits as a table of the cell's kind."""
    kind = registry.get(cell.kind or "point")
    if not kind.free:
        raise ModelError(
            f"Poses spread over the joint limits say nothing of kind '{kind.name}'. Give a table of such rows."
        )
    joints = spread_poses(robot)
    return Measurements(
        joint_names=robot.joint_names,
        joints=joints,
        kinds=(kind.name,) * len(joints),
        **any_measurement(kind.name, len(joints)),
        prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
    )


def any_measurement(name: str, count: int) -> dict[str, Any]:
    """The arguments of `Measurements` for rows of a kind of free poses, of which only poses and targets count."""
    kind, somewhere = registry.get(name), np.tile(np.eye(4), (count, 1, 1))
    somewhere[:, :3, 3] = 1.0
    assert kind.measure is not None
    return Measurements.columns_of(kind, kind.measure(somewhere))
