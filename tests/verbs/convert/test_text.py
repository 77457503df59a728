"""A conversion in words: the displacement of the tip is that of the robots, and a note is said once."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.result.calibration import Calibration
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.verbs.convert.format import Conversion, Note, Source
from calib.verbs.convert.text import text


@pytest.fixture
def source(default_result: Calibration) -> Source:
    return Source(
        "result",
        default_result.corrected(default_result.nominal),
        default_result.nominal,
        verdict=default_result.verdict,
    )


def test_the_displacement_of_the_tip_is_that_of_the_robots(source: Source, tmp_path: Path):
    printed = text(Conversion(source, "dh", tmp_path / "rows.csv", ()), "result.json")
    q = spread_poses(source.nominal)
    actual, nominal = source.robot.poses(q), source.nominal.poses(q)
    apart = 1e3 * np.linalg.norm(actual[:, :3, 3] - nominal[:, :3, 3], axis=1)
    R = np.swapaxes(nominal[:, :3, :3], 1, 2) @ actual[:, :3, :3]
    cosines = (np.trace(R, axis1=1, axis2=2) - 1.0) / 2.0
    turned = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    shown = re.findall(r"(\d+\.\d{3}) (?:mm|deg)", printed)
    expected = [apart.mean(), apart.max(), turned.mean(), turned.max()]
    assert [float(number) for number in shown] == pytest.approx(expected, abs=6e-4)
    assert max(map(len, printed.splitlines()[:-1])) <= 100
    assert "Verdict on result.json: use" in printed
    assert "Coupled readings" not in printed
    coupling = {"elbow_joint": {"shoulder_lift_joint": 1.0}}
    nominal = source.nominal
    robot = Robot.from_urdf(nominal.urdf, nominal.base, nominal.tip, coupling=coupling)
    coupled = Conversion(replace(source, robot=robot), "dh", tmp_path / "rows.csv", ())
    said = " ".join(text(coupled, "result.json").split())
    assert "'elbow_joint' is at its reading plus that of 'shoulder_lift_joint'." in said


def test_a_nominal_robot_has_nothing_to_compare_with(ur3: Robot, tmp_path: Path):
    path = tmp_path / "rows.csv"
    nominal = text(Conversion(Source("urdf", ur3, ur3), "dh", path, ()), "ur3.urdf")
    unknown = text(Conversion(Source("urdf", ur3, None), "dh", path, ()), "ur3.urdf")
    assert " mm (mean)" not in nominal + unknown
    assert "--robot" in unknown


def test_a_note_of_reader_and_writer_is_said_once(source: Source, tmp_path: Path):
    note = Note("far", "It is {0:.0f} mm off.", (2e-3,))
    told = Conversion(replace(source, notes=(note,)), "dh", tmp_path / "rows.csv", (note,))
    assert text(told, "result.json").count("It is 2 mm off.") == 1
