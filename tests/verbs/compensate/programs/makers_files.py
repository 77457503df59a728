"""Files of makers' programs on the way through calib: read, corrected, written, read again, and run by a controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.robot.robot import Robot
from calib.verbs.compensate.programs.correction import CorrectedProgram, corrected
from calib.verbs.compensate.programs.dialects import read_program_file
from calib.verbs.compensate.programs.nominal_values import nominal_values
from calib.verbs.compensate.programs.program_file import ProgramFile, Stated
from tests.verbs.compensate.programs.controller import Arm, rotation


def run(
    path: Path, stated: Stated, nominal: Robot, true: Robot, folder: Path
) -> tuple[CorrectedProgram, np.ndarray]:
    """The program of a file, corrected, and how far [m] the true robot is from where each motion should go.

    What the controller does is computed from the corrected file, which is read again.
    """
    original = read_program_file(path, stated)
    result = corrected(original, nominal, true)
    (text,) = result.texts
    file = folder / path.name
    file.write_bytes(text.text.encode("latin-1"))
    written = read_program_file(file, stated)

    controller, real = Arm(nominal), Arm(true)
    near = nominal_values(nominal, original).q
    meant = _joint_values(controller, original, nominal, near)
    sent = _joint_values(controller, written, nominal, near)
    away = []
    for move, q_meant, q_sent in zip(original.moves, meant, sent, strict=True):
        tool = np.eye(4) if move.T_tip_tool is None else move.T_tip_tool
        apart = controller.pose(q_meant) @ tool - real.pose(q_sent) @ tool
        away.append(float(np.linalg.norm(apart[:3, 3])))
    return result, np.array(away)


def _joint_values(
    arm: Arm, program: ProgramFile, nominal: Robot, near: np.ndarray
) -> list[np.ndarray]:
    """Values of the URDF's joints at each motion: the controller's readings may be coupled."""
    found = []
    for move, q in zip(program.moves, near, strict=True):
        target = program.targets[move.target]
        numbers = np.array([number.value for number in target.numbers])
        if target.convention is None:
            found.append(nominal.input_values(numbers * target.scales)[0])
            continue
        T_frame_tool = np.eye(4)
        T_frame_tool[:3, 3] = numbers[:3] * target.scales[:3]
        T_frame_tool[:3, :3] = rotation(target.convention.name, numbers[3:])
        T_base_tip = move.T_base_frame @ T_frame_tool @ np.linalg.inv(move.T_tip_tool)
        found.append(arm.inverse(T_base_tip, nominal.input_values(q)[0]))
    return found
