"""The format ``static-transform``: a pose that ROS 2 publishes, by static_transform_publisher or a launch file with it.

    ros2 run tf2_ros static_transform_publisher --x X ... --qw QW --frame-id PARENT --child-frame-id CHILD

The pose is that of the child frame in its parent, the translation in m, the rotation as a unit quaternion. The
arguments are named, as in ROS 2 Humble and later, which no longer takes positional ones.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.basics.files import write_atomically
from calib.basics.values import Value
from calib.errors import CalibError, FileError
from calib.result.calibration import Calibration
from calib.result.transforms import LINK, ROBOT, find
from calib.show.lines import fill
from calib.verbs.convert.camera_frames import (
    check_names,
    estimated_board,
    estimated_camera,
)
from calib.verbs.convert.camera_mount import Handover, pose_text
from calib.verbs.convert.format import CameraOptions, Conversion, Format, Notes, Options, Source

#: Ending of launch files.
LAUNCH = ".py"

#: Arguments of the publisher for translation and rotation.
_NUMBERS = ("x", "y", "z", "qx", "qy", "qz", "qw")

#: A pose read back may differ by this [m; rotation matrices: 1].
_TOLERANCE = 1e-9

_LAUNCH_FILE = """\
# {about}

from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription(
        [
            Node(
                package="tf2_ros",
                executable="static_transform_publisher",
                arguments=[
{arguments}
                ],
            )
        ]
    )
"""


@dataclass(frozen=True, slots=True, eq=False)
class StaticTransform(Value):
    """A constant pose between two frames of tf2."""

    #: The frame in which the pose is given.
    parent: str
    #: The frame whose pose is given.
    child: str
    #: The pose, shape (4, 4) [m].
    T_parent_child: Array

    @property
    def quaternion(self) -> Array:
        """The rotation as x, y, z, w, shape (4,), with w >= 0."""
        xyzw: Array = np.array(pin.Quaternion(self.T_parent_child[:3, :3]).normalized().coeffs())
        return -xyzw if xyzw[3] < 0.0 else xyzw

    @property
    def arguments(self) -> list[str]:
        """The arguments of static_transform_publisher, each name followed by its value.

        They are --x --y --z [m], --qx --qy --qz --qw, all with every digit, --frame-id and --child-frame-id.
        """
        values = (*self.T_parent_child[:3, 3].tolist(), *self.quaternion.tolist())
        words = []
        for name, value in zip(_NUMBERS, values, strict=True):
            words += [f"--{name}", repr(value + 0.0)]
        return [*words, "--frame-id", self.parent, "--child-frame-id", self.child]

    @property
    def command(self) -> str:
        """The call of static_transform_publisher, in one line, for a shell."""
        return shlex.join(["ros2", "run", "tf2_ros", "static_transform_publisher", *self.arguments])


def file_of(transform: StaticTransform, about: str, path: Path) -> bytes:
    """Return the bytes of a ROS 2 launch file, if the path ends in .py, else of a shell script, that publishes a pose.

    Args:
        transform: The pose.
        about: A description of it, for the first comment.
        path: The file that is to be written; nothing is written here.

    Raises:
        FileError: The numbers do not read back.
    """
    comment = " ".join(about.split())
    if path.suffix.lower() == LAUNCH:
        words = transform.arguments
        pairs = zip(words[::2], words[1::2], strict=True)
        lines = [f"                    {name!r}, {value!r}," for name, value in pairs]
        text = _LAUNCH_FILE.format(about=comment, arguments="\n".join(lines))
    else:
        text = f"#!/bin/sh\n# {comment}\n{transform.command}\n"
    numbers = dict(re.findall(r"--(q?[xyzw])['\", ]+([-+.\de]+)", text))
    values = [float(numbers[name]) for name in _NUMBERS]
    T_read = np.eye(4)
    T_read[:3, :3] = Rotation.from_quat(values[3:]).as_matrix()
    T_read[:3, 3] = values[:3]
    if not np.abs(T_read - transform.T_parent_child).max() <= _TOLERANCE:
        raise FileError(
            f"{path}: the pose of '{transform.child}' does not read back. It is not written. Please report this."
        )
    return text.encode()


def transform_of(source: Source, options: CameraOptions) -> StaticTransform:
    """Return the pose to publish: that of the moved joint's child, else that of the frame in the link that carries it.

    Args:
        source: The calibration.
        options: Names of the camera or the board, and of the joint if one of the URDF is published with a new origin.

    Raises:
        CalibError: The source is not a calibration; or a camera and a board are named together, or neither.
        ModelError: There is no such camera or board, or no constant transform between parent and child.
        UrdfError: See `calib.verbs.convert.fixed_frames.mount_joint`.
    """
    check_names(options)
    if options.parent is not None and options.child is not None:
        calibration = source.require_calibration()
        found = calibration.transform(options.parent, options.child)
        parent, child = (_frame_id(calibration, name) for name in (options.parent, options.child))
        return StaticTransform(parent, child, found.pose)
    camera_frame = options.camera_frame or options.new_camera_frame
    if camera_frame is not None and options.new_board_frame is not None:
        raise CalibError(
            "One file publishes one frame: give --camera-frame for the camera, or --new-board-frame alone for the "
            "board."
        )
    if options.move is not None:
        placed = Handover.of(source, options).frames[0]
        joint = placed.joint
        return StaticTransform(joint.parent, joint.child, joint.T_parent_joint)
    calibration = source.require_calibration()
    if camera_frame is not None:
        estimated = estimated_camera(calibration, options.camera)
    else:
        estimated = estimated_board(calibration, options.board)
    child = camera_frame or options.new_board_frame or ""
    return StaticTransform(estimated.link, child, estimated.T_link_frame)


def _frame_id(calibration: Calibration, name: str) -> str:
    """Return the frame of tf2 that stands for a name: of a robot and a link the link, else the name itself."""
    placed = find(calibration, name)
    return placed.link if placed.what in (ROBOT, LINK) else placed.name


def _write(source: Source, path: Path, options: Options) -> Notes:
    """Write a shell script or, by its ending, a launch file that publishes the pose of a camera or a board."""
    transform = transform_of(source, options.camera)
    about = f"Pose of '{transform.child}' in '{transform.parent}' of {source.robot.name}, calibrated by calib."
    data = file_of(transform, about, path)
    write_atomically(path, data, overwrite=options.overwrite)
    return ()


def transform_text(conversion: Conversion) -> list[str]:
    """Word the pose that ROS publishes, and how to start it.

    Args:
        conversion: The conversion, to ``static-transform``.

    Returns:
        A paragraph of 100 columns, and the command.
    """
    transform = transform_of(conversion.source, conversion.options.camera)
    pose = pose_text(transform.T_parent_child)
    sentence = (
        f"'{transform.child}' is at {pose} in '{transform.parent}'. It goes with the corrected robot; publish it only "
        "if robot_state_publisher does not have this frame from its URDF, because a frame has one parent. MoveIt reads "
        "it from tf2, and needs nothing else"
    )
    calibration = conversion.source.calibration
    if calibration is not None and calibration.optics.cameras:
        sentence += (
            "; images and point clouds must come with the frame_id of the camera's optical frame"
        )
    path = shlex.quote(str(conversion.path))
    start = "ros2 launch" if conversion.path.suffix.lower() == LAUNCH else "sh"
    return [fill(f"{sentence}."), f"  {start} {path}"]


FORMATS = {
    "static-transform": Format(
        "a constant pose for ROS 2's static_transform_publisher",
        (".sh", LAUNCH),
        _write,
        of_camera=True,
        describe=transform_text,
    )
}
