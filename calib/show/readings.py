"""Coupled joint readings, and the DH rows that a robot was made from, in one sentence each."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.robot.robot import Robot


def coupling_sentence(robot: Robot) -> str:
    """Word how the joints follow from their readings; empty if none are coupled.

    Returns:
        Such as ``"Coupled readings: 'joint_3' is at its reading plus that of 'joint_2'."``
    """
    joints = []
    for name, factors in robot.reading_coupling.items():
        terms = "".join(_term(factor, other) for other, factor in factors.items())
        joints.append(f"'{name}' is at its reading{terms}")
    return f"Coupled readings: {'; '.join(joints)}." if joints else ""


def rows_sentence(robot: Robot) -> str:
    """Word from which DH rows a robot was made; empty if it was made from none.

    Returns:
        Such as ``"Made from DH rows, standard convention: A_i = ..."``, without a full stop.
    """
    # Late: the command line loads nothing heavy at its start.
    from calib.robot.dh.rows import EQUATIONS

    rows = robot.urdf.dh
    if rows is None:
        return ""
    convention = rows.table.convention
    return f"Made from DH rows, {convention} convention: {EQUATIONS[convention]}"


def _term(factor: float, name: str) -> str:
    """Word what one joint's reading adds to another's."""
    sign = "plus" if factor > 0.0 else "minus"
    if abs(factor) == 1.0:
        return f" {sign} that of '{name}'"
    return f" {sign} {abs(factor):.6g} times that of '{name}'"
