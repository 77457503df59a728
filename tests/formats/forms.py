"""One arm in every form that ``calib convert`` reads: a UR3, fitted to the paper's table, and one from its factory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import calib.example
from calib.calibration import calibrate
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.formats.convert import Wanted, write_target
from calib.formats.sources import Asked, read_source
from calib.result.calibration_file import write_result
from calib.robot.robot import Robot
from tests.formats.ur_cases import CALIBRATIONS

UR3 = next(case for case in CALIBRATIONS if case["robot"] == "UR3")


def write_conf(case: dict, path: Path) -> Path:
    """The deltas of a case as a calibration.conf."""
    lines = [
        f"delta_{key} = [{', '.join(repr(float(value)) for value in case['delta'][key])}]"
        for key in ("theta", "a", "d", "alpha")
    ]
    path.write_text("\n".join(["[mounting]", *lines, ""]))
    return path


def write_forms(folder: Path) -> Path:
    """robot.urdf, result.json, corrected.urdf, origins.yaml; calibration.conf and its kinematics.yaml."""
    (folder / "robot.urdf").write_bytes(Path(calib.example.paper_urdf()).read_bytes())
    arm = Robot.load(folder / "robot.urdf", "base", "tool0")
    table = Measurements.read(calib.example.paper_measurements(), arm.joint_names, arm.joint_types)
    cell = Cell(target=np.array([-0.07, 0.07, 0.0225]), model="dh")
    found = calibrate(arm, table, cell=cell, validate=False)
    write_result(found, folder / "result.json")
    found.robot.urdf.write(folder / "corrected.urdf")
    write_conf(UR3, folder / "calibration.conf")
    source = read_source(str(folder / "result.json"), Asked())
    write_target(source, Wanted(folder / "origins.yaml", "origins"))
    conf = read_source(str(folder / "calibration.conf"), Asked(ur_model="UR3"))
    write_target(conf, Wanted(folder / "kinematics.yaml", "ur-yaml"))
    return folder
