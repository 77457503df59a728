"""Pictures at the stops, found again by `calib detect`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.detection.picture import find_images, read_image
from calib.errors import MeasurementError
from calib.verbs.bag.bag_file import open_bag
from calib.verbs.bag.pictures import ImageTopic, write_pictures
from calib.verbs.bag.streams import JointStream
from calib.verbs.detect.matching import match, read_joint_table
from tests.verbs.bag.bags import BEGIN, KINDS, Messages

T = np.arange(0.0, 6.0, 0.02)
#: Three stops of two seconds.
Q = np.column_stack([np.floor(T / 2.0), -np.floor(T / 2.0)])
JOINTS = JointStream(("a", "rail"), T, Q, np.full_like(Q, np.nan))
SPANS = np.array([[0.5, 1.9], [2.5, 3.9], [4.5, 5.9]])


def grey_of(time: float) -> int:
    return 10 + round(20 * time)


def pixels(time: float) -> np.ndarray:
    return np.full((6, 8), grey_of(time), np.uint8)


def images(m: Messages, topic: str, times: np.ndarray, late: float = 0.2):
    """Pictures that are received later than they are taken."""
    m.types[topic] = "sensor_msgs/msg/Image"
    for time in times:
        yield time + late, topic, m.image(time, pixels(time), "mono8")


def compressed(m: Messages, topic: str, times: np.ndarray):
    m.types[topic] = "sensor_msgs/msg/CompressedImage"
    for time in times:
        data = cv2.imencode(".png", pixels(time))[1].reshape(-1)
        yield time, topic, m(m.types[topic], m.header(BEGIN + time), "mono8; png compressed", data)


@pytest.mark.parametrize("kind", KINDS)
def test_the_picture_in_the_middle_of_each_stop(tmp_path: Path, kind: str):
    m = Messages(kind)
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    times = np.arange(0.0, 6.0, 0.1)
    events = (images(m, "/left", times), compressed(m, "/right", times[:38]))
    m.write(path, kind, m.joints(JOINTS, "/joints"), *events)
    folder = tmp_path / "pictures"
    topics = [ImageTopic.parse("left=/left"), ImageTopic.parse("right=/right")]
    with open_bag(path) as bag:
        count, skipped = write_pictures(bag, topics, JOINTS, SPANS, folder, sliding=["rail"])
    assert count == 5
    assert [(each.code, each.topic, each.begin) for each in skipped] == [("no_image", "/right", 4.5)]  # fmt: skip
    table = read_joint_table(folder / "joints.csv")
    files = find_images([folder])
    matches = match(table, files)
    assert matches.unmatched == ()
    assert matches.cameras == ("left", "left", "left", "right", "right")
    middles = SPANS.mean(axis=1)
    for file, row in zip(files, matches.rows, strict=True):
        assert row is not None
        k = int(file.path.stem[-4:]) - 1
        assert np.unique(read_image(file)) == [grey_of(middles[k])]
        assert float(table.cell(row, table.columns["a"])) == pytest.approx(np.degrees(k))
        assert float(table.cell(row, table.columns["rail"])) == pytest.approx(-1e3 * k)


def test_what_is_no_picture_is_refused(tmp_path: Path):
    m = Messages("mcap")

    def depth(topic: str):
        m.types[topic] = "sensor_msgs/msg/Image"
        for time in (1.0, 1.2):
            yield time, topic, m.image(time, np.ones((4, 4), np.float32), "32FC1")

    def odd(topic: str):
        m.types[topic] = "sensor_msgs/msg/CompressedImage"
        data = np.zeros(40, np.uint8)
        yield 1.2, topic, m(m.types[topic], m.header(BEGIN + 1.2), "compressedDepth", data)

    m.write(tmp_path / "run", "mcap", m.joints(JOINTS, "/joints"), depth("/depth"), odd("/odd"))
    with open_bag(tmp_path / "run") as bag:
        for topic, said in (("/depth", "32FC1"), ("/odd", "compressedDepth"), ("/joints", "JointState")):  # fmt: skip
            with pytest.raises(MeasurementError, match=said):
                write_pictures(bag, [ImageTopic(topic, "")], JOINTS, SPANS, tmp_path / "p")
