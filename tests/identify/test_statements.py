"""Sentences and rows of a result: what the summary and the report both say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identify import statements
from calib.identify.prediction import Outlier, ParameterEstimate


def test_error_rows_are_the_errors_of_each_set(calibrated):
    _, c = calibrated("points")
    rows = dict(statements.error_rows(c))
    assert rows["estimation rows, nominal"].rms == c.errors["nominal"]["estimation"].rms
    assert rows["validation rows, calibrated"].n == c.errors["calibrated"]["validation"].n


def test_without_cross_validation_nothing_is_said_of_left_out_rows(calibrated):
    _, c = calibrated("points")
    bare = replace(c, cross_validation=None, nominal_cross_validation=None, larger=None)
    assert statements.left_out_text(bare) == ""
    assert not [label for label, _ in statements.error_rows(bare) if "left-out" in label]


def test_whether_outliers_have_a_weight(calibrated):
    _, c = calibrated("points")
    row = c.measurements.rows[0]
    flagged = replace(c, outliers=(Outlier(row, 1e-3, 9.0),))
    weights = c.weights.copy()
    for weight, said in (
        (0.0, "they have no weight in the fit"),
        (1.0, "they keep their weight in this fit"),
    ):
        weights[0] = weight
        assert statements.weights_text(replace(flagged, weights=weights)) == said


def test_the_first_dozen_is_listed():
    many = [Outlier(k, 1e-3 * k, 5.0) for k in range(1, 15)]
    text = statements.listed(many)
    assert text.startswith("row 1 (1.00 mm, 5.0 sigma); row 2 (2.00 mm")
    assert text.endswith("row 12 (12.00 mm, 5.0 sigma); and 2 more")
    assert statements.listed(many[:1]) == "row 1 (1.00 mm, 5.0 sigma)"


@pytest.mark.parametrize(
    ("unit", "at_bound", "said"),
    [
        ("m", False, ("10.000", "12.000", "+2.000", "0.5", "mm")),
        ("rad", False, ("0.573", "0.688", "+0.115", "0.0286", "deg")),
        ("m", True, ("10.000", "12.000", "+2.000", "at bound", "mm")),
    ],
)
def test_a_parameter_in_the_units_of_people(unit: str, at_bound: bool, said: tuple[str, ...]):
    p = ParameterEstimate("x", unit, 0.010, 0.012, 0.002, 2e-4, 0.0115, 0.0125, True, at_bound)
    shown = statements.parameter_text(p)
    assert (shown.nominal, shown.value, shown.change, shown.half, shown.unit) == said
    unknown = statements.parameter_text(replace(p, nominal=None))
    assert (unknown.nominal, unknown.change) == ("-", "-")


def test_frames_and_orientations_of_targets_are_no_listed_parameters(calibrated):
    _, c = calibrated("poses")
    names = [p.name for p in statements.shown_parameters(c)]
    assert "target_x" in names
    assert not [name for name in names if name.startswith(("frame_", "target_r"))]


def test_the_solver_without_its_time(calibrated):
    _, c = calibrated("points")
    assert statements.solver_text(c) == (
        f"Solver 'lm': converged after {c.solution.iterations} iterations, {c.solution.evaluations} evaluations"
    )
    assert statements.solver_text(replace(c, seconds=np.nan)) == statements.solver_text(c)


@pytest.mark.parametrize(
    ("numbers", "of", "title"),
    [
        ([3, 3], "coordinate", "Position error"),
        ([1, 0], "length", "Length error"),
        ([3, 1], "coordinate or length", "Position or length error"),
        ([0], "coordinate", "Position error"),
    ],
)
def test_an_error_of_a_length_is_none_of_a_position(numbers: list[int], of: str, title: str):
    used = np.arange(3) < np.array(numbers)[:, None]
    assert statements.measured_lengths(used) == of
    assert statements.error_title(used) == title


@pytest.mark.parametrize(
    "name", ["points", "poses", "distances", "pairs", "sockets", "planes", "mixed"]
)
def test_kinds_tell_the_same_as_what_was_used(calibrated, name: str):
    _, c = calibrated(name)
    said = statements.lengths_of_kinds(frozenset(c.measurements.kinds))
    assert said == statements.measured_lengths(c.used)
    assert statements.title_of_errors(said) == statements.error_title(c.used)
