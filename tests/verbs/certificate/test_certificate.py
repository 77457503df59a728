"""Certificates: points, decisions, validity, records; what is refused."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.errors import ArgumentError, CalibError, MeasurementError, ModelError
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.certificate.certificate import priors_of
from calib.verbs.certificate.conformity import conformance_probability, global_risks
from calib.verbs.certificate.points import standard_uncertainty
from tests.verbs.certificate.certificates import LIMITS, RECORD, SIGMA, fresh_rows, own


def test_the_decision_is_iso_14253_with_the_probability_of_jcgm_106(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    c = own(ur3, table, default_result, uncertainty={"m": 5e-5}, **LIMITS)
    decision = c.decisions["m"]
    largest = max(one.left for one in c.of("m"))
    assert decision.check.figure == largest
    assert (decision.check.uncertainty, decision.check.tolerance) == (5e-5, 5e-4)
    assert c.outcome == decision.check.outcome == "pass"
    each = [float(conformance_probability(one.left, 5e-4, 5e-5, np.inf)) for one in c.of("m")]
    assert [one.conformance for one in c.of("m")] == pytest.approx(each, rel=1e-12)
    assert decision.conformance == pytest.approx(1.0 - sum(1.0 - p for p in each), abs=1e-12)
    assert decision.specific_risk == pytest.approx(1.0 - decision.conformance)
    expected = global_risks((3e-4, 1e-4), 5e-4, 2.5e-5, 5e-5)
    assert decision.risks.consumer == pytest.approx(expected.consumer, rel=1e-9)
    assert decision.risks.producer == pytest.approx(expected.producer, rel=1e-9)


@pytest.mark.parametrize(
    ("tolerance", "outcome"), [(4.5e-4, "pass"), (3.2e-4, "undecided"), (2e-4, "fail")]
)
def test_outcomes(
    ur3: Robot, table: Measurements, default_result: Calibration, tolerance: float, outcome: str
):
    c = own(ur3, table, default_result, uncertainty={"m": 5e-5}, tolerance={"m": tolerance})
    assert c.outcome == outcome
    risk = c.decisions["m"].specific_risk
    assert (risk < 0.023) if outcome != "undecided" else np.isnan(risk)
    assert c.decisions["m"].risks is None


def test_the_guard_band_is_the_largest_u_of_the_points(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    c = own(ur3, table, default_result, sigma={"m": 2e-5}, **LIMITS)
    widest = max(c.of("m"), key=lambda one: one.uncertainty)
    assert c.decisions["m"].check.uncertainty == widest.uncertainty
    expected = global_risks((3e-4, 1e-4), 5e-4, standard_uncertainty(widest), widest.uncertainty)
    assert c.decisions["m"].risks == expected


def test_fresh_rows_and_the_calibrations_own(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    fresh = own(ur3, fresh_rows(default_result), default_result, sigma=SIGMA)
    assert fresh.is_fresh
    assert not own(ur3, table, default_result).is_fresh
    assert fresh.units == ("m", "rad")
    assert len(fresh.points) == 8
    rows = fresh_rows(default_result, kind="point")
    points = own(ur3, rows, default_result, sigma=SIGMA)
    assert points.units == ("m",)
    left = [one.left for one in points.of("m")]
    np.testing.assert_allclose(left, np.linspace(1e-4, 2e-4, 8), atol=4e-5)
    # The target was registered to the poses: a smaller deviation counts more.
    assert points.assessment.accuracies["calibration"].factor == 1.0
    assert fresh.assessment.accuracies["calibration"].factor > 1.0
    assert fresh.outcome is None
    assert not fresh.decisions


def test_without_a_table_it_is_the_calibrations(
    ur3: Robot, default_result: Calibration, tmp_path: Path
):
    c = calib.certificate(ur3, calibration=default_result)
    assert [point.rows[0] for point in c.points] == [31, 32, 33, 34, 35]
    path = default_result.write_json(tmp_path / "r.json")
    with pytest.raises(ModelError, match="read from a file"):
        calib.certificate(ur3, calibration=path)


def test_the_corrected_robot_and_the_result_file_give_the_same(
    ur3: Robot, table: Measurements, default_result: Calibration, tmp_path: Path
):
    path = default_result.write_json(tmp_path / "r.json")
    urdf = default_result.write_urdf(tmp_path / "c.urdf")
    of_files = calib.certificate(urdf, table, calibration=path, tolerance={"m": 5e-4})
    of_values = calib.certificate(ur3, table, calibration=default_result, tolerance={"m": 5e-4})
    for one, other in zip(of_files.of("m"), of_values.of("m"), strict=True):
        assert one.left == pytest.approx(other.left, abs=1e-9)
        assert one.found == pytest.approx(other.found, abs=1e-9)
        assert one.uncertainty == pytest.approx(other.uncertainty, rel=1e-6)
    assert of_files.files.result == "r.json"
    assert len(of_files.files.result_sha256) == 64
    assert of_values.files.result == ""


def test_the_box_is_what_was_calibrated_tested_and_allowed(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    c = own(ur3, table, default_result)
    assert [one.joint for one in c.box] == list(ur3.joint_names)
    np.testing.assert_array_equal([one.calibrated for one in c.box], default_result.rows.ranges)
    q = table.joints_for(ur3.joint_names)[table.validation]
    np.testing.assert_allclose([one.tested for one in c.box], np.array([q.min(0), q.max(0)]).T)
    assert c.box[2].limits == pytest.approx((-np.pi, np.pi), abs=1e-3)


def test_entries_of_the_item_come_from_the_results_record(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    result = replace(default_result, record=RECORD)
    given = Record(customer="Other", date="2026-12-01")
    fresh = own(ur3, fresh_rows(result), result, record=given, sigma=SIGMA).record
    assert (fresh.customer, fresh.date) == ("Other", "2026-12-01")
    assert (fresh.robot_serial, fresh.laboratory) == (RECORD.robot_serial, RECORD.laboratory)
    # Of another day: what it was measured with and in is not known, nor is the number of this certificate.
    blank = (fresh.instrument, fresh.temperature_C, fresh.certificate_number, fresh.load)
    assert not any(blank)
    assert own(ur3, table, result, record=Record()).record == RECORD


def test_the_id_is_of_the_numbers_and_the_record(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    one = own(ur3, table, default_result)
    assert one.id == own(ur3, table, default_result).id
    assert len(one.id) == 12
    others = [
        own(ur3, table, default_result, record=Record()),
        own(ur3, table, default_result, uncertainty={"m": 1e-5}),
        own(ur3, table, default_result, tolerance={"m": 1e-3}),
    ]
    assert len({one.id, *(other.id for other in others)}) == 4


def test_it_is_a_value(ur3: Robot, table: Measurements, default_result: Calibration):
    c = own(ur3, table, default_result, **LIMITS)
    again = pickle.loads(pickle.dumps(c))
    assert again.id == c.id
    assert copy.copy(c) is c
    with pytest.raises(AttributeError):
        c.points = ()
    assert repr(c).startswith("Certificate('ur3', base to tool0, K-2026-0117, ")


@pytest.mark.parametrize(
    "given",
    [
        {"tolerance": {"px": 0.5}},
        {"tolerance": {"m": 0.0}},
        {"tolerance": {"m": float("nan")}},
        {"tolerance": 5e-4},
        {"uncertainty": {"m": -1e-5}},
        {"uncertainty": {"m": (1e-5, 1e-5)}},
        {"tolerance": {"m": 5e-4}, "prior": {"m": 3e-4}},
        {"tolerance": {"m": 5e-4}, "prior": {"m": (3e-4, 0.0)}},
        {"prior": {"m": (3e-4, 1e-4)}},
    ],
)
def test_sizes_that_make_no_sense_are_refused(
    ur3: Robot, table: Measurements, default_result: Calibration, given
):
    with pytest.raises(ArgumentError):
        own(ur3, table, default_result, **given)


def test_rows_that_prove_nothing_are_refused(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    fitted = table.select(table.estimation)
    with pytest.raises(MeasurementError, match="fitted to all rows"):
        own(ur3, fitted, default_result)
    with pytest.raises(MeasurementError, match="sigma_angle_deg"):
        own(ur3, fresh_rows(default_result), default_result, sigma={"m": 1e-5})
    with pytest.raises(CalibError, match="non-geometric"):
        own(ur3, table, replace(default_result, non_geometric=None), non_geometric=True)
    with pytest.raises(ArgumentError, match="calibration"):
        calib.certificate(ur3, table, calibration=5)
    with pytest.raises(MeasurementError, match="orientation"):
        own(ur3, table, default_result, tolerance={"rad": 1e-3})


def test_means_and_deviations_of_a_prior_go_together():
    assert priors_of(None, None) is None
    assert priors_of({"m": 3e-4}, {"m": 1e-4}) == {"m": (3e-4, 1e-4)}
    for means, stds in (({"m": 1.0}, None), (None, {"m": 1.0}), ({"m": 1.0}, {"rad": 1.0})):
        with pytest.raises(CalibError, match="--prior-std"):
            priors_of(means, stds)


def test_another_robot_than_the_calibrations_is_refused(
    ur3: Robot, table: Measurements, default_result: Calibration
):
    origins = {name: T.copy() for name, T in ur3.origins().items()}
    origins["elbow_joint"][0, 3] += 0.01
    with pytest.raises(ModelError, match="elbow_joint"):
        own(Robot.from_urdf(ur3.urdf.with_origins(origins), "base", "tool0"), table, default_result)
