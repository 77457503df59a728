"""The JSON of a certificate: every number by its key, as in memory."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.data.measurements import Measurements
from calib.errors import FileError
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.certificate.certificate_file import SCHEMA
from tests.verbs.certificate.certificates import LIMITS, RECORD, own


def test_the_file_has_what_the_value_has(
    ur3: Robot, table: Measurements, default_result: Calibration, tmp_path: Path
):
    c = own(ur3, table, default_result, **LIMITS)
    path = c.write_json(tmp_path / "c.json")
    read = json.loads(path.read_text("utf-8"))
    assert (read["schema"], read["id"], read["outcome"]) == (SCHEMA, c.id, c.outcome)
    assert read["record"]["customer"] == RECORD.customer
    assert read["inputs"]["measurements"] == {
        "name": table.source, "sha256": table.sha256, "fresh": False,
    }  # fmt: skip
    assert read["item"]["sha256_nominal"] == ur3.urdf.sha256
    assert read["item"]["sha256_corrected"] == default_result.robot.urdf.sha256
    assert read["inputs"]["result"]["run"] == default_result.run
    for point, of_file in zip(c.points, read["points"], strict=True):
        one = point.deviations["m"]
        assert of_file["rows"] == [*point.rows]
        assert of_file["m"]["as_found"] == one.found
        assert of_file["m"]["as_left"] == one.left
        assert of_file["m"]["expanded_uncertainty"] == one.uncertainty
        assert of_file["m"]["conformance_probability"] == one.conformance
    decision = c.decisions["m"]
    assert read["decisions"]["m"]["global_risk_of_acceptance"] == decision.risks.consumer
    assert read["decisions"]["m"]["guard_band"] == decision.check.uncertainty
    shares = [line["share"] for line in read["budget"]["lines"]]
    assert sum(shares) == pytest.approx(1.0)
    assert {gap["code"] for gap in read["not_tested"]} >= {"orientations", "repeats"}
    assert read["verdict"]["use"] == default_result.verdict.use
    with pytest.raises(FileError, match="exists"):
        c.write_json(path)
