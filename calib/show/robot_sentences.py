"""Coupled joint readings, the DH rows that a robot was made from, and another run of its URDF, in a sentence each."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.result.calibration import Calibration
    from calib.robot.robot import Robot


def coupling_sentence(robot: Robot) -> str:
    """Word how the joints follow from their readings; empty if none are coupled.

    Returns:
        Such as ``"Coupled readings: 'joint_3' is at its reading plus that of 'joint_2'."``
    """
    joints = []
    for name, factors in robot.reading_coupling.items():
        words = f"'{name}' is at its reading"
        for other, factor in factors.items():
            times = "" if abs(factor) == 1.0 else f"{abs(factor):.6g} times "
            words += f" {'plus' if factor > 0.0 else 'minus'} {times}that of '{other}'"
        joints.append(words)
    return f"Coupled readings: {'; '.join(joints)}." if joints else ""


def rows_sentence(robot: Robot) -> str:
    """Word from which DH rows a robot was made; empty if it was made from none.

    Returns:
        Such as ``"Made from DH rows, standard convention: A_i = ..."``, without a full stop.
    """
    # Late: the command line loads nothing heavy at its start.
    from calib.robot.dh_rows import EQUATIONS

    rows = robot.urdf.dh
    if rows is None:
        return ""
    convention = rows.table.convention
    return f"Made from DH rows, {convention} convention: {EQUATIONS[convention]}"


def other_run_sentence(robot: Robot, result: Calibration, name: str) -> str:
    """Word that a URDF and a result are of different runs; empty if they are of one.

    Args:
        robot: The robot of the URDF, with the chain of the result.
        result: The result.
        name: Name of its file.
    """
    # Late: the command line loads nothing heavy at its start.
    from calib.result.calibration import joint_of_another_run

    joint = joint_of_another_run(result, robot)
    if not joint:
        return ""
    stated = f" (run {robot.urdf.run})" * bool(robot.urdf.run)
    return (
        f"{robot.urdf.source}{stated} is not of the run of {name} (run {result.run}): its joint origins are neither "
        f"those that the calibration began with nor the corrected ones (see '{joint}')."
    )
