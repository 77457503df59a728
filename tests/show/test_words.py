"""Words that verbs share: rows outside of the measured range, errors in their units."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.coverage import Beyond, OutsideRow
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.show.words import (
    absurd_size,
    before_and_after,
    outside_text,
    rms_text,
    shown,
    sizes_of,
    with_unit,
)
from tests.parts import with_part
from tests.residuals import lengths_and_angles


def test_rows_outside():
    rows = [OutsideRow(i, (Beyond("a", False, 0.1), Beyond("b", True, 0.3))) for i in range(5)]
    assert (
        outside_text(rows[:1], [7]) == "row 7: 'a' 5.73 deg, 'b' 300 mm beyond the measured range"
    )
    assert outside_text(rows, range(5)).endswith("; and 2 more rows")


def test_a_calibration_in_one_line_says_verdict_errors_and_rows(default_result: Calibration):
    c = default_result
    before = c.trust.nominal_cross_validation.errors_without_outliers["m"].rms
    after = c.cross_validation.errors_without_outliers["m"].rms
    assert repr(c) == (
        f"Calibration('ur3', base to tool0, {c.verdict.use}, held-out rms {1e3 * before:.3f} mm to "
        f"{1e3 * after:.3f} mm, 35 rows)"
    )
    assert len(repr(c)) <= 120


def test_without_held_out_rows_the_errors_are_those_of_validation_or_fitted_rows(
    default_result: Calibration,
):
    c = with_part(default_result, "geometry", cross_validation=None, verdict=None)
    where, before, after = before_and_after(c)
    assert where == "validation"
    assert (before["m"].rms, after["m"].rms) == tuple(
        c.errors[who]["validation"]["m"].rms for who in ("nominal", "calibrated")
    )
    assert "no verdict" in repr(c)
    fitted = replace(c, rows=replace(c.rows, sets=("estimate",) * len(c.rows)))
    assert before_and_after(fitted)[0] == "fitted"


@pytest.mark.parametrize(
    ("residual", "used", "text"),
    [
        (np.full((2, 3), 1e-3), None, "1.732 mm"),
        (np.full((2, 6), np.radians(1.0)), [[False] * 3 + [True] * 3] * 2, "1.7321 deg"),
        (np.zeros((1, 3)), [[False] * 3], "-"),
    ],
)
def test_the_rms_error_has_its_units(residual, used, text):
    channels = None if used is None else lengths_and_angles(used)
    assert rms_text(Errors.of(residual, channels)) == text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(2.5e-3, "m", "2.500 mm"), (0.01, "rad", "0.5730 deg"), (1.25, "px", "1.250 px")],
)
def test_each_unit_has_its_own(value, unit, text):
    assert with_unit(value, unit) == text
    assert shown(value, unit, 1) == f"{float(text.split()[0]):.1f}"


def test_what_does_not_exist_is_a_dash():
    assert shown(math.nan, "m") == "-"


def test_the_sizes_of_a_reason_are_in_the_order_of_the_units():
    values = {"after_px": 0.5, "after_m": 1e-3, "before_m": 2e-3}
    assert sizes_of(values, "after") == ["1.000 mm", "0.500 px"]
    assert sizes_of(values, "after", ".0f") == ["1 mm", "0 px"]
    assert sizes_of(values, "noise") == []


def test_only_what_no_arm_does_is_absurd():
    values = {"before_m": 0.019, "before_rad": 0.2, "after_m": 0.021}
    assert absurd_size(values, "before") == "11 deg"
    assert absurd_size(values, "after") == "21 mm"
    assert absurd_size({"after_m": 0.0199}, "after") == ""
