"""Rms errors with zeros, beside those of the other robots on the same rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.errors import VerdictError
from calib.result.joint_zeros import ESTIMATION, VALIDATION
from calib.verbs.convert.source import Source
from calib.verbs.convert.zeros.rms_errors import RmsErrors, check_improvement
from calib.verbs.convert.zeros.rounding import RoundedZeros, stored_number
from tests.verbs.convert.zeros.arms import ur3_result


def rms_errors_of(result, name: str = "zeros", ticks: int = 4096) -> RmsErrors:
    source = Source("result", result.robot, result.nominal, calibration=result)
    return RmsErrors.of(result, RoundedZeros.of(source, stored_number(name, ticks)))


def test_the_errors_are_those_of_the_result():
    result = ur3_result()
    rms_errors = rms_errors_of(result)
    held_out = result.cross_validation.errors_without_outliers["m"].rms
    nominal = result.trust.nominal_cross_validation.errors_without_outliers["m"].rms
    assert (rms_errors.calibrated["m"], rms_errors.nominal["m"]) == (held_out, nominal)
    assert rms_errors.zeros["m"] == result.zeros.errors["m"].rms()
    assert rms_errors.non_geometric is None
    assert not rms_errors.is_no_better
    for rows, name in ((VALIDATION, "validation"), (ESTIMATION, "estimation")):
        other = rms_errors_of(replace(result, zeros=replace(result.zeros, rows=rows)))
        assert other.nominal["m"] == result.errors["nominal"][name]["m"].rms
        assert other.calibrated["m"] == result.errors["calibrated"][name]["m"].rms


def test_coarser_steps_cost_more():
    fine, ticks, coarse = (
        rms_errors_of(ur3_result(), name, n).rounded["m"]
        for name, n in (("zeros", 4096), ("lerobot", 4096), ("lerobot", 64))
    )
    assert fine == pytest.approx(rms_errors_of(ur3_result()).zeros["m"], rel=1e-4)
    assert 1.0 < ticks / fine < 1.1 < coarse / fine  # steps of 5.6 deg leave the zeros as they are


def test_what_is_no_better_is_refused():
    path = Path("z.csv")
    rms_errors = rms_errors_of(ur3_result())
    worse = replace(rms_errors, rounded={"m": rms_errors.nominal["m"]})
    check_improvement(rms_errors, path, accept=False)
    check_improvement(worse, path, accept=True)
    with pytest.raises(VerdictError, match=r"z\.csv.*held-out.*2\.350 mm"):
        check_improvement(worse, path, accept=False)
    not_judged = replace(worse, nominal={"m": np.nan})  # the verdict speaks of that
    check_improvement(not_judged, path, accept=False)
    nothing = replace(worse, nominal={}, zeros={}, rounded={}, calibrated={})
    assert not nothing.is_no_better
