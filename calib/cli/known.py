"""What is known of a robot beside its URDF: a result's chain, and the target that a URDF carries."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.identify.result import Calibration
    from calib.measure.cell import Cell
    from calib.model.robot import Robot


def check_chain(cell: Cell, result: Calibration, name: str) -> None:
    """Refuse another base or tip than the result's: its frame and its target would mean something else.

    Args:
        cell: What was asked for.
        result: The result.
        name: Name of its file.

    Raises:
        CalibError: They differ.
    """
    own = result.nominal
    for option, given, wanted in (("base", cell.base, own.base), ("tip", cell.tip, own.tip)):
        if given is not None and given != wanted:
            message = (
                f"{name} is the result for --{option} {wanted}, and '{given}' was given; leave out --{option}, or "
                f"--calibration."
            )
            raise CalibError(message)


def with_target_link(robot: Robot, cell: Cell) -> Cell:
    """The cell with the target that the URDF's link ``calib_target`` carries, if it has one at this tip.

    Args:
        robot: The robot.
        cell: The set-up.
    """
    from calib.identify.result_urdf import TARGET_LINK

    if robot.tip == TARGET_LINK:
        return cell.with_target((0.0, 0.0, 0.0), estimate=cell.estimate_target)
    if TARGET_LINK not in robot.urdf.links:
        return cell
    with_link = robot.rebuilt(tip=TARGET_LINK)
    if with_link.joint_names != robot.joint_names:
        return cell
    T_last_target, T_last_tip = with_link.placements[-1], robot.placements[-1]
    point = T_last_tip[:3, :3].T @ (T_last_target[:3, 3] - T_last_tip[:3, 3])
    return cell.with_target(point, estimate=cell.estimate_target)
