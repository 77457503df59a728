"""A shelf of result files: calibrations of UR3s of different measurements, written with records and dates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import calib.example
from calib.data.record import Record
from calib.diagnosis.reasons import Verdict
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from tests.kept import kept
from tests.verbs.fleet.arms import CELL, scenario


@kept
def fitted(number: int) -> Calibration:
    """The calibration of the table of this number; another number has another run."""
    robot = Robot.load(calib.example.paper_urdf(), base="base", tip="tool0")
    errors = scenario(robot)
    measured = errors.draw(number).measure(errors.random_poses(12, number), number)
    return calibrate(robot, measured.measurements, cell=CELL, validate=False)


def result(
    number: int, serial: str = "A", date: str = "", *, time: str = "", use: str = ""
) -> Calibration:
    """A calibration with a record; `use` is its verdict."""
    made = fitted(number)
    if use:
        made = replace(made, geometry=replace(made.geometry, verdict=Verdict(use, ())))
    record = Record(robot_serial=serial, date=date)
    method = replace(made.method, time=time or made.method.time)
    return replace(made, record=record, method=method)


def put(folder: Path, name: str, calibration: Calibration, *, urdf: bool = False) -> Path:
    """Write a result file below a folder, and its corrected URDF beside it."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    calibration.write_json(path)
    if urdf:
        calibration.write_urdf(path.with_suffix(".urdf"), accept=True)
    return path
