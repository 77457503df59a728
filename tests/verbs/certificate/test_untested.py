"""What was not tested: each code by the data that brings it, and gone when they are otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.certificate.certificate import Certificate
from calib.verbs.certificate.untested import Untested
from tests.verbs.certificate.certificates import RECORD, SIGMA, fresh_rows, own

U = Untested


def codes(c: Certificate) -> set[Untested]:
    return {gap.code for gap in c.gaps}


def values(c: Certificate, code: Untested) -> dict[str, object]:
    (gap,) = [gap for gap in c.gaps if gap.code is code]
    return dict(gap.values)


def test_the_papers_rows(ur3: Robot, table: Measurements, default_result: Calibration):
    c = own(ur3, table, default_result)
    assert codes(c) == {
        *(U.ORIENTATIONS, U.REPEATS, U.APPROACHES, U.DRIFT, U.BEYOND, U.OUTSIDE, U.OTHER_LOADS),
        *(U.OTHER_SPEEDS, U.OTHER_TEMPERATURES, U.NOISE),
    }
    assert values(c, U.OUTSIDE) == {"rows": (34, 35)}
    assert values(c, U.REPEATS) == {"repeats": 1, "wanted": 3}
    box = default_result.rows.ranges
    q = table.joints_for(ur3.joint_names)[table.validation]
    inside = np.minimum(q.max(0), box[:, 1]) - np.maximum(q.min(0), box[:, 0])
    share = np.maximum(inside, 0.0) / (box[:, 1] - box[:, 0])
    worst = values(c, U.BEYOND)
    assert worst["share"] == pytest.approx(share.min())
    assert worst["joint"] == ur3.joint_names[int(share.argmin())]


def test_what_the_record_does_not_state(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    blank = codes(own(ur3, table, default_result, record=Record()))
    assert blank >= {U.LOAD, U.SPEED, U.WARM_UP, U.TEMPERATURE, U.TRACEABILITY}
    assert not blank & {U.OTHER_LOADS, U.OTHER_SPEEDS, U.OTHER_TEMPERATURES}
    partly = codes(own(ur3, table, default_result, record=replace(RECORD, traceability="")))
    assert U.TRACEABILITY in partly
    assert U.EXPIRED not in partly
    late = own(ur3, table, default_result, record=replace(RECORD, calibration_due="2026-11-25"))
    assert values(late, U.EXPIRED) == {"due": "2026-11-25", "date": "2026-11-26"}
    for given in ({"sigma": {"m": 2e-5}}, {"uncertainty": {"m": 5e-5}}):
        assert U.NOISE not in codes(own(ur3, table, default_result, **given))


def test_repeats_approaches_and_orientations_of_fresh_rows(ur3: Robot, default_result: Calibration):
    once = fresh_rows(default_result)
    assert codes(own(ur3, once, default_result, sigma=SIGMA)) >= {U.REPEATS, U.APPROACHES, U.DRIFT}
    assert U.ORIENTATIONS not in codes(own(ur3, once, default_result, sigma=SIGMA))
    often = fresh_rows(default_result, 20)
    often = replace(often, approaches=tuple("xy"[k % 2] for k in range(len(often))))
    assert not codes(own(ur3, often, default_result, sigma=SIGMA)) & {
        U.REPEATS,
        U.APPROACHES,
        U.DRIFT,
    }


def test_few_points_and_joints_that_stand_still(ur3: Robot, default_result: Calibration):
    rows = fresh_rows(default_result)
    q = rows.joints.copy()
    q[:, 3] = q[0, 3]
    T = default_result.predict_poses(q, non_geometric=False)
    still = replace(rows, joints=q, points=T[:, :3, 3], rotations=T[:, :3, :3], moves=None)
    c = own(ur3, still, default_result, sigma=SIGMA)
    assert values(c, U.STILL_JOINTS) == {"joints": (ur3.joint_names[3],)}
    few = own(ur3, still.select(np.arange(8) < 3), default_result, sigma=SIGMA)
    assert values(few, U.FEW_POINTS) == {"points": 3, "wanted": 5}
    assert U.FEW_POINTS not in codes(c)


def test_a_frame_registered_to_the_rows_is_said(ur3: Robot, default_result: Calibration):
    import calib
    from calib.data.cell import Cell

    rows = fresh_rows(default_result)
    cell = Cell(estimate_frame=True, record=RECORD, sigma=SIGMA)
    c = calib.certificate(ur3, rows, calibration=default_result, cell=cell)
    assert (U.REGISTERED in codes(c)) == bool(c.assessment.accuracies["calibration"].registered)
