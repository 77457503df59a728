"""One arm in every form that ``calib convert`` reads: a UR3, fitted to the paper's table, and one from its factory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import calib.example
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.result.calibrate import calibrate
from calib.result.calibration_file import write_result
from calib.robot.robot import Robot
from calib.verbs.convert.convert import convert
from calib.verbs.convert.format import Options
from tests.verbs.convert.ur_cases import CALIBRATIONS, rows, write_deltas

UR3 = next(case for case in CALIBRATIONS if case["robot"] == "UR3")


def write_forms(folder: Path) -> Path:
    """robot.urdf, result.json, corrected.urdf, origins.yaml; calibration.conf and its kinematics.yaml."""
    (folder / "robot.urdf").write_bytes(Path(calib.example.paper_urdf()).read_bytes())
    arm = Robot.load(folder / "robot.urdf", "base", "tool0")
    table = Measurements.read(calib.example.paper_measurements(), arm.joint_names, arm.joint_types)
    cell = Cell(target=np.array([-0.07, 0.07, 0.0225]), model="dh")
    found = calibrate(arm, table, cell=cell, validate=False)
    write_result(found, folder / "result.json")
    found.robot.urdf.write(folder / "corrected.urdf")
    write_deltas(folder / "calibration.conf", rows(UR3["delta"]))
    convert(str(folder / "result.json"), folder / "origins.yaml", to="origins")
    ur3 = Options(arm="UR3")
    convert(str(folder / "calibration.conf"), folder / "kinematics.yaml", options=ur3)
    return folder
