"""Streams of joint values and points, read from a bag in one pass, and the clock that each of them is on.

A message has the time when the recorder received it, and mostly a stamp in its header, set where it was measured.
Stamps do not have the jitter of the network, so they are used if they run as the recorder's clock does. Those of
another computer may be off by minutes; if they are off by more than `SAME_CLOCK`, the median difference is taken out:

    time = stamp + median(received - stamp).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.jobs import Progress
from calib.basics.values import Value
from calib.errors import MeasurementError, choices, did_you_mean
from calib.verbs.bag.bag_file import NANOSECOND, Bag
from calib.verbs.bag.messages import JOINTS, PointReader, stamp
from calib.verbs.bag.streams import JointStream, PointStream, Publisher, merged

#: How times are chosen: by the stamps if they are plausible, or as stated.
Stamps = Literal["auto", "header", "received"]

#: Clocks that differ by less are taken as one; the rest is lag [s].
SAME_CLOCK = 1.0

#: Stamps run as the recorder's clock does if a second of theirs is a second of its within this.
_SAME_RATE = 0.01

#: Stamps of a stream shorter than this are not asked for their rate [s].
_SHORT = 5.0

#: Stamps scatter against the time of receipt by less than this (median), or they are no time of the measurement [s].
_PLAUSIBLE_SCATTER = 0.5


@dataclass(frozen=True, slots=True)
class Clock(Value):
    """The clock of a topic's times."""

    #: ``header``: its stamps; ``received``: the recorder's times.
    by: str
    #: What was added to the stamps [s]; 0 if they are on the recorder's clock.
    offset: float
    #: Why stamps are not used: ``unset``, ``rate``, ``scatter``, ``stated``; empty if they are.
    why: str = ""


@dataclass(frozen=True, slots=True)
class PointTopic(Value):
    """A topic of points, as a call names it."""

    #: Name of the topic.
    name: str
    #: Of transforms the child frame, or parent and child.
    frames: tuple[str, ...] = ()
    #: Names of the instrument's place and of the target; empty: one of each.
    group: str = ""
    target: str = ""

    @classmethod
    def parse(cls, text: str) -> PointTopic:
        """Return the topic that a text names: ``[GROUP[/TARGET]=]TOPIC[:FRAME]``.

        Example:
            >>> PointTopic.parse("left/ball=/tf:base:ball")
            PointTopic(name='/tf', frames=('base', 'ball'), group='left', target='ball')
        """
        names, sign, topic = text.rpartition("=")
        group, _, target = names.partition("/") if sign else ("", "", "")
        name, *frames = topic.strip().split(":")
        return cls(name, tuple(frames), group.strip(), target.strip())

    @property
    def label(self) -> str:
        """The topic with its frames, for messages."""
        return ":".join((self.name, *self.frames))


@dataclass(frozen=True, slots=True)
class Recording(Value):
    """Joint values and points of a bag, on one clock."""

    joints: JointStream
    points: tuple[PointStream, ...]
    #: The clock of each topic by its label, the joints' first.
    clocks: tuple[tuple[str, Clock], ...]


def read_recording(
    bag: Bag,
    joints: str,
    points: Sequence[PointTopic] = (),
    *,
    wanted: Sequence[str] | None = None,
    without: Sequence[str] = (),
    stamps: Stamps = "auto",
    progress: Progress | None = None,
) -> Recording:
    """Read joint values and points of a bag.

    Args:
        bag: The bag.
        joints: Topic of the joint values.
        points: Topics of points.
        wanted: Names of the joints that are wanted, in this order; None: all that are sent.
        without: Joints that are left out.
        stamps: Which times are used.
        progress: Called with the messages read and all that are to be read; None: nothing is called.

    Raises:
        MeasurementError: A topic is not there, is of another type, or lacks a joint or frame.
    """
    topic = bag.topic(joints, "--joints")
    if topic.type != JOINTS:
        of_joints = [each.name for each in bag.topics if each.type == JOINTS]
        raise MeasurementError(
            f"{bag.source}: '{topic.name}' of --joints has messages of the type {topic.type}; joint values are read "
            f"from {JOINTS}: {choices(of_joints) if of_joints else 'the bag has no such topic'}."
        )
    readers: dict[str, list[tuple[PointTopic, PointReader]]] = {}
    total = topic.count
    for each in points:
        of_points = bag.topic(each.name, "--points")
        what = f"{bag.source}: '{of_points.name}' of --points"
        if of_points.name not in readers:
            total += of_points.count
        reader = PointReader(of_points.type, each.frames, what)
        readers.setdefault(of_points.name, []).append((each, reader))

    sent: dict[tuple[str, ...], tuple[list[tuple[int, int]], list[Array], list[Array]]] = {}
    seen: dict[str, tuple[list[tuple[int, int]], list[list[float]]]] = {
        each.label: ([], []) for each in points
    }
    messages = bag.messages([topic.name, *readers])
    for done, (name, received, message) in enumerate(messages, start=1):
        if name == topic.name:
            names = tuple(message.name)
            if names and len(message.position) == len(names):
                times, values, speeds = sent.setdefault(names, ([], [], []))
                times.append((stamp(message.header), received))
                values.append(message.position)
                has_speeds = len(message.velocity) == len(names)
                speeds.append(message.velocity if has_speeds else np.full(len(names), np.nan))
        for each, reader in readers.get(name, ()):
            for stamped, (position, turn) in reader.poses(message):
                times, rows = seen[each.label]
                times.append((stamped, received))
                rows.append([*position, *(turn or (np.nan,) * 4)])
        if progress is not None and done % _REPORTED == 0:
            progress(done, total)

    for of_topic in readers.values():
        for _, reader in of_topic:
            reader.check()
    if not sent:
        raise MeasurementError(
            f"{bag.source}: no message of '{topic.name}' has positions of named joints; name another topic of the type "
            f"{JOINTS} as --joints."
        )
    joint_stream, clock = _joints(bag, sent, wanted, without, stamps)
    clocks = [(topic.name, clock)]
    streams = []
    for each in points:
        times, rows = seen[each.label]
        stream, clock = _points(bag, each, times, np.array(rows), stamps)
        streams.append(stream)
        clocks.append((each.label, clock))
    return Recording(joint_stream, tuple(streams), tuple(clocks))


#: Progress is said after so many messages.
_REPORTED = 500


def _joints(
    bag: Bag,
    sent: dict[tuple[str, ...], tuple[list[tuple[int, int]], list[Array], list[Array]]],
    wanted: Sequence[str] | None,
    without: Sequence[str],
    stamps: Stamps,
) -> tuple[JointStream, Clock]:
    """Return the stream of the wanted joints, and its clock."""
    all_names = list(dict.fromkeys(name for names in sent for name in names))
    for name in without:
        if name not in all_names and name not in (wanted or ()):
            raise MeasurementError(
                f"{bag.source}: --without names the joint '{name}', which is not sent"
                f"{did_you_mean(name, all_names)}. The joints: {choices(all_names, limit=30)}."
            )
    names = [name for name in (wanted or all_names) if name not in without]
    missing = [name for name in names if name not in all_names]
    if missing:
        raise MeasurementError(
            f"{bag.source}: the robot's joint {choices(missing)} is not sent; the bag has "
            f"{choices(all_names, limit=30)}. Leave it out (--without), or give the robot of this bag."
        )
    if not names:
        raise MeasurementError(f"{bag.source}: --without leaves no joint; leave out fewer.")
    pairs = np.concatenate([np.array(times, dtype=np.int64) for times, _, _ in sent.values()])
    clock = _clock(pairs, stamps)
    publishers = []
    for of_names, (times, values, speeds) in sent.items():
        q = np.array(values, dtype=np.float64)
        finite = np.isfinite(q).all(axis=1)
        at = _times(bag, np.array(times, dtype=np.int64), clock)
        v = np.array(speeds, dtype=np.float64)
        publishers.append(Publisher(of_names, at[finite], q[finite], v[finite]))
    return merged(publishers, names), clock


def _points(
    bag: Bag, topic: PointTopic, pairs: Sequence[tuple[int, int]], rows: Array, stamps: Stamps
) -> tuple[PointStream, Clock]:
    """Return the stream of a topic of points, and its clock."""
    both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    finite = np.isfinite(rows[:, :3]).all(axis=1)
    both, rows = both[finite], rows[finite]
    if not len(rows):
        raise MeasurementError(f"{bag.source}: '{topic.label}' of --points has no finite position.")
    clock = _clock(both, stamps)
    times, index = np.unique(_times(bag, both, clock), return_index=True)
    turns = rows[index, 3:]
    length = np.linalg.norm(turns, axis=1)
    if np.isfinite(length).all():
        # A driver that does not measure orientations leaves them at one value, or at zero.
        unmeasured = length.min() < _NO_TURN or np.ptp(turns, axis=0).max() < _NO_TURN
        turns = np.full_like(turns, np.nan) if unmeasured else turns / length[:, None]
    stream = PointStream(
        topic.label, topic.group, topic.target, times, np.array(rows[index, :3]), turns
    )
    return stream, clock


#: Quaternions that differ by less are one.
_NO_TURN = 1e-9


def _clock(pairs: Integers, stamps: Stamps) -> Clock:
    """Choose the clock of messages by their stamps and times of receipt, shape (N, 2) [ns]."""
    if stamps == "received":
        return Clock("received", 0.0, "stated")
    difference = (pairs[:, 1] - pairs[:, 0]) * NANOSECOND
    offset = float(np.median(difference))
    shift = offset if abs(offset) > SAME_CLOCK else 0.0
    if stamps == "header":
        return Clock("header", shift)
    if (pairs[:, 0] == 0).any():
        return Clock("received", 0.0, "unset")
    first, last = np.argmin(pairs[:, 1]), np.argmax(pairs[:, 1])
    span = (pairs[last] - pairs[first]) * NANOSECOND
    if span[1] > _SHORT and abs(span[0] / span[1] - 1.0) > max(_SAME_RATE, 1.0 / span[1]):
        return Clock("received", 0.0, "rate")
    if np.median(np.abs(difference - offset)) > _PLAUSIBLE_SCATTER:
        return Clock("received", 0.0, "scatter")
    return Clock("header", shift)


def _times(bag: Bag, pairs: Integers, clock: Clock) -> Array:
    """Return the times of messages, shape (N,) [s] from the beginning of the bag, of (N, 2) [ns]."""
    if clock.by == "received":
        return np.asarray((pairs[:, 1] - bag.begin) * NANOSECOND)
    # Whole nanoseconds first: seconds since 1970 as a float have steps of 0.2 microseconds.
    return np.asarray((pairs[:, 0] + round(clock.offset / NANOSECOND) - bag.begin) * NANOSECOND)
