"""Robot and rows that a call names: the chain of its cell, the table, and the target of a result."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.options import TableOptions
from calib.errors import CalibError

if TYPE_CHECKING:
    from calib.data.cell import Cell
    from calib.data.cell_chains import Sight
    from calib.data.measurements import Measurements
    from calib.result.calibration import Calibration
    from calib.robot.robot import Robot


def load(
    robot: str,
    cell: Cell,
    measured: Collection[str] | None = None,
    sights: Iterable[Sight] | None = None,
    result: Calibration | None = None,
) -> Robot:
    """Load a robot between the links of the cell's frames and targets, with the joints that the cell holds and couples.

    Args:
        robot: Path of a URDF, a xacro or a file of DH rows, or a robot's name, as `Robot.load` takes it.
        cell: Names links, held joints and coupled readings.
        measured: Names of the joints whose values are known, which decide a tip that the cell does not name; None: all.
        sights: Stations and targets that occur together; None: all that the cell names.
        result: A result whose robot has several chains or further robots: the robot gets them; None: none.

    Returns:
        The robot.

    Raises:
        CalibError: As of `Robot.load`.
    """
    from calib.data.cell_chains import robot_of_cell, robot_with_chains_of
    from calib.robot.urdf import read_urdf

    if result is not None and (result.nominal.branches or result.nominal.parts):
        return robot_with_chains_of(result.nominal, read_urdf(robot), cell.held)
    return robot_of_cell(read_urdf(robot), cell, measured, sights)


def load_with_data(
    robot: str,
    cell: Cell,
    data: Path,
    table_options: TableOptions | None = None,
    result: Calibration | None = None,
) -> tuple[Robot, Measurements]:
    """Load a robot and a table whose joint columns are those of its chain.

    A tip that the cell does not name is the end of the longest chain whose joints all have a column.

    Args:
        robot: Path of a URDF, a xacro or a file of DH rows, or a robot's name, as `Robot.load` takes it.
        cell: Names base, tip, held joints, coupled readings and the kind of the rows.
        data: The table.
        table_options: How the table is read, as typed; None: nothing was.
        result: As of `load`.

    Returns:
        Robot and measurements.

    Raises:
        CalibError: Arguments in the wrong order, a unit without a list of points, or a fault of the robot or the table.
    """
    from calib.basics.tables import Table
    from calib.data.cell_chains import check_links_named, sights_of
    from calib.data.columns import column_names
    from calib.data.measurements import Measurements
    from calib.data.whole_turns import brought_back
    from calib.robot.dh_file import is_other_table

    options = table_options or TableOptions()
    points, points_unit = options.points, options.points_unit
    if points_unit is not None and points is None:
        raise CalibError(
            "--points-unit is the unit of a list of points; name the list with --points."
        )
    if is_other_table(robot):
        raise CalibError(
            f"'{robot}' was given as the robot, but is not a table of DH rows: it has no columns d and alpha. "
            "ROBOT comes first, then DATA."
        )
    columns = options.parsed()
    table = Table.read(data)
    with prefix_hint(cell):
        sights = sights_of(table, columns, cell.kind)
    if (cell.bases or cell.tips) and result is None:
        check_links_named(cell, sights, str(data))
    arm = load(robot, cell, column_names(table, columns), sights, result)
    measurements = Measurements.read(
        table,
        arm.joint_names,
        arm.joint_types,
        columns,
        cell.kind,
        points,
        points_unit,
        needs_all_joints=not arm.branches,
    )
    return arm, brought_back(arm, measurements)


@contextmanager
def prefix_hint(cell: Cell) -> Iterator[None]:
    """Add to a message about two columns of one name, of a cell of several robots, how their joints are called."""
    from calib.errors import MeasurementError

    try:
        yield
    except MeasurementError as error:
        if not cell.robots or "two columns are called" not in str(error):
            raise
        name = next(iter(cell.robots))
        raise MeasurementError(
            f"{error} If the second is of the robot '{name}', its header begins with the robot's name: '{name}/JOINT'."
        ) from error


def with_target_link(robot: Robot, cell: Cell) -> Cell:
    """Return the cell with the target at the URDF's link ``calib_target``; unchanged if that is not fixed to the tip.

    Args:
        robot: Its URDF may have the link, which an earlier calibration added.
        cell: Names no target.
    """
    from calib.robot.urdf import TARGET_LINK

    if robot.tip == TARGET_LINK:
        return cell.with_target((0.0, 0.0, 0.0), estimate=cell.estimate_target)
    if TARGET_LINK not in robot.urdf.links:
        return cell
    with_link = robot.rebuilt(tip=TARGET_LINK)
    if with_link.joint_names != robot.joint_names:
        return cell
    T_last_target = with_link.placements[-1]
    T_last_tip = robot.placements[-1]
    p_tip_target = T_last_tip[:3, :3].T @ (T_last_target[:3, 3] - T_last_tip[:3, 3])
    return cell.with_target(p_tip_target, estimate=cell.estimate_target)
