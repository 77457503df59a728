"""The row of a robot: as in its files, and a hash of its measurements."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import pytest

from calib.basics.dates import parse_date
from calib.basics.json_files import json_bytes
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.result.calibrate import calibrate
from calib.verbs.fleet.fleet_row import (
    DONE,
    FAILED,
    ROW_LAYOUT,
    FleetParameter,
    FleetRow,
    fleet_csv,
    measured_hash,
)

PARAMETERS = (
    FleetParameter("p", "m", 3e-4, 1e-5),
    FleetParameter("q", "rad", 0.1, math.nan),
)
ROW = FleetRow(
    "SN-1",
    DONE,
    verdict="use",
    model="dh",
    rows=30,
    nominal_rms={"m": 3e-3},
    held_out_rms={"m": 8.1234567e-5},
    sigma={"m": 4e-5},
    kind="ur3 base tool0 j1",
    data="1.csv",
    measured="1",
    parameters=PARAMETERS,
)


def test_the_same_measurements_in_another_order_or_unit_have_the_same_hash(paper_table):
    m = paper_table
    turned = Measurements(m.joint_names, m.joints[::-1] * (1.0 + 1e-13), m.points[::-1])
    assert measured_hash(turned) == measured_hash(m)
    moved = m.points.copy()
    moved[4, 1] += 1e-6
    assert measured_hash(Measurements(m.joint_names, m.joints, moved)) != measured_hash(m)


def test_a_row_survives_its_file():
    table = json.loads(json_bytes(ROW_LAYOUT.table(ROW)))
    assert repr(ROW_LAYOUT.read(FleetRow, table)) == repr(ROW)


def test_the_csv_table_is_in_mm_with_texts_and_empty_cells():
    failed = FleetRow("SN-2", FAILED, "no rows,\n  at all")
    content = fleet_csv([ROW, failed], {"SN-1": ["noise 9 mm", "p 20 mm"]})
    first, second = csv.DictReader(content.decode().splitlines())
    assert first["nominal_rms [mm]"] == "3"
    assert first["held_out_rms [mm]"] == "0.0812346"
    assert first["calibrated_rms [mm]"] == ""
    assert "sigma [mrad]" not in first
    assert first["rows"] == "30"
    assert first["outlier"] == "noise 9 mm; p 20 mm"
    assert (second["outlier"], second["sigma [mm]"]) == ("", "")
    assert second["message"] == "no rows, at all"
    assert {"kind", "measured", "parameters"}.isdisjoint(first)


def test_the_csv_table_has_parameters_dates_and_hashes():
    zeros = (
        FleetParameter("zero of j1", "rad", -2e-3, 1e-4),
        FleetParameter("zero of j2", "m", 1e-3, 1e-4),
    )
    own = replace(
        ROW,
        zeros=zeros,
        serial="7",
        measured_on="2026-03-01",
        calibrated_on="2026-03-02T10:00:00Z",
        robot_sha256="a",
        data_sha256="b",
        urdf_sha256="c",
        result_sha256="d",
    )
    other = replace(ROW, name="SN-3", parameters=(FleetParameter("r", "1", 2.0, 0.1),))
    first, second = csv.DictReader(fleet_csv([own, other], {}).decode().splitlines())
    shown = {
        "p [mm]": "0.3",
        "q [mrad]": "",
        "r [1]": "",
        "zero of j1 [mrad]": "-2",
        "zero of j2 [mm]": "1",
    }
    assert {name: first[name] for name in shown} == shown
    assert (second["p [mm]"], second["r [1]"], second["zero of j1 [mrad]"]) == ("", "2", "")
    assert (first["serial"], first["measured_on"], first["calibrated_on"]) == (
        "7",
        "2026-03-01",
        "2026-03-02T10:00:00Z",
    )
    hashes = ("robot_sha256", "data_sha256", "urdf_sha256", "result_sha256")
    assert [first[name] for name in hashes] == ["a", "b", "c", "d"]


def test_a_row_has_the_dates_and_zeros_of_its_calibration(ur3, paper_table):
    calibrations = [
        calibrate(ur3, paper_table, cell=Cell(model="zeros", record=record), validate=False)
        for record in (Record(robot_serial="7", date="2026-03-01"), Record())
    ]
    dated, undated = (FleetRow.of("r", one) for one in calibrations)
    assert (dated.serial, dated.measured_on) == ("7", "2026-03-01")
    assert (undated.serial, undated.measured_on) == ("", undated.calibrated_on)
    assert parse_date(dated.calibrated_on) is not None
    assert dated.robot_sha256 == ur3.urdf.sha256
    zeros = calibrations[0].zeros
    assert zeros is not None
    assert [zero.name for zero in dated.zeros] == [f"zero of {joint}" for joint in ur3.joint_names]
    assert [zero.change for zero in dated.zeros] == zeros.delta.tolist()
    assert {zero.unit for zero in dated.zeros} == {"rad"}


def test_a_scale_error_that_all_robots_share_hides_no_difference_between_them(ur3, paper_table):
    exact, unknown = (
        calibrate(
            ur3, paper_table, cell=Cell(model="dh", scale_certified=certified), validate=False
        )
        for certified in (True, False)
    )
    name = "a3"
    assert unknown.parameter(name).std > 2.0 * exact.parameter(name).std
    stds = [
        {parameter.name: parameter.std for parameter in FleetRow.of("r", c).parameters}
        for c in (exact, unknown)
    ]
    assert stds[0] == pytest.approx(stds[1], rel=1e-9, nan_ok=True)
    assert stds[0][name] == pytest.approx(exact.parameter(name).std)


def test_names_that_utf_8_does_not_have_are_escaped():
    content = fleet_csv([replace(ROW, data="a\udcff.csv")], {})
    assert b"a\\udcff.csv" in content


@pytest.mark.parametrize("text", ["a,b", 'say "x"'])
def test_texts_with_commas_and_quotes_survive(text):
    content = fleet_csv([replace(ROW, data=text)], {})
    (row,) = csv.DictReader(content.decode().splitlines())
    assert row["data"] == text
