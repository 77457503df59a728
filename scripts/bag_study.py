"""Bags of 100 MB of three kinds, and planted lags: the figures of docs/bags.md.

    python scripts/bag_study.py bags            # one recording as rosbag 1, rosbag 2 and MCAP: one table? how long?
    python scripts/bag_study.py stops 60        # lags of 0.05 to 4 s in random recordings, with and without a robot
    python scripts/bag_study.py moving 12       # the same of an arm that does not stop

The motion is that of a UR5 by calib's kinematics; bags are written with rosbags.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from calib.robot.robot import Robot
from calib.verbs.bag.lag import Lag, find_lag

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.verbs.bag.bags import KINDS, Messages
from tests.verbs.bag.motions import stop_and_go, streams, wandering

#: Rates of joints, points and pictures in the bags [1/s].
_JOINTS, _POINTS, _PICTURES = 500.0, 300.0, 1.0

#: The lag and the clock of the tracker in the bags [s].
_LAG, _CLOCK = 1.234, -432.1


def bags() -> None:
    """Write a recording as a bag of each kind, run ``calib bag`` on it, and compare the tables."""
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    rng = np.random.default_rng(0)
    motion = stop_and_go(rng, stops=60, rest=2.0, dt=1e-3)
    joints, points = streams(
        motion, robot, rng, _LAG, joint_rate=_JOINTS, point_rate=_POINTS, jitter=1e-3
    )
    texts = []
    with TemporaryDirectory() as folder:
        for kind in KINDS:
            m = Messages(kind)
            m.types["/camera"] = "sensor_msgs/msg/Image"
            noise = rng.integers(0, 256, (480, 640), dtype=np.uint8)
            pictures = (
                (at, "/camera", m.image(at, noise, "mono8"))
                for at in np.arange(0.0, motion.duration, 1.0 / _PICTURES)
            )
            path = Path(folder) / ("run.bag" if kind == "bag" else f"run_{kind}")
            m.write(
                path,
                kind,
                m.joints(joints, "/joint_states"),
                m.points(points, "/tracker", clock=_CLOCK),
                pictures,
            )
            files = [path] if path.is_file() else list(path.iterdir())
            size = sum(file.stat().st_size for file in files) / 1e6
            table = Path(folder) / f"{kind}.csv"
            words = ["bag", str(path), "--joints", "/joint_states", "--points", "/tracker"]
            words += ["--images", "/camera", "--pictures", str(Path(folder) / f"pictures_{kind}")]
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            begin = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "calib", *words, "-o", str(table)],
                check=True,
                capture_output=True,
            )
            seconds = time.perf_counter() - begin
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            memory = after.ru_maxrss / 1e3
            work = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            texts.append(table.read_bytes())
            rows = texts[-1].count(b"\n") - 1
            print(
                f"{kind}: {size:.0f} MB, {len(joints.times) + len(points.times)} messages: {rows} rows in "
                f"{seconds:.1f} s, {work:.1f} s of work of a core, at most {memory:.0f} MB of memory so far"
            )
    print("one table" if len(set(texts)) == 1 else "tables differ")


def lags(name: str, runs: int) -> None:
    """Plant lags in random recordings, and print the errors of those that are found.

    Args:
        name: ``stops`` or ``moving``.
        runs: Number of recordings.
    """
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    errors: dict[str, list[float]] = {"moves alone": [], "robot": []}
    standardised: dict[str, list[float]] = {"moves alone": [], "robot": []}
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        lag = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.05), np.log(4.0)))
        if name == "stops":
            shape = rng.choice(["trapezoid", "quintic"])
            motion = stop_and_go(rng, stops=20, rest=1.5, shape=shape, dt=1e-3)
        else:
            motion = wandering(rng, duration=120.0, dt=2e-3)
        joints, points = streams(
            motion,
            robot,
            rng,
            lag,
            joint_rate=np.exp(rng.uniform(np.log(30.0), np.log(500.0))),
            point_rate=np.exp(rng.uniform(np.log(30.0), np.log(500.0))),
            jitter=rng.uniform(0.0, 4e-3),
            drops=rng.uniform(0.0, 0.1),
            noise=np.exp(rng.uniform(np.log(2e-5), np.log(5e-4))),
        )
        for way, arm in (("moves alone", None), ("robot", robot)):
            found = find_lag(joints, points, arm)
            if not isinstance(found, Lag):
                print(f"{name}, {way}, seed {seed}: {found.code}")
                continue
            errors[way].append(found.value - lag)
            standardised[way].append((found.value - lag) / found.sigma)
    for way, values in errors.items():
        ms = 1e3 * np.abs(values)
        z = np.array(standardised[way])
        print(
            f"{name}, {way}: {len(ms)} of {runs} found, rms {np.sqrt(np.mean(ms**2)):.2f} ms, 95 % "
            f"{np.quantile(ms, 0.95):.2f} ms, max {ms.max():.2f} ms; error / sigma rms "
            f"{np.sqrt(np.mean(z**2)):.2f}, within 2 sigma {100.0 * np.mean(np.abs(z) < 2.0):.0f} %"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["bags"]:
        bags()
    elif sys.argv[1:2] in (["stops"], ["moving"]):
        lags(sys.argv[1], int(sys.argv[2]))
    else:
        sys.exit(__doc__)
