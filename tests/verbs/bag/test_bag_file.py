"""Bags of all kinds, whole and damaged, and as another program writes them."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from calib.errors import MeasurementError
from calib.verbs.bag.bag_file import open_bag
from calib.verbs.bag.streams import JointStream
from tests.verbs.bag.bags import BEGIN, KINDS, Messages

NAMES = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of each kind with the same 50 messages."""
    made = tmp_path_factory.mktemp("bags")
    times = np.arange(50) * 0.01
    q = np.column_stack([times, -times])
    stream = JointStream(NAMES, times, q, np.ones_like(q))
    for kind in KINDS:
        messages = Messages(kind)
        path = made / ("run.bag" if kind == "bag" else f"run_{kind}")
        messages.write(path, kind, messages.joints(stream, "/joint_states"))
    return made


PATHS = ("run.bag", "run_db3", "run_mcap", "run_db3/run_db3.db3", "run_mcap/run_mcap.mcap")


@pytest.mark.parametrize("name", [*PATHS, "run_mcap/metadata.yaml"])
def test_a_bag_of_any_kind_has_the_same_messages(folder: Path, name: str):
    with open_bag(folder / name) as bag:
        (topic,) = bag.topics
        assert (topic.name, topic.type, topic.count) == (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            50,
        )
        assert bag.begin == round(BEGIN * 1e9)
        assert bag.duration == pytest.approx(0.49, abs=1e-6)
        found = list(bag.messages(["/joint_states"]))
        assert [received for _, received, _ in found] == [
            round((BEGIN + 0.01 * k) * 1e9) for k in range(50)
        ]
        assert tuple(found[7][2].name) == NAMES
        np.testing.assert_array_equal(found[7][2].position, [0.07, -0.07])
        part = bag.messages(["/joint_states"], np.array([[0.095, 0.195], [0.3, 0.3]]))
        assert [message.position[0] for _, _, message in part] == pytest.approx(
            np.arange(10, 20) * 0.01
        )
        assert list(bag.messages([])) == []


def test_a_file_without_its_description_is_read_in_its_folder(folder: Path, tmp_path: Path):
    shutil.copy(folder / "run_mcap" / "run_mcap.mcap", tmp_path / "only.mcap")
    with open_bag(tmp_path) as bag:
        assert bag.topics[0].count == 50
    shutil.copy(folder / "run_mcap" / "run_mcap.mcap", tmp_path / "other.mcap")
    with (
        pytest.raises(MeasurementError, match=r"several bags.*'only.mcap', 'other.mcap'"),
        open_bag(tmp_path),
    ):
        pass  # fmt: skip


def test_a_wrong_topic_is_answered_with_those_like_it(folder: Path):
    with open_bag(folder / "run.bag") as bag:
        assert bag.topic("joint_states", "--joints").name == "/joint_states"
        with pytest.raises(MeasurementError, match="did you mean '/joint_states'"):
            bag.topic("/joint_state", "--joints")


@pytest.mark.parametrize("name", [name for name in PATHS if "." in name])
def test_a_damaged_bag_is_refused(folder: Path, tmp_path: Path, name: str):
    """Cut off anywhere, or with other bytes in it: a message of calib, or all that is whole."""
    data = (folder / name).read_bytes()
    path = tmp_path / Path(name).name
    rng = np.random.default_rng(0)
    said = []
    for k in range(25):
        broken = bytearray(data)
        if k % 2:
            broken = broken[: rng.integers(0, len(data))]
        else:
            place = rng.integers(0, len(data) - 64)
            broken[place : place + 64] = rng.bytes(64)
        path.write_bytes(bytes(broken))
        try:
            with open_bag(path) as bag:
                for _ in bag.messages(["/joint_states"]):
                    pass
        except MeasurementError as error:
            said.append(str(error))
    assert len(said) > 8
    assert all(str(path) in text for text in said)


@pytest.mark.parametrize("name", ["there_is_none.bag", "text.txt", "empty"])
def test_what_is_no_bag_is_refused(tmp_path: Path, name: str):
    (tmp_path / "text.txt").write_text("no bag")
    (tmp_path / "empty").mkdir()
    with pytest.raises(MeasurementError), open_bag(tmp_path / name):
        pass


def test_without_rosbags_the_extra_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(MeasurementError, match=r"robot-calib\[bag\]"), open_bag(folder / "run.bag"):
        pass
