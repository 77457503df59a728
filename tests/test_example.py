"""What comes with calib: the paper's table, the nominal UR3 and the calibrated one."""

from __future__ import annotations

import re

import numpy as np

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.example import (
    PAPER_TARGET,
    PAPER_TARGET_AS_PRINTED,
    paper_measurements,
    paper_urdf,
)
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from tests.places import ROOT


def test_the_target_is_the_printed_one_turned_about_z():
    np.testing.assert_allclose(PAPER_TARGET, np.array(PAPER_TARGET_AS_PRINTED) * [-1, -1, 1])


def test_the_table_has_the_papers_checksums():
    """Sums of the printed columns of Table 2, taken apart from the file: a mistyped digit shows."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    assert len(table) == 35
    assert table.rows == tuple(range(1, 36))
    assert (table.estimation.sum(), table.validation.sum()) == (30, 5)
    np.testing.assert_allclose(1e3 * table.points[0], [-149.02, -207.50, 742.60])
    np.testing.assert_allclose(1e3 * table.points[34], [158.99, 204.80, 563.66])
    np.testing.assert_allclose(
        np.degrees(table.joints[9]), [-21.76, -108.33, 113.11, -118.99, -6.41, 420.75]
    )


def test_the_calibrated_urdf_is_what_the_demo_writes():
    """Outside of the origins byte for byte; in them to 1e-9, because the last digits depend on the processor."""
    robot = Robot.load(paper_urdf(), base="base", tip="tool0")
    table = Measurements.read(paper_measurements(), robot.joint_names, robot.joint_types)
    result = calibrate(
        robot, table, cell=Cell(target=read_only(PAPER_TARGET), model="paper"), validate=False
    )
    kept = Robot.load(ROOT / "urdf" / "ur3_calibrated.urdf", base="base", tip="tool0")
    np.testing.assert_allclose(kept.placements, result.robot.placements, rtol=0, atol=1e-9)

    def without_origins(data: bytes) -> bytes:
        return re.sub(rb"<origin[^>]*/>", b"<origin/>", data)

    assert without_origins(kept.urdf.data) == without_origins(robot.urdf.data)
    assert kept.urdf.data != robot.urdf.data
