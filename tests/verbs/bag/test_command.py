"""``calib bag``: a bag in, a table out, and the next command typed."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from calib.robot.robot import Robot
from tests.verbs.bag.bags import Messages
from tests.verbs.bag.motions import stop_and_go, streams


@pytest.fixture(scope="module")
def run_mcap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(1)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    motion = stop_and_go(rng, stops=10, rest=1.5)
    joints, points = streams(motion, robot, rng, 0.2, joint_rate=60.0, point_rate=40.0)
    m = Messages("mcap")

    def pictures():
        m.types["/camera"] = "sensor_msgs/msg/Image"
        for time in np.arange(0.0, motion.duration, 0.2):
            yield time, "/camera", m.image(time, np.zeros((4, 6), np.uint8), "mono8")

    path = tmp_path_factory.mktemp("run") / "run"
    events = (m.joints(joints, "/joint_states"), m.points(points, "/tracker"), pictures())
    return m.write(path, "mcap", *events) / "run.mcap"


def test_the_topics_then_the_table_then_the_calibration(call, tmp_path: Path, run_mcap: Path):
    listed = call(tmp_path, "bag", run_mcap)
    assert listed.code == 0
    assert f"calib bag {run_mcap} --joints /joint_states --points /tracker" in listed.out
    words = shlex.split(listed.lines[-1].removeprefix("Next: calib "))
    done = call(tmp_path, *words, "--robot", "ur5", "--tip", "tool0")
    assert (done.code, done.err) == (0, "")
    assert "10 stops" in done.out
    assert "Lag: /tracker is 0.2" in done.out
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 11
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 10
    following = [line for line in done.lines if line.startswith("Next: ")]
    assert [shlex.split(line)[2] for line in following] == ["calibrate", "detect"]
    fit = shlex.split(following[0].removeprefix("Next: calib "))
    assert call(tmp_path, *fit, "--model", "zeros", "--no-validate").code in (0, 3)
    assert (tmp_path / "result.json").exists()
    # What exists is kept.
    again = call(tmp_path, *words)
    assert again.code == 1
    assert "table.csv" in again.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--points", "/tracker"), "--joints"),
        (("--joints", "/joint_states"), "State what was measured"),
        (("--joints", "/joint_states", "--images", "/camera"), "--pictures"),
        (("--joints", "/joint_state", "--points", "/tracker"), "did you mean '/joint_states'"),
        (("--joints", "/joint_states", "--points", "/tracker", "--lag", "soon"), "--lag"),
        (("--joints", "/joint_states", "--points", "/tracker", "--lag", "nan"), "--lag"),
        (
            ("--joints", "/joint_states", "--images", "/camera", "--pictures", "p", "-o", "t.csv"),
            "-o is the table of --points",
        ),
    ],
)
def test_wrong_calls(call, tmp_path: Path, run_mcap: Path, words: tuple[str, ...], said: str):
    done = call(tmp_path, "bag", run_mcap, *words)
    assert done.code == 1
    assert said in done.err
    assert not list(tmp_path.iterdir())
