"""Plans of images as they are shown: on the robot's foot, with the board, and the camera at the end of the arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.data.cell import Box
from calib.verbs.plan.plan import Plan

#: A board is shown this thick, and a camera this large [m].
_THICKNESS = 0.004
_CAMERA = 0.05


def shown(plan: Plan) -> Plan:
    """Return a plan of images with the chain led from what stands to what the robot carries, for the viewer.

    Args:
        plan: The plan; one without a camera is returned as it is.

    Returns:
        With a camera in the hand, a plan whose target is the camera, and the board a box of the cell; with a camera
        that stands, one whose target is the board, and the camera a box.
    """
    sight = plan.sight
    if sight is None:
        return plan
    T_base_camera = rigid_inverse(sight.T_frame_base)
    T_tip_middle = sight.T_tip_board.copy()
    T_tip_middle[:3, 3] += sight.T_tip_board[:3, :3] @ sight.board.centre
    if not plan.robot.base_moves:
        box = Box("camera", np.full(3, _CAMERA), T_base_camera)
        return _with(plan, T_tip_middle, box)
    robot = plan.robot.rebuilt(base=plan.robot.tip, tip=plan.robot.base)
    columns = [plan.robot.joint_names.index(name) for name in robot.joint_names]
    forwards = replace(
        plan,
        robot=robot,
        joints=read_only(plan.joints[:, columns]),
        taken=read_only(plan.taken[:, columns]),
    )
    size = np.array([*sight.board.size, _THICKNESS])
    return _with(forwards, T_base_camera, Box("board", size, T_tip_middle))


def _with(plan: Plan, T_tip_target: Array, box: Box) -> Plan:
    """Return a plan with another target and a box more."""
    cell = replace(plan.cell, boxes=(*plan.cell.boxes, box))
    return replace(plan, T_tip_target=read_only(np.array([T_tip_target])), cell=cell)
