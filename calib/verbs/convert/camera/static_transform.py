"""The pose of a camera as ROS 2 publishes it: a call of static_transform_publisher, or a launch file with one.

    ros2 run tf2_ros static_transform_publisher --x X ... --qw QW --frame-id PARENT --child-frame-id CHILD

The pose is that of the child frame in its parent, the translation in m, the rotation as a unit quaternion. Named
arguments are those of ROS 2 Humble and later; the positional ones before them were removed.
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
from calib.basics.values import Value
from calib.errors import FileError

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
    """A pose that does not change, between two frames of tf2."""

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
        """The arguments of static_transform_publisher, numbers with every digit."""
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
    """Return a shell script, or by the ending `LAUNCH` a launch file, that publishes a pose.

    Args:
        transform: The pose.
        about: What it is, for the first comment.
        path: The file that is to be written.

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
    _check_text(text, transform, path)
    return text.encode()


def _check_text(text: str, transform: StaticTransform, path: Path) -> None:
    """Refuse a file whose numbers, read back, are not the pose."""
    numbers = dict(re.findall(r"--(q?[xyzw])['\", ]+([-+.\de]+)", text))
    values = [float(numbers[name]) for name in _NUMBERS]
    T_read = np.eye(4)
    T_read[:3, :3] = Rotation.from_quat(values[3:]).as_matrix()
    T_read[:3, 3] = values[:3]
    if not np.abs(T_read - transform.T_parent_child).max() <= _TOLERANCE:
        raise FileError(
            f"{path}: the pose of '{transform.child}' does not read back. It is not written. Please report this."
        )
