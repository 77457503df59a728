"""Set-ups that do not agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.diagnosis.reasons import Why
from calib.diagnosis.stations import disagreeing_stations
from calib.result.calibrate import calibrate
from tests.judged import reasons


def test_a_set_up_that_the_others_do_not_predict(calibrated):
    """In one of three set-ups a joint slipped: each set-up alone looks well, but not from the others."""
    scene, good = calibrated("set-ups")
    m = good.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-4
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.cell)
    assert reasons(slipped)[Why.SETUP_UNPREDICTED]["setup"] == "1"
    assert slipped.verdict.use == "use with care"
    assert Why.SETUP_UNPREDICTED not in reasons(good)
    assert len(disagreeing_stations(good.fitted)) == 0


def test_a_set_up_whose_rows_are_flagged(calibrated):
    """A joint slipped further: the robust fit takes that set-up's rows for outliers, and the set-up is named."""
    scene, good = calibrated("set-ups")
    m = good.measurements
    joints = m.joints.copy()
    joints[np.array(m.groups) == "1", 2] += 2e-3
    slipped = calibrate(scene.robot, replace(m, joints=joints), cell=good.cell)
    assert reasons(slipped)[Why.SETUP_FLAGGED]["setup"] == "1"
    assert slipped.verdict.use != "use"
    assert Why.SETUP_FLAGGED not in reasons(good)
