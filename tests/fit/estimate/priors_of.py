"""Prior terms of a cell whose target was given where a fit starts."""

from __future__ import annotations

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup

#: How far registration moves the target.
OFF = np.zeros((4, 4))


OFF[0, 3] = 1e-3


def prior_terms(virtual, model, kind="point", **given):
    """The prior terms of a cell whose target was given where the fit starts."""
    robot, rows = (
        virtual.kinematics.robot,
        virtual.rows(np.random.default_rng(0), np.zeros(27), 3, 0.0),
    )
    cell = Cell(target=virtual.kinematics.T_tip_target[0, :3, 3], estimate_frame=True, **given)
    kinds = (kind,) * len(rows)
    table = Measurements(robot.joint_names, rows.joints, rows.measured, kinds=kinds)
    _, setup = rows_and_setup(robot, table, cell)
    started = setup.with_poses(setup.T_frame_base, virtual.kinematics.T_tip_target + OFF)
    return PriorTerms.of(Task(robot, cell, setup, "dh"), model, started)
