"""Loads of gravity, payload and measured torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.data.cell import Cell
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.gravity import Payload, gravity_loads


def test_loads_are_those_of_gravity_and_payload_and_measured_ones_where_there_are(four_frames, ur3):
    table = four_frames.points(4)
    payload = Payload(3.0, np.array([0.0, 0.02, 0.1]))
    gravity = np.array([0.0, 9.81, 0.0])
    rows, _ = rows_and_setup(ur3, table, Cell(payload=payload, gravity=gravity))
    by_gravity = gravity_loads(ur3, table.joints, payload, gravity)
    np.testing.assert_array_equal(rows.samples.load, by_gravity)
    torques = np.full((4, 6), np.nan)
    torques[:, 1] = [10.0, -20.0, 0.0, 5.0]
    rows, _ = rows_and_setup(
        ur3, replace(table, torques=torques), Cell(payload=payload, gravity=gravity)
    )
    # The drive holds against the load.
    np.testing.assert_array_equal(rows.samples.load[:, 1, 0], [-10.0, 20.0, 0.0, -5.0])
    np.testing.assert_array_equal(rows.samples.load[:, 2:], by_gravity[:, 2:])
