"""The study of two arms that clasp a part: what they do not see stays uncertain, and is named."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from calib.diagnosis.reasons import USE, Why
from calib.result.calibrate import calibrate
from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

from cell_study import two_arms_clasped


@pytest.mark.slow
def test_what_a_clasp_does_not_see_is_as_uncertain_as_before():
    """Here the offsets that it sees happen to be small; the error elsewhere is of those that it does not."""
    study = two_arms_clasped(np.random.default_rng(7))
    result = calibrate(study.robot, study.table, cell=study.cell, model="placement")
    assert result.geometry.prior_std["zero"] < 1e-3
    last = result.parameter("right/panda_joint7.rz")
    assert last.std == pytest.approx(5e-3, rel=0.05)  # the typical size of an offset
    seen = result.parameter("right/panda_joint6.rx")
    assert seen.std < 1e-4
    near, elsewhere = result.geometry.new_point
    assert near < 0.3e-3
    assert elsewhere == pytest.approx(6.7e-3, rel=0.1)
    assert result.verdict.use != USE
    assert Why.HANDS_ALONE in [reason.why for reason in result.verdict.reasons]
