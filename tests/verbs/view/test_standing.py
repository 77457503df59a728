"""Robots on their feet: the camera where the fit has it, seen from the root; other chains stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.channels import Channels
from calib.fit.registration.registration import register
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot
from calib.verbs.evaluate.evaluation import Evaluation
from calib.verbs.view.standing import standing
from tests.images import arm, cell, mounts, poses, table


def evaluation(robot):
    q = poses(4)
    m = table(q)
    rows, setup = rows_and_setup(arm(), m, cell())
    registered = register(arm().poses(rows.joints), setup, rows)
    residual = np.zeros((len(m), 2))
    return Evaluation(robot, m, registered, (), residual, Channels.of_unit(residual > -1, "px"))


def test_a_chain_from_the_hand_is_shown_from_the_root():
    e = evaluation(arm())
    shown = standing(e)
    assert (shown.robot.base, shown.robot.tip) == ("panda_link0", "panda_link8")
    q = e.measurements.joints_for(shown.robot.joint_names)[[0]]
    T_camera_base, T_tip_board = mounts()
    T_board_camera = (
        shown.setup.T_frame_base[0] @ shown.robot.poses(q)[0] @ shown.setup.T_tip_target[0]
    )
    q_of_chain = e.measurements.joints_for(e.robot.joint_names)[[0]]
    T_camera_board = T_camera_base @ e.robot.poses(q_of_chain)[0] @ T_tip_board
    np.testing.assert_allclose(T_board_camera, np.linalg.inv(T_camera_board), atol=1e-5)
    assert shown.measurements.groups == e.measurements.targets
    assert shown.setup.groups == e.setup.targets


def test_a_chain_from_the_root_stays():
    e = replace(evaluation(arm()), robot=Robot.load("panda", base="panda_link0", tip="panda_link8"))
    assert standing(e) is e
