"""Bags of the three kinds, written by rosbags from streams: what a robot and a tracker would have recorded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from calib.verbs.bag.streams import JointStream, PointStream

#: When the recordings begin [s] since 1970.
BEGIN = 1_760_000_000.0

KINDS = ("bag", "db3", "mcap")

Event = tuple[float, str, Any]  # time of receipt [s], topic, message


class Messages:
    """Makes messages of ROS 1 or ROS 2."""

    def __init__(self, kind: str) -> None:
        self.is_ros2 = kind != "bag"
        self.store = get_typestore(Stores.ROS2_HUMBLE if self.is_ros2 else Stores.ROS1_NOETIC)
        self.types: dict[str, str] = {}

    def __call__(self, type_name: str, *values: Any) -> Any:
        return self.store.types[type_name](*values)

    def header(self, stamp: float, frame: str = "base") -> Any:
        nanoseconds = round(stamp * 1e9)
        time = self("builtin_interfaces/msg/Time", *divmod(nanoseconds, 1_000_000_000))
        if self.is_ros2:
            return self("std_msgs/msg/Header", time, frame)
        return self("std_msgs/msg/Header", 0, time, frame)

    def joints(self, stream: JointStream, topic: str, clock: float = 0.0) -> Iterator[Event]:
        """Joint values, sent as stamped; the clock of the stamps is ahead of the recorder's."""
        self.types[topic] = "sensor_msgs/msg/JointState"
        names, nothing = list(stream.names), np.zeros(0)
        for time, q, v in zip(stream.times, stream.q, stream.speeds, strict=True):
            header = self.header(BEGIN + time + clock)
            speeds = np.array(v) if np.isfinite(v).all() else nothing
            yield time, topic, self(self.types[topic], header, names, np.array(q), speeds, nothing)

    def points(self, stream: PointStream, topic: str, clock: float = 0.0) -> Iterator[Event]:
        self.types[topic] = "geometry_msgs/msg/PointStamped"
        for time, p in zip(stream.times, stream.positions, strict=True):
            header = self.header(BEGIN + time + clock)
            yield time, topic, self(self.types[topic], header, self.vector("Point", p))

    def vector(self, kind: str, values: Iterable[float]) -> Any:
        return self(f"geometry_msgs/msg/{kind}", *map(float, values))

    def image(self, stamp: float, pixels: np.ndarray, encoding: str) -> Any:
        height, width = pixels.shape[:2]
        data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
        header = self.header(BEGIN + stamp, "camera")
        step = len(data) // height
        return self("sensor_msgs/msg/Image", header, height, width, encoding, 0, step, data)

    def write(self, path: Path, kind: str, *events: Iterable[Event]) -> Path:
        """Write events, each iterable in the order of its times; the bag's path, of rosbag 2 a folder."""
        with _writer(path, kind) as writer:
            connections: dict[str, Any] = {}
            for time, topic, message in merge(*events, key=lambda event: event[0]):
                name = self.types[topic]
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=self.store)
                serialize = self.store.serialize_cdr if self.is_ros2 else self.store.serialize_ros1
                data = serialize(message, name)
                writer.write(connections[topic], round((BEGIN + time) * 1e9), data)
        return path


@contextmanager
def _writer(path: Path, kind: str) -> Iterator[Any]:
    if kind == "bag":
        with Writer1(path) as writer:
            yield writer
        return
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        yield writer
