"""Certificates of the paper's UR3, from its own table and from fresh rows, and the record of one."""

from __future__ import annotations

from typing import Any

import numpy as np

import calib
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.certificate.certificate import Certificate

RECORD = Record(
    certificate_number="K-2026-0117",
    laboratory="Muster & Söhne <Kalibrierlabor>",
    country="DE",
    responsible="B. Leiterin",
    customer="Kunde GmbH",
    order="4711",
    robot="Universal Robots UR3",
    robot_serial="20183300123",
    controller_serial="20183300124",
    load="3 kg",
    speed="250 mm/s",
    warm_up="60 min",
    instrument="Laser tracker",
    instrument_serial="390123",
    instrument_certificate="LT-118",
    instrument_calibrated="2026-05-31",
    calibration_due="2027-05-31",
    traceability="PTB, by DKD-K-12345",
    place="Hall 3",
    date="2026-11-26",
    temperature_C=(21.4, 22.1),
    humidity_percent=(41.0,),
    sequence="random",
    operator="A. Person",
    valid_until="2027-11-26",
    note="Robot on its own base",
)

#: Noise of a coordinate [m] and about an axis [rad]: the calibration's rows had no orientations.
SIGMA = {"m": 2e-5, "rad": 1e-4}

#: Tolerance, and the largest deviation of such robots, [m].
LIMITS: dict[str, Any] = {"tolerance": {"m": 5e-4}, "prior": {"m": (3e-4, 1e-4)}}


def own(ur3: Robot, table: Measurements, result: Calibration, **given: Any) -> Certificate:
    """Of the paper's table: its five validation rows."""
    cell = Cell(record=given.pop("record", RECORD), sigma=given.pop("sigma", {}))
    return calib.certificate(ur3, table, calibration=result, cell=cell, **given)


def fresh_rows(
    result: Calibration,
    repeats: int = 1,
    noise: float = 1e-5,
    *,
    kind: str = "pose",
    count: int = 8,
) -> Measurements:
    """Poses within the calibrated ranges, off by 0.1 to 0.2 mm along x of the frame.

    Of poses the target's turn is registered to the rows, and with it its position.
    """
    random = np.random.default_rng(5)
    low, high = result.rows.ranges.T
    q = np.repeat(random.uniform(low, high, size=(count, 6)), repeats, axis=0)
    T = result.predict_poses(q, non_geometric=False)
    T[:, 0, 3] += np.repeat(np.linspace(1e-4, 2e-4, count), repeats)
    T[:, :3, 3] += noise * random.normal(size=(len(q), 3))
    return Measurements(
        result.nominal.joint_names,
        q,
        T[:, :3, 3],
        rotations=T[:, :3, :3] if kind == "pose" else None,
        kinds=(kind,) * len(q),
        source="fresh.csv",
    )
