"""Streams read from bags, and the clocks that they are on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.errors import MeasurementError
from calib.verbs.bag.bag_file import open_bag
from calib.verbs.bag.recording import PointTopic, Recording, read_recording
from calib.verbs.bag.streams import JointStream, PointStream
from tests.verbs.bag.bags import BEGIN, Messages

T = np.arange(0.0, 12.0, 0.02)
Q = np.column_stack([np.sin(T), np.cos(T)])
JOINTS = JointStream(("a", "b"), T, Q, np.full_like(Q, np.nan))
POINTS = PointStream("/p", "", "", T, np.column_stack([T, T, T]), np.full((len(T), 4), np.nan))


def read(path: Path, points: tuple[str, ...] = ("/p",), **options: Any) -> Recording:
    with open_bag(path) as bag:
        return read_recording(bag, "/joints", [PointTopic.parse(p) for p in points], **options)


def write(folder: Path, *events: Any, messages: Messages | None = None) -> Path:
    made = messages or Messages("mcap")
    return made.write(folder / "run", "mcap", *(each(made) for each in events))


def test_stamps_of_one_clock_are_taken_as_they_are(tmp_path: Path):
    """Received late and irregularly: the stamps are the times."""
    late = 0.05 + 0.04 * np.random.default_rng(0).uniform(size=len(T))

    def joints(m: Messages):
        for (time, topic, message), delay in zip(m.joints(JOINTS, "/joints"), late, strict=True):
            yield time + delay, topic, message

    path = write(
        tmp_path,
        lambda m: sorted(joints(m), key=lambda event: event[0]),
        lambda m: m.points(POINTS, "/p"),
    )
    found = read(path)
    assert [clock.by for _, clock in found.clocks] == ["header", "header"]
    assert [clock.offset for _, clock in found.clocks] == [0.0, 0.0]
    np.testing.assert_allclose(found.joints.times, T, atol=1e-6)
    np.testing.assert_array_equal(found.joints.q, Q)
    np.testing.assert_array_equal(found.points[0].positions, POINTS.positions)
    assert not found.points[0].has_poses
    by_receipt = read(path, stamps="received")
    assert [clock.by for _, clock in by_receipt.clocks] == ["received", "received"]
    assert 0.05 < (by_receipt.joints.times - T).min() < 0.06


@pytest.mark.parametrize("clock", [-300.0, 3600.0])
def test_a_clock_that_is_minutes_off_is_brought_onto_the_recorder_s(tmp_path: Path, clock: float):
    path = write(
        tmp_path,
        lambda m: m.joints(JOINTS, "/joints"),
        lambda m: m.points(POINTS, "/p", clock=clock),
    )
    found = read(path)
    assert found.clocks[1][1].offset == pytest.approx(-clock, abs=1e-6)
    np.testing.assert_allclose(found.points[0].times, T, atol=1e-6)
    assert read(path, stamps="header").clocks[1][1].offset == pytest.approx(-clock, abs=1e-6)


@pytest.mark.parametrize(
    ("stamp", "why"),
    [
        (lambda time, _: 0.0 * time - BEGIN, "unset"),
        (lambda time, _: 0.5 * time, "rate"),
        (lambda time, rng: time + (1.0 < time < 11.0) * rng.uniform(-3.0, 3.0), "scatter"),
    ],
)
def test_stamps_that_are_no_times_are_not_used(tmp_path: Path, stamp: Any, why: str):
    rng = np.random.default_rng(0)

    def joints(m: Messages):
        for time, topic, message in m.joints(JOINTS, "/joints"):
            header = m.header(BEGIN + stamp(time, rng))
            yield time, topic, m("sensor_msgs/msg/JointState", header, *list(vars(message).values())[1:5])  # fmt: skip

    path = write(tmp_path, joints, lambda m: m.points(POINTS, "/p"))
    found = read(path)
    assert found.clocks[0][1].by == "received"
    assert found.clocks[0][1].why == why
    np.testing.assert_allclose(found.joints.times, T, atol=1e-6)


def test_joints_of_several_publishers_wanted_and_left_out(tmp_path: Path):
    gripper = JointStream(("finger",), T[::5] + 0.001, Q[::5, :1], np.ones((len(T[::5]), 1)))
    path = write(
        tmp_path,
        lambda m: m.joints(JOINTS, "/joints"),
        lambda m: m.joints(gripper, "/joints"),
        lambda m: m.points(POINTS, "/p"),
    )
    assert read(path).joints.names == ("a", "b", "finger")
    assert read(path, without=["finger"]).joints.names == ("a", "b")
    assert read(path, wanted=["b", "a"]).joints.names == ("b", "a")
    with pytest.raises(MeasurementError, match="did you mean 'finger'"):
        read(path, without=["fingr"])
    with pytest.raises(MeasurementError, match="'elbow' is not sent"):
        read(path, wanted=["a", "elbow"])
    assert read(path, wanted=["a", "elbow"], without=["elbow"]).joints.names == ("a",)


def test_poses_and_orientations_that_are_never_set(tmp_path: Path):
    turns = np.column_stack([0 * T, 0 * T, np.sin(T / 2), np.cos(T / 2)])

    def poses(m: Messages, topic: str, quaternions: np.ndarray):
        m.types[topic] = "geometry_msgs/msg/PoseStamped"
        for time, turn in zip(T, quaternions, strict=True):
            pose = m("geometry_msgs/msg/Pose", m.vector("Point", (1, 2, 3)), m.vector("Quaternion", turn))  # fmt: skip
            yield time, topic, m(m.types[topic], m.header(BEGIN + time), pose)

    path = write(
        tmp_path,
        lambda m: m.joints(JOINTS, "/joints"),
        lambda m: poses(m, "/turning", 2.0 * turns),
        lambda m: poses(m, "/identity", np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1))),
        lambda m: poses(m, "/zero", np.zeros((len(T), 4))),
    )
    found = read(path, ("/turning", "one=/identity", "other=/zero"))
    assert [each.has_poses for each in found.points] == [True, False, False]
    np.testing.assert_allclose(found.points[0].quaternions, turns, atol=1e-12)
    assert [each.group for each in found.points] == ["", "one", "other"]


def test_topics_of_other_types_are_refused_with_those_that_fit(tmp_path: Path):
    path = write(tmp_path, lambda m: m.joints(JOINTS, "/joints"), lambda m: m.points(POINTS, "/p"))
    with open_bag(path) as bag:
        with pytest.raises(MeasurementError, match="JointState: '/joints'"):
            read_recording(bag, "/p", [])
        with pytest.raises(MeasurementError, match="measured points are read from"):
            read_recording(bag, "/joints", [PointTopic("/joints")])
