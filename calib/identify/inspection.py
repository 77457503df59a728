"""inspect: which parameters of a model can be identified from poses, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.identify.fitting import check_one_setup, robot_parameters
from calib.identify.registration import register
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.model.error_model import ErrorModel, error_model
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability, analyse
from calib.model.readback import spread_poses
from calib.model.robot import Robot, read_only

#: A target where none is given: off every axis of the tip [m].
_GENERIC_TARGET = (0.05, 0.07, 0.03)


@dataclass(frozen=True, slots=True)
class Inspection:
    """What poses can tell.

    Attributes:
        model: The error model.
        observability: Rank and combinations at the nominal robot.
        poses: Which poses, in words.
    """

    model: ErrorModel
    observability: Observability
    poses: str


def inspect(robot: Robot, cell: Cell, measurements: Measurements | None = None) -> Inspection:
    """Rank of the cell's model at the nominal robot.

    Args:
        robot: The nominal robot.
        cell: Model, target and frame; a target that is not given is registered to the measurements, or, without
            any, taken 50, 70, 30 mm off the tip.
        measurements: Whose estimation poses to judge; None: 200 poses of a Sobol sequence over the joint limits.

    Raises:
        ModelError: Unknown parameter set or parameter.
        MeasurementError: A joint's column is missing, or too few rows.
    """
    model = error_model(robot, cell.model, frame=cell.estimate_frame, target=cell.estimate_target)
    model = model.without(robot_parameters(cell.frozen))
    if measurements is None:
        joints, words = spread_poses(robot), "200 poses spread over the joint limits"
        if cell.target is None:
            cell = replace(cell, target=read_only(_GENERIC_TARGET))
            words += ", target 50, 70, 30 mm off the tip"
    else:
        check_one_setup(measurements)
        rows = measurements.estimation
        joints = measurements.joints_for(robot.joint_names)[rows]
        words = f"the {rows.sum()} estimation rows of {measurements.source}"
        cell = register(robot, cell, joints, measurements.points[rows])
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = cell.target
    T_frame_base = np.eye(4) if cell.T_frame_base is None else cell.T_frame_base
    kinematics = Kinematics(robot, model, T_frame_base, T_tip_target)
    _, jacobian = kinematics.points_jacobian(np.zeros(len(model)), joints)
    units = [p.unit for p in model.parameters]
    return Inspection(model, analyse(jacobian.reshape(-1, len(model)), model.names, units), words)
