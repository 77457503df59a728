"""joints: a robot and a table with poses of the flange in, the table with joint values out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calib.basics.arguments import check_path, check_type
from calib.basics.files import write_atomically
from calib.basics.tables import Table
from calib.basics.values import Value, one_line
from calib.data.forms.column_options import ColumnsInput, column_options
from calib.data.inputs import CellInput, cell_of, robot_of
from calib.errors import CalibError, VerdictError
from calib.robot.robot import Robot
from calib.verbs.joints.joints import JointValues, MeasuredThere, joint_values
from calib.verbs.joints.pose_table import PoseTable
from calib.verbs.joints.text import not_unique_text

#: A path of a robot's file, or its name, for messages.
_ROBOT = "the path of a URDF, a xacro or DH rows, or a name such as 'ur3'"


@dataclass(frozen=True, slots=True, eq=False)
class JointTable(Value):
    """Joint values at the poses of a table, and the table with them."""

    #: The robot, from the frame of the poses to the link whose poses they are.
    robot: Robot
    #: The same as its controller has it.
    controller: Robot
    #: Joint values at the P different poses, and whether they are the only ones.
    values: JointValues
    #: The table, and which pose each row has.
    table: PoseTable

    def __repr__(self) -> str:
        """Return one line, such as ``JointTable(24 poses of 6 joints, unique)``."""
        count, joints = self.values.q.shape
        unique = "unique" if self.is_unique else "not unique"
        return one_line("JointTable", f"{count} poses of {joints} joints, {unique}")

    @property
    def is_unique(self) -> bool:
        """True if the joint values are the only ones at every pose, whole turns aside."""
        return bool(self.values.unique.all())

    @property
    def first_rows(self) -> tuple[int, ...]:
        """Number of the row where each pose comes first, from 1."""
        pose = self.table.pose.tolist()
        return tuple(pose.index(p) + 1 for p in range(len(self.values.q)))

    def write(self, path: str | Path, *, overwrite: bool = False, accept: bool = False) -> Path:
        """Write the table with columns of joint values.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.
            accept: Whether the likeliest values are written where they are not unique.

        Returns:
            The path.

        Raises:
            ArgumentError: The path is of another type.
            VerdictError: Joint values are not unique, and ``accept`` is not given.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        if not self.is_unique and not accept:
            raise VerdictError(
                f"{not_unique_text(self.values, self.first_rows)} No table was written; --accept (in Python "
                "accept=True) writes the likeliest values."
            )
        types = self.robot.joint_types
        sliding = [name for name, kind in types.items() if kind == "prismatic"]
        content = self.table.with_joints(self.robot.joint_names, self.values.q, sliding)
        return write_atomically(path, content, overwrite=overwrite)


def joints(
    robot: str | Path,
    table: str | Path,
    *,
    cell: CellInput = None,
    controller: str | Path | None = None,
    poses_in: str | None = None,
    poses_of: str | None = None,
    columns: ColumnsInput = None,
) -> JointTable:
    """Compute joint values of a table that has poses of the flange instead, by inverse kinematics.

    Args:
        robot: Path of the robot's URDF, xacro or DH rows, or its name.
        table: Path of the table, see docs/joints.md.
        cell: Held joints; and what is known of camera, board, frames and targets, with the links that carry them, by
            which branches are told apart; None: limits and the other poses decide alone.
        controller: The robot as its controller has it, with the same joints in the same order; None: ``robot``.
        poses_in: Link in whose frame the controller gives poses; None: the root.
        poses_of: Link whose poses it gives; None: the end of the longest chain.
        columns: What is said of the table's columns, as by ``--columns``; None: nothing.

    Returns:
        Joint values at the table's poses, whether they are the only ones, and the table with them.

    Raises:
        ArgumentError: An argument of another type.
        CalibError: A file cannot be read, or a pose is not reached inside the limits; the class says which.
    """
    for argument, path in (("robot", robot), ("controller", controller)):
        optional = (str, Path) if argument == "robot" else (str, Path, type(None))
        check_type(argument, path, optional, _ROBOT)
    check_type("table", table, (str, Path), "the path of a table")
    for argument, link in (("poses_in", poses_in), ("poses_of", poses_of)):
        check_type(argument, link, (str, type(None)), "the name of a link, or None")
    stated = cell_of(cell)
    poses = PoseTable.read(Table.read(table), column_options(columns))
    arm = Robot.load(robot, poses_in, poses_of, held=stated.held, coupling=stated.coupling)
    shown = arm
    if controller is not None:
        shown = Robot.load(controller, poses_in, poses_of)
        if len(shown.joint_names) != len(arm.joint_names):
            raise CalibError(
                f"'{controller}' has {len(shown.joint_names)} joints between '{shown.base}' and '{shown.tip}', and "
                f"'{robot}' {len(arm.joint_names)} between '{arm.base}' and '{arm.tip}'. Name the frame of the poses "
                "with --poses-in and the link with --poses-of."
            )
    measured = None
    if poses.measures and (stated.base is not None or stated.tip is not None):
        fitted = robot_of(robot, stated, measured=arm.joint_names)
        rows, pose = poses.measurements(stated.kind)
        measured = MeasuredThere(fitted, rows, stated, arm.joint_names, pose)
    return JointTable(arm, shown, joint_values(shown, poses.T_base_flange, measured), poses)
