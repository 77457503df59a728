"""Rows that a calibration was fitted to: known again in any order and kind, and not judged by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from calib.identify.acceptance_rows import fitted_of, judged_rows, known_again
from calib.identify.calibration import Calibration
from calib.identify.evaluation import Evaluation, evaluate
from calib.identify.result_file import read_result, write_result
from calib.measure.measurements import Measurements


def errors(c: Calibration, m: Measurements) -> tuple[Calibration, Evaluation, Evaluation]:
    """What is left over in some rows, under a result that was written and read."""
    with TemporaryDirectory() as folder:
        stored = read_result(write_result(c, Path(folder) / "r.json"))
    nominal = evaluate(stored.nominal, m, c.cell, known=stored.nominal_setup)
    calibrated = evaluate(stored.robot, m, c.cell, known=stored.setup)
    return stored, nominal, calibrated


def test_rows_of_every_kind_are_known_again(case):
    _, c = case
    m = c.measurements
    found = errors(c, m)
    wanted = m.estimation & np.any(c.used, axis=1)
    assert np.array_equal(known_again(*found), wanted)


def test_neither_order_nor_number_nor_set_hides_a_row(default_result: Calibration):
    m = default_result.measurements
    order = np.random.default_rng(1).permutation(len(m))[:20]
    shuffled = Measurements(m.joint_names, m.joints[order], m.points[order])
    found = errors(default_result, shuffled)
    assert np.array_equal(known_again(*found), m.estimation[order])


@pytest.mark.parametrize(("change", "known"), [(1e-9, True), (1e-6, False)])
def test_a_row_that_was_measured_again_is_another(
    default_result: Calibration, change: float, known: bool
):
    """What is lost in rounding is not a measurement; a micrometre is."""
    m = default_result.measurements
    again = replace(m, points=m.points + change * np.eye(3)[0])
    found = errors(default_result, again)
    assert known_again(*found).sum() == known * m.estimation.sum()


def test_rows_without_errors_are_told_apart_by_the_nominal_robot(default_result: Calibration):
    """Where the calibrated robot explains everything, as it may a simulation without noise."""
    m = default_result.measurements
    stored, nominal, calibrated = errors(default_result, m)
    exact = replace(stored, residual_calibrated=0.0 * stored.residual_calibrated)
    right = replace(calibrated, residual=0.0 * calibrated.residual)
    assert np.array_equal(known_again(exact, nominal, right), m.estimation)


@pytest.mark.parametrize(
    ("validate", "fitted", "registered", "judged"),
    [
        ("", "", False, "0123456789"),
        ("", "", True, "0123456789"),
        ("", "01234", False, "56789"),
        ("", "012345", False, "0123456789"),  # four poses are too few,
        ("89", "01234567", False, "89"),  # unless the table sets them aside
        ("89", "01234", False, "56789"),
        ("89", "01234", True, "89"),
        ("89", "", True, "89"),
        ("89", "", False, "0123456789"),
        ("89", "0123456789", True, "0123456789"),
    ],
)
def test_which_rows_are_judged(validate: str, fitted: str, registered: bool, judged: str):
    def mask(rows: str) -> np.ndarray:
        return np.array([str(k) in rows for k in range(10)])

    sets = tuple("validate" if one else "estimate" for one in mask(validate))
    m = Measurements(("a",), np.zeros((10, 1)), np.zeros((10, 3)), sets=sets)
    told = np.ones(10, dtype=bool)
    found = judged_rows(m, told, mask(fitted), np.arange(10), registered=registered)
    assert np.array_equal(found, mask(judged))


def test_repeats_of_one_pose_do_not_count_as_five():
    m = Measurements(("a",), np.zeros((10, 1)), np.zeros((10, 3)))
    told = np.ones(10, dtype=bool)
    fitted = np.arange(10) < 4
    assert judged_rows(m, told, fitted, np.arange(10) // 2, registered=False).all()


def test_what_was_fitted_as_a_word_or_row_by_row():
    sets = ("estimate", "validate", "estimate")
    m = Measurements(("a",), np.zeros((3, 1)), np.zeros((3, 3)), sets=sets)
    told = np.array([True, True, False])
    assert fitted_of(m, told, seen=True).tolist() == [True, False, False]
    assert fitted_of(m, told, seen=False).tolist() == [False, False, False]
    assert fitted_of(m, told, np.array([False, True, True])).tolist() == [False, True, False]
    alone = m.select(m.validation)
    assert fitted_of(alone, np.array([True]), seen=True).tolist() == [True]
