"""Evaluations as nested tables: their numbers in SI units, and every key of the document."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.basics.json_files import plain
from calib.errors import FileError
from calib.result.calibration_file import read_result, write_table
from calib.robot.robot import Robot
from calib.verbs.evaluate.acceptance import acceptance, assess
from calib.verbs.evaluate.evaluation_file import acceptance_table, accuracy_table, assessment_table
from tests.result.test_calibration_file import documented, leaves
from tests.verbs.evaluate.test_acceptance import evaluation
from tests.verbs.evaluate.test_text import KNOWN, measured


def test_an_evaluation_is_in_si_units(ur3: Robot):
    limits = {"tolerance": {"m": 2e-3}, "uncertainty": {"m": 1e-4}}
    assessment = assess(ur3, measured(ur3, 1e-4 * np.arange(1, 13)), KNOWN, limits=limits)
    table = assessment_table(assessment)
    assert table["acceptance"]["outcome"] == "pass"
    assert table["acceptance"]["m"]["tolerance"] == 2e-3
    assert table["acceptance"]["m"]["held"] == assessment.accepted.checks["m"].held
    assert "rad" not in table["acceptance"]
    assert table["frames"]["registered"] == []
    accuracy = accuracy_table(assessment.accuracies["urdf"])
    assert accuracy["m"]["ap_max"] == pytest.approx(1.2e-3)
    assert accuracy["repeats_min"] == accuracy["repeats_max"] == 3
    assert accuracy["poses"][-1]["m"]["ap"] == pytest.approx(1.2e-3)


def test_an_acceptance_and_its_accuracy_are_in_si_units(ur3: Robot):
    found = evaluation(ur3, [0.1, 0.2], 3, turns=[1.0, 2.0])
    a = acceptance(found, {"m": 0.5e-3}, uncertainty={"m": 0.1e-3})
    table = json.loads(json.dumps(plain(acceptance_table(a))))
    assert (table["outcome"], table["criterion"], "rad" in table) == ("pass", "max", False)
    assert table["m"]["figure"] == pytest.approx(0.2e-3)
    assert (table["m"]["tolerance"], table["m"]["uncertainty"]) == (0.5e-3, 0.1e-3)
    assert (table["within"], table["share"]) == (2, pytest.approx(0.05**0.5))
    figures = json.loads(json.dumps(plain(accuracy_table(a.accuracy))))
    assert figures["rad"]["ap_max"] == pytest.approx(2e-3)
    assert (figures["repeats_min"], figures["repeats_max"], figures["rows"]) == (3, 3, "all")
    assert [pose["rows"] for pose in figures["poses"]] == [[1, 2, 3], [4, 5, 6]]
    assert figures["poses"][1]["m"]["ap_axis"] == pytest.approx([0.2e-3, 0.0, 0.0], abs=1e-12)


def test_the_document_has_every_key_of_an_evaluation(calibrated: Any, tmp_path: Path):
    _, c = calibrated("poses")
    cell = replace(c.fit.cell, target=None)
    found = assess(
        c.nominal, c.fit.measurements, cell, limits={"tolerance": {"m": 1.0, "rad": 1.0}}
    )
    stored = json.loads(
        write_table(assessment_table(found), tmp_path / "e.json").read_text(encoding="utf-8")
    )
    keys = {
        p
        for p in documented("What `calib evaluate --json` writes")
        if ".urdf." in p or "." not in p[:11]
    }
    keys |= {
        p
        for p in documented("What `calib evaluate --json` writes")
        if not p.startswith(("errors", "accuracy"))
    }
    # Neither references nor fresh rows: their tables are null.
    keys = {p for p in keys if not p.startswith(("drift.", "forecast."))} | {"drift", "forecast"}
    assert {path for path, _ in leaves(stored)} == keys
    with pytest.raises(FileError, match="its 'schema' is 'evaluation 4'; a result of calib"):
        read_result(tmp_path / "e.json")
