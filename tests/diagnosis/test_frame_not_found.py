"""Where a frame was sought and not found, nothing is said of the nominal robot."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.diagnosis.reasons import NO, Reason, Why
from calib.diagnosis.usual_mistakes import frame_not_found
from calib.fit.registration.table_rows import rows_and_setup
from calib.show.plotting import styled
from calib.show.verdict import reason_text
from calib.verbs.calibrate.figure_errors import by_row, histograms
from calib.verbs.evaluate.acceptance import assess
from calib.verbs.evaluate.accuracy import fitted_rows
from tests.sought_frames import measured, sought_kinds, unstated

__all__ = ["sought_kinds"]
pytestmark = pytest.mark.usefixtures("sought_kinds")


def with_joints_reversed(table):
    """A table that no robot explains, wherever its frame stands."""
    return replace(table, joints=np.ascontiguousarray(table.joints[:, ::-1]))


def found(robot, table, cell):
    rows, setup = rows_and_setup(robot, table, cell)
    return frame_not_found(robot, setup, rows)


@pytest.mark.parametrize("what", ["line", "angle", "camera"])
def test_a_frame_is_not_found_where_no_place_explains_the_rows(ur3, what):
    table, cell = measured(ur3, what, seed=0)
    wrong = with_joints_reversed(table)
    assert found(ur3, table, unstated(cell)) is None
    assert found(ur3, wrong, cell) is None  # it was not sought: its pose is given
    assert found(ur3, wrong, unstated(cell)) == Reason.of(Why.FRAME_NOT_FOUND, station="")


def test_a_wrong_place_of_the_target_is_no_reason(ur3):
    """The target is estimated with the frame, wherever it was given."""
    table, cell = measured(ur3, "line", seed=0)
    assert found(ur3, table, replace(unstated(cell), target=[0.2, 0.05, -0.1])) is None


def test_the_station_is_named_where_there_are_several(ur3):
    table, cell = measured(ur3, "range", seed=0, count=80)
    groups = np.repeat(["good", "bad"], 40)
    joints = table.joints.copy()
    joints[40:] = joints[40:, ::-1]
    mixed = replace(table, joints=joints, groups=tuple(groups.tolist()))
    reason = found(ur3, mixed, unstated(cell))
    assert reason == Reason.of(Why.FRAME_NOT_FOUND, station="bad")
    assert "frame of station 'bad' was not found" in reason_text(reason)


def test_the_nominal_robot_is_not_judged(ur3):
    table, cell = measured(ur3, "range", seed=0, count=60)
    result = calib.calibrate(ur3, with_joints_reversed(table), cell=unstated(cell))
    assert result.verdict.use == NO
    assert [reason.why for reason in result.verdict.reasons] == [Why.FRAME_NOT_FOUND]
    assert result.trust.nominal_cross_validation is None
    text = result.summary()
    assert "The measurement frame was not found" in text
    assert "estimation rows, calibrated" in text
    assert "rows, nominal" not in text
    assert not result.rows.nominal_is_judged
    assert np.isnan(result.errors["nominal"]["estimation"]["m"].rms)


@pytest.mark.slow
def test_no_file_or_evaluation_has_errors_of_the_nominal_robot(ur3, tmp_path):
    table, cell = measured(ur3, "range", seed=0, count=60)
    wrong, cell = with_joints_reversed(table), unstated(cell)
    result = calib.calibrate(ur3, wrong, cell=cell)
    result.write_json(tmp_path / "result.json")
    stored = json.loads((tmp_path / "result.json").read_text())
    assert stored["errors"]["nominal"]["estimation"]["m"]["rms"] is None
    assert set(np.ravel(stored["rows"]["residual_nominal"])) == {None}
    assessment = assess(result.robot, wrong, cell, result)
    assert list(assessment.evaluations) == ["urdf", "calibration"]
    # The rows of the fit are known by their residuals all the same.
    assert fitted_rows(result, result.robot, wrong, cell).all()


def test_a_report_shows_the_calibrated_robot_alone(ur3):
    table, cell = measured(ur3, "range", seed=0, count=60)
    result = calib.calibrate(ur3, with_joints_reversed(table), cell=unstated(cell))
    with styled():
        left, _ = histograms(result).axes
        top, _ = by_row(result).axes
    labels = [entry.get_text() for entry in top.figure.legends[0].texts]
    assert "after (calibrated)" in labels
    assert "before (nominal)" not in labels
    assert len(left.patches) == 1
