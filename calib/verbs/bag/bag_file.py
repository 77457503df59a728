"""A ROS bag as topics and messages, without ROS: rosbag 1, rosbag 2 (sqlite3), and MCAP, read with rosbags.

A rosbag 2 is a folder with ``metadata.yaml``; a single ``.mcap`` or ``.db3`` of one is read too. Messages are decoded
by the definitions in the bag, or if it has none by those of the ROS distributions, which agree on the types that are
read here.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.errors import MeasurementError, choices, did_you_mean

#: Endings of a bag's files, in lower case.
ENDINGS = (".bag", ".mcap", ".db3")

#: The description of a rosbag 2.
_METADATA = "metadata.yaml"

#: Times of messages are whole numbers of these [s].
NANOSECOND = 1e-9


@dataclass(frozen=True, slots=True)
class Topic(Value):
    """A topic of a bag."""

    #: Its name, such as ``/joint_states``.
    name: str
    #: Type of its messages, such as ``sensor_msgs/msg/JointState``.
    type: str
    #: Number of its messages.
    count: int


@dataclass(frozen=True, eq=False)
class Bag:
    """An open bag."""

    #: The name that was given, for messages.
    source: str
    #: Its topics, by name.
    topics: tuple[Topic, ...]
    #: When the recorder received the first message, in nanoseconds since 1970, and how long it recorded [s].
    begin: int
    duration: float
    #: The reader of rosbags, and whether it is one of ROS 2.
    _reader: Any = field(repr=False)
    _is_ros2: bool = field(repr=False)

    def topic(self, name: str, option: str) -> Topic:
        """Return a topic by its name.

        Args:
            name: Its name, with or without the slash before it.
            option: The option that names it, for the message.

        Raises:
            MeasurementError: The bag does not have it, or it has no messages.
        """
        by_name = {topic.name: topic for topic in self.topics}
        found = by_name.get(name) or by_name.get(f"/{name}")
        if found is None:
            raise MeasurementError(
                f"{self.source}: {option} names the topic '{name}', which the bag does not have"
                f"{did_you_mean(name, by_name)}. Its topics: {choices(by_name, limit=30)}."
            )
        if not found.count:
            raise MeasurementError(
                f"{self.source}: the topic '{name}' of {option} has no message; was its publisher running?"
            )
        return found

    def messages(
        self, names: Collection[str], spans: Array | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        """Iterate over the messages of topics, as the recorder received them; one is held at a time.

        Args:
            names: Names of the topics.
            spans: shape (S, 2), increasing beginnings and ends [s], from the first message of the bag: messages that
                were received outside of them are passed over, without being decoded. None: none is.

        Yields:
            The topic, the time of receipt in nanoseconds since 1970, and the message with the fields of its type.

        Raises:
            MeasurementError: The bag is damaged.
        """
        wanted = [each for each in self._reader.connections if each.topic in names]
        if not wanted:  # to rosbags this means all
            return
        edges = None if spans is None else np.ravel(spans)
        stores: dict[Any, Any] = {}
        with _refusing_damage(self.source):
            for connection, received, data in self._reader.messages(wanted):
                if edges is not None:
                    at = (received - self.begin) * NANOSECOND
                    if np.searchsorted(edges, at, side="right") % 2 == 0:
                        continue
                key = (connection.topic, connection.id)
                if key not in stores:
                    stores[key] = _store(connection, is_ros2=self._is_ros2)
                store = stores[key]
                decode = store.deserialize_cdr if self._is_ros2 else store.deserialize_ros1
                yield connection.topic, received, decode(data, connection.msgtype)


@contextmanager
def open_bag(path: str | Path) -> Iterator[Bag]:
    """Open a bag.

    Args:
        path: A file ``.bag``, ``.mcap`` or ``.db3``, or the folder of a rosbag 2.

    Yields:
        The bag.

    Raises:
        MeasurementError: It does not exist, is no bag, is damaged, or rosbags is not installed.
    """
    source = str(path)
    file = _file_of(Path(path))
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError as error:
        raise MeasurementError(
            f"{source}: ROS bags are read with rosbags, which is not installed: pip install 'robot-calib[bag]'"
        ) from error
    is_ros2 = file.suffix.lower() != ".bag"
    with _refusing_damage(source):
        reader: Any = Reader2(file) if is_ros2 else Reader1(file)
        reader.open()
    try:
        with _refusing_damage(source):
            topics = tuple(
                Topic(name, info.msgtype or "several types", info.msgcount)
                for name, info in sorted(reader.topics.items())
            )
            begin, end = reader.start_time, reader.end_time
        if not any(topic.count for topic in topics):
            raise MeasurementError(f"{source}: the bag has no message; record it again.")
        yield Bag(source, topics, begin, (end - begin) * NANOSECOND, reader, is_ros2)
    finally:
        reader.close()


def _file_of(path: Path) -> Path:
    """Return the file, or the folder with a description, that a path names; MeasurementError if it is no bag."""
    if path.name == _METADATA:
        path = path.parent
    if path.is_dir():
        if (path / _METADATA).is_file():
            return path
        inside = sorted(each for each in path.iterdir() if each.suffix.lower() in ENDINGS)
        if len(inside) == 1:
            return inside[0]
        if inside:
            raise MeasurementError(
                f"{path}: the folder has no {_METADATA} and several bags; name one of them: "
                f"{choices([each.name for each in inside])}. Or make the file with 'ros2 bag reindex'."
            )
        raise MeasurementError(
            f"{path}: the folder is no bag; a rosbag 2 has the file {_METADATA}, and beside it .db3 or .mcap."
        )
    if not path.exists():
        raise MeasurementError(f"The bag '{path}' does not exist; check the name and the folder.")
    if path.suffix.lower() not in ENDINGS:
        raise MeasurementError(
            f"{path}: a bag is a file {choices(ENDINGS)}, or the folder of a rosbag 2."
        )
    return path


@contextmanager
def _refusing_damage(source: str) -> Iterator[None]:
    """Raise what rosbags, or a package below it, says of a damaged bag as a MeasurementError."""
    try:
        yield
    except (OSError, MeasurementError):
        raise
    except Exception as error:
        said = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        remedy = "If the recording was cut off, mend it: 'rosbag reindex', 'ros2 bag reindex', 'mcap recover'"
        if "Profile is not ros2" in said:
            remedy = "Of MCAP only files of ROS 2 are read"
        raise MeasurementError(f"{source}: the bag cannot be read: {said}. {remedy}.") from error


def _store(connection: Any, *, is_ros2: bool) -> Any:  # noqa: ANN401  of rosbags
    """Return the definitions of types by which the messages of a connection are decoded."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if connection.msgdef.format == MessageDefinitionFormat.MSG:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        return store
    return get_typestore(Stores.ROS2_HUMBLE if is_ros2 else Stores.ROS1_NOETIC)
