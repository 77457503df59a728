"""From a bag to a table that calib calibrates with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from calib.robot.robot import Robot
from calib.verbs.bag.bag import BagTable, bag
from calib.verbs.bag.lag import Lag, NoLag
from calib.verbs.bag.streams import PointStream
from tests.verbs.bag.bags import KINDS, Messages
from tests.verbs.bag.motions import Motion, stop_and_go, streams, wandering

LAG = 0.734


@pytest.fixture(scope="module")
def ur5() -> Robot:
    return Robot.load("ur5", base="base_link", tip="tool0")


@pytest.fixture(scope="module")
def motion() -> Motion:
    return stop_and_go(np.random.default_rng(1), stops=6, rest=1.4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, ur5: Robot, motion: Motion) -> Path:
    """The same recording as a bag of each kind; the tracker's clock is 183.25 s ahead, its points come 0.734 s late."""
    made = tmp_path_factory.mktemp("runs")
    joints, points = streams(
        motion, ur5, np.random.default_rng(2), LAG, joint_rate=60.0, point_rate=40.0
    )
    for kind in KINDS:
        m = Messages(kind)
        path = made / ("run.bag" if kind == "bag" else f"run_{kind}")
        m.write(path, kind, m.joints(joints, "/joints"), m.points(points, "/tracker", clock=183.25))
    return made


def made(path: Path, *points: str, **options) -> BagTable:
    return bag(path, "/joints", points, **options)


def test_all_kinds_of_bags_make_one_table(folder: Path, tmp_path: Path, motion: Motion, ur5: Robot):
    texts = set()
    for kind in KINDS:
        table = made(folder / ("run.bag" if kind == "bag" else f"run_{kind}"), "/tracker")
        texts.add(table.write(tmp_path / f"{kind}.csv").read_bytes())
        assert (len(table.spans), table.count, table.skipped) == (6, 6, ())
        lag = table.lags["/tracker"]
        assert isinstance(lag, Lag)
        assert lag.value == pytest.approx(LAG, abs=5e-3)
    assert len(texts) == 1
    read = Measurements.read(tmp_path / "bag.csv", ur5.joint_names)
    poses = np.array([motion.at(np.array([begin + 0.5]))[0] for begin, _ in motion.rests])
    np.testing.assert_allclose(read.joints, poses, atol=2e-5)
    # One rigid motion takes the target of the robot at these poses to the points.
    T = ur5.poses(poses)
    tip = T[:, :3, 3] + T[:, :3, :3] @ [0.05, -0.03, 0.12]
    a, b = tip - tip.mean(axis=0), read.points - read.points.mean(axis=0)
    assert np.linalg.norm(a, axis=1) == pytest.approx(np.linalg.norm(b, axis=1), abs=1e-4)


def test_a_stated_lag_and_a_robot(folder: Path, ur5: Robot):
    path = folder / "run_mcap"
    assert made(path, "/tracker", lags={"": 0.7}).lags == {"/tracker": 0.7}
    lag = made(path, "/tracker", robot=ur5).lags["/tracker"]
    assert isinstance(lag, Lag)
    assert lag.by_robot
    assert lag.value == pytest.approx(LAG, abs=1e-3)
    with pytest.raises(MeasurementError, match="--lag names '/other'"):
        made(path, "/tracker", lags={"/other": 0.7})
    # A lag that is wrong by more than a stop leaves nothing to measure at some of them.
    wrong = made(path, "/tracker", lags={"": -60.0})
    assert wrong.count == 0
    assert {each.code for each in wrong.skipped} == {"no_point"}
    with pytest.raises(MeasurementError, match="no row with a point"):
        wrong.write(path.parent / "none.csv")


def test_an_arm_that_does_not_stop(tmp_path: Path, ur5: Robot):
    rng = np.random.default_rng(3)
    moving = wandering(rng, duration=30.0, dt=5e-3)
    joints, points = streams(
        moving, ur5, rng, 0.3, jitter=0.0, joint_rate=60.0, point_rate=40.0, noise=0.0
    )
    m = Messages("mcap")
    path = m.write(tmp_path / "run", "mcap", m.joints(joints, "/joints"), m.points(points, "/p"))
    table = made(path, "/p", robot=ur5)
    assert not table.stopped
    assert table.count > 900
    read = Measurements.read(table.write(tmp_path / "table.csv"), ur5.joint_names)
    times = np.array([row.time for row in table.rows])
    np.testing.assert_allclose(read.joints, moving.at(times), atol=5e-4)
    assert made(path, "/p", robot=ur5, moving=False).count == 0


def test_one_point_a_stop_needs_no_lag(tmp_path: Path, ur5: Robot, motion: Motion):
    rng = np.random.default_rng(4)
    joints, points = streams(motion, ur5, rng, 0.0, joint_rate=60.0, jitter=0.0)
    at = [np.searchsorted(points.times, end - 0.4) for _, end in motion.rests]
    single = PointStream("", "", "", points.times[at], points.positions[at], points.quaternions[at])
    m = Messages("mcap")
    path = m.write(tmp_path / "run", "mcap", m.joints(joints, "/joints"), m.points(single, "/p"))
    table = made(path, "/p")
    assert table.lags == {"/p": NoLag("no_motion")}
    assert table.count == 6
    header = table.write(tmp_path / "t.csv").read_text().splitlines()[0]
    assert "sigma" not in header


def test_several_topics_need_names(folder: Path):
    for points in (("/tracker", "/tracker"), ("/tracker", "/joints")):
        with pytest.raises(MeasurementError, match="--points names"):
            made(folder / "run_mcap", *points)


def test_a_joint_that_slides_and_is_none(folder: Path, tmp_path: Path):
    table = made(folder / "run_mcap", "/tracker", sliding=["elbow_joint"])
    assert "elbow_joint [mm]" in table.write(tmp_path / "t.csv").read_text()
    with pytest.raises(MeasurementError, match="--sliding names 'rail'"):
        made(folder / "run_mcap", "/tracker", sliding=["rail"])
