"""Robots on their feet: a chain that begins at the hand, as of a camera on it, is shown from the root of the URDF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.fit.registration.setup import Setup
from calib.robot.robot import Robot
from calib.show.scene.puppet import root_poses
from calib.verbs.evaluate.evaluation import Evaluation

#: A base whose pose in the root differs by less at two poses of the robot does not move.
_STILL = 1e-9


def standing(e: Evaluation) -> Evaluation:
    """Return an evaluation seen from the other end of the chain where its base moves and its tip does not.

    Then the board is the measurement frame, which stands, and the camera the target, which the hand carries.

    Args:
        e: The evaluation of a robot.
    """
    robot = e.robot
    if not _moves(robot, robot.base) or _moves(robot, robot.tip):
        return e
    other = robot.rebuilt(base=robot.tip, tip=robot.base)
    m = e.measurements
    swapped = replace(m, groups=m.targets, targets=m.groups)
    return replace(e, robot=other, measurements=swapped, setup=_swapped(e.setup))


def _moves(robot: Robot, link: str) -> bool:
    """Tell whether joints of the chain move a link in the root of the URDF."""
    q = np.zeros((2, len(robot.inputs)))
    q[1] = 0.1
    T_root_link: Array = root_poses(robot, robot.readings(q))[link]
    return bool(np.max(np.abs(T_root_link[1] - T_root_link[0])) > _STILL)


def _swapped(setup: Setup) -> Setup:
    """Return frames and targets with their roles changed: T_target_tip of each target, T_base_frame of each frame."""
    T_frame_base = np.array([rigid_inverse(T) for T in setup.T_tip_target])
    T_tip_target = np.array([rigid_inverse(T) for T in setup.T_frame_base])
    return replace(
        setup,
        groups=setup.targets,
        targets=setup.groups,
        T_frame_base=read_only(T_frame_base),
        T_tip_target=read_only(T_tip_target),
        unknown=tuple(() for _ in setup.targets),
        frame_given=np.ones(len(setup.targets), dtype=bool),
        target_unknown=np.zeros(len(setup.groups), dtype=bool),
        target_given=np.ones(len(setup.groups), dtype=bool),
        own_axes=np.zeros(len(setup.targets), dtype=bool),
    )
