"""A bag in, a table of measurements out: streams are read, their lag is found, stops are averaged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from calib.basics.arguments import (
    check_callable,
    check_number,
    check_path,
    check_type,
    wrong_type,
)
from calib.basics.arrays import Array
from calib.basics.files import write_atomically
from calib.basics.jobs import Progress
from calib.basics.values import Value, one_line
from calib.errors import MeasurementError, choices
from calib.robot.robot import Robot
from calib.verbs.bag.bag_file import Bag, open_bag
from calib.verbs.bag.lag import Lag, NoLag, find_lag
from calib.verbs.bag.recording import PointTopic, Recording, Stamps, read_recording
from calib.verbs.bag.stops import find_stops
from calib.verbs.bag.table import (
    FEWEST_STOPS,
    Row,
    Settings,
    Skipped,
    moving_rows,
    stop_rows,
    table_bytes,
    used_spans,
)


@dataclass(frozen=True, slots=True, eq=False)
class BagTable(Value):
    """Rows of a table of measurements, made of a bag."""

    #: Joint values and points over time.
    recording: Recording
    #: By topic of points its lag behind the joints: found, not found, or as stated [s].
    lags: Mapping[str, Lag | NoLag | float]
    #: shape (S, 2), what is used of each stop [s]; empty if the arm moved all the time.
    spans: Array
    #: Stops that are not used, and why.
    skipped: tuple[Skipped, ...]
    #: The rows, in the order of time.
    rows: tuple[Row, ...]
    #: Names of the joints that slide.
    sliding: tuple[str, ...]

    def __repr__(self) -> str:
        """Return one line, such as ``BagTable(25 stops, 25 rows)``."""
        return one_line("BagTable", f"{len(self.spans)} stops", f"{self.count} rows")

    @property
    def count(self) -> int:
        """Number of rows with a point."""
        return sum(row.samples > 0 for row in self.rows)

    @property
    def stopped(self) -> bool:
        """True if the rows are of stops, not of a moving arm."""
        return len(self.spans) > 0

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the table (CSV).

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Raises:
            MeasurementError: No row has a point.
            FileError: The file exists, or cannot be written.
        """
        if not self.count:
            raise MeasurementError(
                "There is no row with a point, so no table is written: no point was measured while the arm stood. Is "
                "the lag right (--lag), and were the stops long enough (--settle, --shortest)?"
            )
        content = table_bytes(self.recording.joints.names, self.sliding, self.rows)
        return write_atomically(path, content, overwrite=overwrite)


def bag(
    path: str | Path,
    joints: str,
    points: Sequence[str] = (),
    *,
    robot: Robot | str | Path | None = None,
    tip: str | None = None,
    settle: float = 0.5,
    shortest: float = 0.3,
    without: Sequence[str] = (),
    sliding: Sequence[str] = (),
    stamps: Stamps = "auto",
    lags: Mapping[str, float] | None = None,
    moving: bool | None = None,
    progress: Progress | None = None,
) -> BagTable:
    """Make a table of measurements from a ROS bag, without ROS.

    Args:
        path: File ``.bag``, ``.mcap`` or ``.db3``, or the folder of a rosbag 2.
        joints: Topic of the joint values.
        points: Topics of measured points or poses, ``[GROUP[/TARGET]=]TOPIC[:FRAME]``.
        robot: The nominal robot, a path or its name: its joints are taken, and its kinematics make the lag more
            certain; None: all joints that are sent, and the lag by the moves alone.
        tip: Link of the robot that carries the target; None: the end of the longest chain.
        settle: The arm settles for so long after it has stopped [s].
        shortest: Stops of which less is left are skipped [s].
        without: Joints that are left out.
        sliding: Joints that slide, if there is no robot that says so.
        stamps: Times of messages: ``header``, ``received``, or ``auto``.
        lags: How much later points are stamped than joint values, where it is known, by topic [s]; ``""`` for all.
        moving: Whether rows are of a moving arm; None: if it hardly stops.
        progress: Called with messages read and all messages; None: nothing is called.

    Returns:
        Rows, lags, and what was skipped; its method ``write`` writes the table.

    Raises:
        ArgumentError: An argument of another type.
        MeasurementError: The bag cannot be read, a topic, joint or frame is not there, or nothing was measured.
    """
    check_path("path", path)
    check_type("joints", joints, str, "the name of a topic")
    for argument, given in (("points", points), ("without", without), ("sliding", sliding)):
        is_list = isinstance(given, (list, tuple)) and all(isinstance(name, str) for name in given)
        if not is_list:
            raise wrong_type(argument, given, "a list of names")
    allowed = "a Robot, the path of its file, its name, or None"
    check_type("robot", robot, (Robot, str, Path, type(None)), allowed)
    check_number("settle", settle, 0.0)
    check_number("shortest", shortest, 0.05)
    check_type("lags", lags, (Mapping, type(None)), "lags by topic, or None")
    for lag in (lags or {}).values():
        check_number("lags", lag)
    if stamps not in get_args(Stamps):
        raise wrong_type("stamps", stamps, choices(get_args(Stamps)))
    check_type("moving", moving, (bool, type(None)), "True, False or None")
    check_callable("progress", progress)
    arm = Robot.load(robot, None, tip) if isinstance(robot, (str, Path)) else robot
    with open_bag(path) as opened:
        return bag_table(
            opened,
            joints,
            points,
            robot=arm,
            settings=Settings(settle, shortest),
            without=without,
            sliding=sliding,
            stamps=stamps,
            lags=lags,
            moving=moving,
            progress=progress,
        )


def bag_table(
    opened: Bag,
    joints: str,
    points: Sequence[str] = (),
    *,
    robot: Robot | None = None,
    settings: Settings | None = None,
    without: Sequence[str] = (),
    sliding: Sequence[str] = (),
    stamps: Stamps = "auto",
    lags: Mapping[str, float] | None = None,
    moving: bool | None = None,
    progress: Progress | None = None,
) -> BagTable:
    """Do as `bag` with a bag that is open; ``settings`` are ``settle`` and ``shortest``, None: the defaults."""
    chosen = settings or Settings()
    topics = [PointTopic.parse(text) for text in points]
    _check_names(topics)
    recording = read_recording(
        opened,
        joints,
        topics,
        wanted=None if robot is None else robot.joint_names,
        without=without,
        stamps=stamps,
        progress=progress,
    )
    stream = recording.joints
    unknown = [name for name in sliding if name not in stream.names]
    if unknown:
        raise MeasurementError(
            f"--sliding names {choices(unknown)}, which is none of the joints: {choices(stream.names, limit=30)}."
        )
    slides = set(sliding)
    if robot is not None:
        slides |= {name for name, kind in robot.joint_types.items() if kind == "prismatic"}
    found: dict[str, Lag | NoLag | float] = {}
    stated = lags or {}
    labels = {"", *(each.topic for each in recording.points)}
    if not labels.issuperset(stated):
        there = choices(sorted(labels - {""})) or "none is given"
        raise MeasurementError(
            f"--lag names {choices(sorted(set(stated) - labels))}, which is none of --points: {there}."
        )
    kinematic = robot if robot is not None and stream.names == robot.joint_names else None
    for each in recording.points:
        value = stated.get(each.topic, stated.get(""))
        found[each.topic] = find_lag(stream, each, kinematic) if value is None else value
    taken_out = {topic: lag_value(lag) for topic, lag in found.items()}
    spans, skipped = used_spans(find_stops(stream), chosen)
    stops = len(spans) >= FEWEST_STOPS if moving is None else not moving
    if stops or not topics:
        rows, missing = stop_rows(stream, recording.points, taken_out, spans)
        skipped = sorted([*skipped, *missing], key=lambda each: each.begin)
    else:
        rows = moving_rows(stream, recording.points, taken_out)
        spans, skipped = np.zeros((0, 2)), []
    return BagTable(
        recording,
        found,
        spans,
        tuple(skipped),
        tuple(rows),
        tuple(name for name in stream.names if name in slides),
    )


def lag_value(lag: Lag | NoLag | float) -> float:
    """Return the lag that is taken out [s]: 0 if none was found."""
    if isinstance(lag, Lag):
        return lag.value
    return 0.0 if isinstance(lag, NoLag) else lag


def _check_names(topics: Sequence[PointTopic]) -> None:
    """Refuse several topics whose rows could not be told apart."""
    labels = [topic.label for topic in topics]
    names = [(topic.group, topic.target) for topic in topics]
    for k, topic in enumerate(topics):
        if labels.index(topic.label) < k:
            raise MeasurementError(f"--points names '{topic.label}' twice; name each topic once.")
        if names.index((topic.group, topic.target)) < k:
            raise MeasurementError(
                f"--points names several topics, and '{topic.label}' has the same names as another one. Say which is "
                "of another instrument, GROUP=TOPIC, or of another target, GROUP/TARGET=TOPIC or /TARGET=TOPIC."
            )
