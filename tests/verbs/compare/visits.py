"""One UR3 calibrated at several dates, measured by Pinocchio, with a change of one joint's zero."""

from __future__ import annotations

import sys
from functools import cache

from calib.data.cell import Cell
from calib.data.record import Record
from calib.example import PAPER_TARGET, paper_urdf
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
from fleet_study import Planted, date_of, measured


@cache
def visits(
    fault: Planted | None, count: int, model: str = "dh", *, frame: bool = False
) -> tuple[Calibration, ...]:
    """Results of the first dates, a month apart."""
    results = []
    for date in range(count):
        record = Record(date=date_of(date), robot_serial="SN-004")
        cell = Cell(
            base="base",
            tip="tool0",
            target=PAPER_TARGET,
            model=model,
            estimate_frame=frame,
            record=record,
        )
        table = measured(3, date, fault)
        results.append(calibrate(paper_urdf(), table, cell=cell, validate=False))
    return tuple(results)
