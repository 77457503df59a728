"""Results in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.show.short import before_and_after, rms_text
from calib.verbs.evaluate.evaluation import evaluate
from tests.parts import with_part
from tests.residuals import lengths_and_angles


def test_a_calibration_says_verdict_errors_and_rows(default_result: Calibration):
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


def test_an_evaluation_says_its_error(ur3, table):
    made = evaluate(ur3, table, Cell())
    assert (
        repr(made)
        == f"Evaluation('ur3', base to tool0, rms {1e3 * made.errors['all']['m'].rms:.3f} mm, 35 rows)"
    )


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
