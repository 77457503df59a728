"""What is taken out of messages: joint values and poses, each with its stamp, by the type of the message."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from calib.errors import MeasurementError, choices, did_you_mean

#: The type of joint values.
JOINTS = "sensor_msgs/msg/JointState"

#: Types of pictures.
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
IMAGES = (IMAGE, COMPRESSED_IMAGE)

#: A type whose messages have several poses, of which one is chosen by the names of frames.
TRANSFORMS = "tf2_msgs/msg/TFMessage"

#: The same under its name of the first years of ROS.
_OLD_TRANSFORMS = "tf/msg/tfMessage"

#: A measured pose: position [m], and quaternion with the scalar last, or None of a point.
Pose: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float, float] | None]


def stamp(header: Any) -> int:  # noqa: ANN401  a message
    """Return the stamp of a header in nanoseconds; 0 if it was never set."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _position(vector: Any) -> tuple[float, float, float]:  # noqa: ANN401
    """Return the position of a message with x, y, z [m]."""
    return float(vector.x), float(vector.y), float(vector.z)


def _pose(position: Any, orientation: Any) -> Pose:  # noqa: ANN401
    """Return the pose of a position and a quaternion."""
    turn = orientation
    return _position(position), (float(turn.x), float(turn.y), float(turn.z), float(turn.w))


#: By type the function from a message to its pose.
_POSES: Mapping[str, Callable[[Any], Pose]] = MappingProxyType(
    {
        "geometry_msgs/msg/PointStamped": lambda m: (_position(m.point), None),
        "geometry_msgs/msg/Vector3Stamped": lambda m: (_position(m.vector), None),
        "geometry_msgs/msg/PoseStamped": lambda m: _pose(m.pose.position, m.pose.orientation),
        "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _pose(
            m.pose.pose.position, m.pose.pose.orientation
        ),
        "geometry_msgs/msg/TransformStamped": lambda m: _pose(
            m.transform.translation, m.transform.rotation
        ),
        "nav_msgs/msg/Odometry": lambda m: _pose(m.pose.pose.position, m.pose.pose.orientation),
    }
)

#: All types of measured points and poses.
POINTS = (*_POSES, TRANSFORMS, _OLD_TRANSFORMS)


class PointReader:
    """Takes the poses of one topic out of its messages."""

    def __init__(self, type_name: str, frames: tuple[str, ...], what: str) -> None:
        """Choose what is taken.

        Args:
            type_name: The type of the messages.
            frames: Of transforms the child frame, or its parent and the child frame; of other types empty.
            what: The topic, and the bag it is in, for messages.

        Raises:
            MeasurementError: The type is none of poses, or frames are named of a type that has none, or are missing.
        """
        if type_name not in POINTS:
            raise MeasurementError(
                f"{what} has messages of the type {type_name}; measured points are read from {', '.join(POINTS)}."
            )
        self._several = type_name in (TRANSFORMS, _OLD_TRANSFORMS)
        if frames and not self._several:
            raise MeasurementError(
                f"{what} has messages of the type {type_name}, one pose in each; leave out ':{':'.join(frames)}'."
            )
        self._of = None if self._several else _POSES[type_name]
        self._frames = frames
        self._what = what
        #: By child frame the parents that were met.
        self._met: dict[str, dict[str, None]] = {}

    def poses(self, message: Any) -> Iterable[tuple[int, Pose]]:  # noqa: ANN401
        """Return stamps [ns] and poses of a message; none if a transform is of other frames."""
        if self._of is not None:
            return [(stamp(message.header), self._of(message))]
        found = []
        for each in message.transforms:
            child, parent = _frame(each.child_frame_id), _frame(each.header.frame_id)
            self._met.setdefault(child, {})[parent] = None
            wanted = tuple(_frame(name) for name in self._frames)
            if wanted and wanted in ((child,), (parent, child)):
                pose = _pose(each.transform.translation, each.transform.rotation)
                found.append((stamp(each.header), pose))
        return found

    def check(self) -> None:
        """Refuse, after all messages, frames that were not met, or a child with several parents.

        Raises:
            MeasurementError: As said.
        """
        if not self._several:
            return
        listed = choices(list(self._met), limit=30)
        if not self._frames:
            raise MeasurementError(
                f"{self._what} has transforms of several frames; name the one that was measured, TOPIC:FRAME: {listed}."
            )
        child = _frame(self._frames[-1])
        parents = self._met.get(child)
        if parents is None:
            raise MeasurementError(
                f"{self._what} has no transform of the frame '{child}'{did_you_mean(child, self._met)}; it has those "
                f"of {listed}."
            )
        if len(self._frames) == 1 and len(parents) > 1:
            raise MeasurementError(
                f"{self._what} has transforms of '{child}' in the frames {choices(parents)}; name one of these too, "
                "TOPIC:PARENT:FRAME."
            )
        if len(self._frames) > 1 and _frame(self._frames[0]) not in parents:
            raise MeasurementError(
                f"{self._what} has no transform of '{child}' in the frame '{self._frames[0]}'; it has those in "
                f"{choices(parents)}."
            )


def _frame(name: str) -> str:
    """Return the name of a frame without the slash that the first ROS put before it."""
    return name.lstrip("/")


def grey(message: Any) -> np.ndarray | None:  # noqa: ANN401
    """Return the grey values of a picture, shape (height, width), uint8.

    Colours are weighted as in ITU-R BT.601. A mosaic of Bayer is averaged with the weights 1 2 1 / 2 4 2 / 1 2 1, which
    has as much of each colour at every pixel, whatever the order of its colours.

    Args:
        message: A sensor_msgs/Image.

    Returns:
        The grey values; None if the encoding is not one of pictures, as of depth.
    """
    encoding = message.encoding.lower()
    bits = 16 if encoding.endswith("16") else 8
    sizes = {"mono": 1, "bayer": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4, "uyvy": 2, "yuyv": 2}
    names = {"yuv422": "uyvy", "yuv422_yuy2": "yuyv", "8uc1": "mono", "8uc3": "bgr", "8uc4": "bgra"}
    name = names.get(encoding, encoding)
    kind = "bayer" if name.startswith("bayer") else name.rstrip("0123456789")
    if kind not in sizes:
        return None
    order = ">" if message.is_bigendian and bits > 8 else "<"
    data = np.frombuffer(message.data, dtype=f"{order}u{bits // 8}")
    step = message.step // (bits // 8)
    lines = data[: step * message.height].reshape(message.height, step)
    used = lines[:, : message.width * sizes[kind]].reshape(message.height, message.width, -1)
    if bits > 8:
        used = used >> 8
    pixels = used.astype(np.uint8)
    if kind == "mono":
        return pixels[:, :, 0]
    if kind == "uyvy":
        return pixels[:, :, 1]
    if kind == "yuyv":
        return pixels[:, :, 0]
    if kind == "bayer":
        wide = np.pad(pixels[:, :, 0].astype(np.float32), 1, mode="reflect")
        rows = wide[:-2] + 2.0 * wide[1:-1] + wide[2:]
        both = (rows[:, :-2] + 2.0 * rows[:, 1:-1] + rows[:, 2:]) / 16.0
        return np.asarray(np.rint(both), dtype=np.uint8)
    weights = np.array([0.299, 0.587, 0.114])
    if kind.startswith("bgr"):
        weights = weights[::-1]
    return np.asarray(np.rint(pixels[:, :, :3] @ weights), dtype=np.uint8)
