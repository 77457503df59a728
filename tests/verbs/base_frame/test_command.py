"""``calib base-frame``: what it prints and writes, round trips to ``calib calibrate``, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import PAPER_TARGET, paper_urdf
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.verbs.base_frame.virtual_sweeps import virtual_sweeps, write_sweeps

T_TRUE = pin.exp6(np.array([2.0, 1.0, -0.5, 0.3, -0.8, 1.2])).homogeneous
ROBOT = ("--robot", "robot.urdf", "--base", "base", "--tip", "tool0")


@pytest.fixture
def bench(shop: Path) -> Path:
    """Sweeps in a tracker's frame, the same as a tracker's list, and measurements of the same tracker."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    sweeps = virtual_sweeps(robot, T_TRUE, 33e-6, arcs=np.radians([270.0, 180.0]))
    write_sweeps(sweeps, shop / "sweeps.csv")
    lines = ["# Units: mm"]
    for sweep, name in zip(sweeps.sweeps, ("plane", "joint1", "joint2"), strict=True):
        for i, point in enumerate(1e3 * sweep.points, 1):
            lines.append(f"A::Main::{name}_{i:02d} " + " ".join(repr(float(v)) for v in point))
    (shop / "swept.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    q = random_joint_values(robot, 30, 1)
    T = robot.poses(q)
    points = T[:, :3, :3] @ np.array(PAPER_TARGET) + T[:, :3, 3]
    points = points @ T_TRUE[:3, :3].T + T_TRUE[:3, 3]
    points += 3e-5 * np.random.default_rng(0).normal(size=points.shape)
    Measurements(robot.joint_names, q, points).write(shop / "seen.csv")
    return shop


def test_the_frame_is_printed_with_how_well_it_is_known(call, bench: Path):
    done = call(bench, "base-frame", "sweeps.csv", *ROBOT)
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Base frame from sweeps.csv: the link 'base' of ur3."
    xyz = next(line for line in done.lines if line.startswith("  x y z")).split()[3:6]
    assert [float(v) for v in xyz] == pytest.approx(1e3 * T_TRUE[:3, 3], abs=0.05)
    text = " ".join(done.out.split())
    for said in (
        "Along and about the axes of the base std 95 % within",
        "shoulder_pan_joint 40 300.0",
        "270.0",
        "shoulder_pan_joint 90.00",
        "the residuals look like noise",
    ):
        assert said in text
    assert max(map(len, done.lines)) <= 100


def test_without_a_robot_from_a_tracker_s_list(call, bench: Path):
    done = call(bench, "base-frame", "--points", "swept.txt", "--plane-offset", "19.05 mm")
    assert (done.code, done.err) == (0, "")
    assert "z along axis 1, y along axis 2, origin where axis 1 meets the plane" in done.out
    assert "To the next axis" in done.out
    xyz = next(line for line in done.lines if line.startswith("  x y z")).split()[3:6]
    lowered = T_TRUE[:3, 3] - 0.01905 * T_TRUE[:3, 2]
    assert [float(v) for v in xyz] == pytest.approx(1e3 * lowered, abs=0.05)


def test_the_cell_file_goes_into_fit(call, bench: Path):
    done = call(
        bench, "base-frame", "sweeps.csv", *ROBOT, "--cell-out", "frame.toml", "--json", "f.json"
    )
    assert done.lines[-2:] == ["Written: frame.toml", "Written: f.json"]
    table = json.loads((bench / "f.json").read_text(encoding="utf-8"))
    cell = Cell.read(bench / "frame.toml")
    assert cell.T_frame_base == pytest.approx(np.array(table["frame"]["T_tracker_base"]), abs=1e-12)
    fitted = call(
        bench, "fit", "robot.urdf", "seen.csv", "--cell", "frame.toml", "--model", "frames",
        "--no-validate", "--json", "r.json",
    )  # fmt: skip
    assert (fitted.code, fitted.err) == (0, "")
    result = json.loads((bench / "r.json").read_text(encoding="utf-8"))
    assert result["errors"]["calibrated"]["estimation"]["m"]["rms"] < 1e-4


def test_findings_are_printed(call, bench: Path):
    lines = (bench / "sweeps.csv").read_text(encoding="utf-8").splitlines()
    cells = lines[30].split(",")
    cells[1] = repr(float(cells[1]) + 2.0)
    lines[30] = ",".join(cells)
    (bench / "bad.csv").write_text("\n".join(lines), encoding="utf-8")
    done = call(bench, "base-frame", "bad.csv", *ROBOT)
    text = " ".join(done.out.split())
    assert "Findings: - bad.csv, row 30 (sweep 'shoulder_pan_joint') is " in text
    assert "was ignored: measure it again." in text
