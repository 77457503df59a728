"""Texts that ``calib bag`` prints: topics, clocks, lags, stops, and the next command."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence

from calib.show.lines import fill, number, plural
from calib.verbs.bag.bag import BagTable
from calib.verbs.bag.bag_file import Bag
from calib.verbs.bag.lag import Lag, NoLag
from calib.verbs.bag.messages import IMAGES, JOINTS, POINTS, TRANSFORMS
from calib.verbs.bag.recording import Clock
from calib.verbs.bag.table import Skipped

#: So many stops that are skipped are listed.
_LISTED = 10

#: Why stamps are not used.
_WHY = {
    "unset": "its stamps are not set",
    "rate": "its stamps do not run as the recorder's clock does",
    "scatter": "its stamps scatter by half a second and more",
    "stated": "as stated",
}

#: Why there is no lag.
_NO_LAG = {
    "no_motion": "no motion that both saw tells it",
    "unclear": "another shift explains the motion as well",
}

#: What to do about it.
_REMEDY = {
    "no_motion": "If points were measured only while the arm stood, a small lag does not matter; otherwise state it "
    "(--lag).",
    "unclear": "Give the robot (--robot), or state the lag (--lag).",
}

#: Why a stop is skipped.
_SKIPPED = {
    "short": "too short",
    "no_point": "no point of {topic}",
    "no_image": "no picture of {topic}",
}


def topics_text(bag: Bag, path: str) -> list[str]:
    """List the topics of a bag, and the command that makes a table of it.

    Args:
        bag: The bag.
        path: Its name in the call.
    """
    lines = [f"{path}: {plural(len(bag.topics), 'topic')}, {number(bag.duration, 1)} s.", ""]
    width = max(len(topic.name) for topic in bag.topics)
    types = max(len(topic.type) for topic in bag.topics)
    lines.append(f"  {'topic':<{width}}  {'type':<{types}}  {'messages':>8}  {'per s':>7}")
    for topic in bag.topics:
        rate = number(topic.count / bag.duration, 1) if bag.duration > 0.0 else ""
        lines.append(f"  {topic.name:<{width}}  {topic.type:<{types}}  {topic.count:>8}  {rate:>7}")
    by_count = sorted(bag.topics, key=lambda topic: -topic.count)
    joints = [topic.name for topic in by_count if topic.type == JOINTS and topic.count]
    points = [topic for topic in by_count if topic.type in POINTS and topic.count]
    single = [topic for topic in points if topic.type != TRANSFORMS]
    images = [topic.name for topic in by_count if topic.type in IMAGES and topic.count]
    words = ["calib", "bag", path]
    if joints:
        words += ["--joints", joints[0]]
    if single:
        words += ["--points", single[0].name]
    elif points:
        words += ["--points", f"{points[0].name}:FRAME"]
    if images:
        words += ["--images", images[0], "--pictures", "pictures"]
    lines.append("")
    if not joints or not (points or images):
        missing = "joint values" if not joints else "points and pictures"
        lines.append(fill(f"The bag has no {missing} that calib reads (docs/bags.md)."))
        return lines
    if points:
        words += ["-o", "table.csv"]
    return [*lines, f"Next: {shlex.join(words)}"]


def table_text(made: BagTable) -> list[str]:
    """Word what was read, the lags, and the stops.

    Args:
        made: The table.
    """
    recording = made.recording
    joints = recording.joints
    span = joints.times[-1] - joints.times[0]
    counts = {recording.clocks[0][0]: f"{plural(len(joints.names), 'joint')}"}
    counts |= {
        each.topic: plural(len(each.times), "pose" if each.has_poses else "point")
        for each in recording.points
    }
    rates = {recording.clocks[0][0]: 1.0 / joints.interval}
    for each in recording.points:
        length = each.times[-1] - each.times[0]
        rates[each.topic] = (len(each.times) - 1) / length if length > 0.0 else 0.0
    lines = [
        fill(
            f"{topic}: {counts[topic]}, {number(rates[topic], 1)} per s, {_clock_text(clock)}",
            "",
            "  ",
        )
        for topic, clock in recording.clocks
    ]
    lines += [fill(line, "", "  ") for line in _lag_lines(made)]
    if made.stopped:
        lines.append(fill(f"{plural(len(made.spans), 'stop')} in {number(span, 1)} s.", "", "  "))
    elif recording.points:
        lines.append(
            fill(
                f"The arm hardly stops in {number(span, 1)} s: {plural(made.count, 'row')} of the moving arm, with the "
                "joint values at the times of the points.",
                "",
                "  ",
            )
        )
    return [*lines, *skipped_lines(made.skipped)]


def skipped_lines(skipped: Sequence[Skipped]) -> list[str]:
    """List stops that are not used, with time and reason."""
    if not skipped:
        return []
    lines = ["Skipped:"]
    for each in skipped[:_LISTED]:
        reason = _SKIPPED[each.code].format(topic=each.topic)
        lines.append(f"- {each.begin:.2f} s, {each.length:.2f} s long: {reason}")
    if len(skipped) > _LISTED:
        lines.append(f"- and {len(skipped) - _LISTED} more")
    return lines


def next_lines(
    made: BagTable, table: str | None, pictures: str | None, robot: str | None
) -> list[str]:
    """Write the next commands: of the table, and of the pictures.

    Args:
        made: The table.
        table: The file that was written; None: none.
        pictures: The folder of pictures; None: none.
        robot: The robot of the call; None: not given.
    """
    lines = []
    if table is not None:
        arm = robot or "robot.urdf"
        words = ["calib", "calibrate", arm, table, "--frame", "estimate"]
        words += ["-o", "corrected.urdf", "--json", "result.json"]
        lines.append(f"Next: {shlex.join(words)}")
    if pictures is not None:
        words = ["calib", "detect", pictures, "--board", "board.toml"]
        words += ["--joints", f"{pictures}/joints.csv", "-o", "corners.csv"]
        lines.append(f"Next: {shlex.join(words)}")
    if lines and robot is None and not made.sliding:
        lines.append(
            "All joints are taken to turn; name those that slide (--sliding), or give the robot (--robot)."
        )
    return lines


def _clock_text(clock: Clock) -> str:
    """Word by which clock a topic is."""
    if clock.by == "received":
        return f"by the times of receipt: {_WHY[clock.why]}."
    if clock.offset:
        side = "behind" if clock.offset > 0.0 else "ahead of"
        return (
            f"by its stamps, which are {number(abs(clock.offset))} s {side} the recorder's clock; this was taken "
            "out."
        )
    return "by its stamps."


def _lag_lines(made: BagTable) -> Iterator[str]:
    """Yield a line on the lag of each topic of points."""
    for topic, lag in made.lags.items():
        if isinstance(lag, Lag):
            side = "later" if lag.value >= 0.0 else "earlier"
            by = "the robot's kinematics" if lag.by_robot else "the moves alone"
            more = "" if lag.by_robot else " --robot makes it more certain."
            yield (
                f"Lag: {topic} is {abs(lag.value):.4f} s {side} than the joints, standard uncertainty "
                f"{number(1e3 * lag.sigma, 2)} ms, by {by} ({plural(lag.moves, 'part')} of the motion); taken out."
                f"{more}"
            )
        elif isinstance(lag, NoLag):
            yield f"Lag: not found for {topic}, {_NO_LAG[lag.code]}; none is taken out. {_REMEDY[lag.code]}"
        else:
            yield f"Lag: {topic} is {lag:g} s later than the joints, as stated; taken out."
