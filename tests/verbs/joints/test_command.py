"""``calib joints``: a table with poses in, one with joint values out."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from calib.robot.robot import Robot

#: A Panda whose third joint does not move, from its base to its flange.
PANDA = (
    "panda",
    "--hold",
    "panda_joint3=0.1 rad",
    "--poses-in",
    "panda_link0",
    "--poses-of",
    "panda_link8",
)


def poses(tmp_path: Path, robot: Robot, q: np.ndarray) -> Path:
    path = tmp_path / "poses.csv"
    T = robot.poses(q)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            [f"flange_{axis} [m]" for axis in "xyz"]
            + [f"flange_r{i}{j}" for i in "123" for j in "123"]
            + ["image"]
        )
        for n, pose in enumerate(T):
            writer.writerow(
                [
                    *map(repr, pose[:3, 3].tolist()),
                    *map(repr, pose[:3, :3].ravel().tolist()),
                    f"{n}.png",
                ]
            )
    return path


def test_joint_values_are_written_where_the_limits_decide(call, tmp_path: Path):
    robot = Robot.load("panda", tip="panda_link8", held={"panda_joint3": 0.1})
    q = np.array([0.2, -0.4, -2.0, 0.1, 1.9, 0.6]) + np.linspace(0.0, 0.5, 5)[:, None]
    output = tmp_path / "with.csv"
    done = call(tmp_path, "joints", PANDA[0], poses(tmp_path, robot, q), *PANDA[1:], "-o", output)
    assert (done.code, done.err) == (0, "")
    assert "Joint values are unique" in done.out
    with output.open() as file:
        (*rows,) = csv.DictReader(file)
    assert [row["image"] for row in rows] == [f"{n}.png" for n in range(5)]
    found = [[float(row[f"{name} [deg]"]) for name in robot.joint_names] for row in rows]
    np.testing.assert_allclose(np.radians(found), q, atol=1e-10)


def test_nothing_is_written_where_they_are_not_unique(call, tmp_path: Path):
    robot = Robot.load("ur5", base="base", tip="tool0")
    q = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.4]) + np.linspace(0.0, 0.5, 3)[:, None]
    table, output = poses(tmp_path, robot, q), tmp_path / "with.csv"
    words = ("joints", "ur5", table, "--poses-in", "base", "--poses-of", "tool0", "-o", output)
    done = call(tmp_path, *words)
    assert done.code == 3
    assert "not unique at 3 poses (rows 1, 2, 3)" in " ".join(done.err.split())
    assert not output.exists()
    assert call(tmp_path, *words, "--accept").code == 0
    assert output.exists()


def test_a_controller_s_own_arm_has_as_many_joints(call, tmp_path: Path):
    robot = Robot.load("ur5", base="base", tip="tool0")
    table = poses(tmp_path, robot, np.full((2, 6), 0.5))
    done = call(
        tmp_path,
        "joints",
        "ur5",
        table,
        "--poses-in",
        "base",
        "--poses-of",
        "tool0",
        "--controller",
        "so101",
    )
    assert done.code == 1
    assert "'base'" in done.err
