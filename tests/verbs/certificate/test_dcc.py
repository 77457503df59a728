"""The DCC: pydcc reads it, and every number is the one of the JSON; ElementTree reads what pydcc does not."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.errors import CalibError, FileError
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.certificate.certificate import Certificate
from calib.verbs.certificate.dcc import dcc_bytes
from tests.verbs.certificate.certificates import LIMITS, RECORD, SIGMA, fresh_rows, own

SPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture(scope="module")
def certificates(
    ur3: Robot, table: Measurements, default_result: Calibration
) -> dict[str, Certificate]:
    return {
        "own": own(ur3, table, default_result, **LIMITS),
        "stated": own(ur3, table, default_result, uncertainty={"m": 5e-5}, tolerance={"m": 5e-4}),
        "fresh": own(ur3, fresh_rows(default_result, 3), default_result, sigma=SIGMA),
    }


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """The class DCC of pydcc, without the network.

    It looks for schemas in the home folder, and downloads them unless its folder is there. It verifies signatures by
    certvalidator, whose oscrypto does not load with OpenSSL 3.0.10 and later; nothing is signed here.
    """
    folder = tmp_path / "pydcc"
    folder.mkdir()
    (folder / "Readme.txt").write_text("")
    (folder / "data.json").write_text("{}")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("platform.system", lambda: "Linux")
    stand_in = ModuleType("certvalidator")
    for name in ("CertificateValidator", "ValidationContext", "errors"):
        setattr(stand_in, name, None)
    monkeypatch.setitem(sys.modules, "certvalidator", stand_in)
    yield importlib.import_module("dcc").DCC
    for name in [name for name in sys.modules if name.split(".")[0] == "dcc"]:
        del sys.modules[name]


def numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def quantities(read: Any) -> dict[str, dict[str, Any]]:
    """What pydcc finds, by the last word of its list's and the first word of its own refType."""
    found: dict[str, dict[str, Any]] = {}
    for path, node in read.get_calibration_results("xpath"):
        words = [part.split("'")[1] for part in path.split("[ @ refType =")[1:]]
        key = f"{words[0]}/{words[-1].split()[0]}"
        assert key not in found
        found[key] = next(iter(node.values()))
    return found


@pytest.mark.parametrize("name", ["own", "stated", "fresh"])
def test_pydcc_reads_every_number_of_the_json(
    reader: Any, certificates: dict[str, Certificate], tmp_path: Path, name: str
):
    c = certificates[name]
    written = json.loads(c.write_json(tmp_path / "c.json").read_text("utf-8"))
    read = reader(str(c.write_dcc(tmp_path / "c.xml")))
    assert read.is_loaded()
    assert read.uid() == written["record"]["certificate_number"]
    assert read.calibration_date().isoformat() == "2026-11-26T00:00:00"
    assert read.calibration_laboratory_name() == RECORD.laboratory
    assert (read.version(), read.mandatory_language()) == ("3.2.1", "en")

    found = quantities(read)
    for unit, what, symbol in (("m", "positions", r"\metre"), ("rad", "orientations", r"\radian")):
        points = [point for point in written["points"] if unit in point]
        if not points:
            continue

        def of(ref: str, what: str = what) -> dict[str, Any]:
            return found.pop(f"calib_{what}/calib_{ref}")

        assert numbers(of("row")["valueXMLList"]) == [point["rows"][0] for point in points]
        for k in range(6):
            values = numbers(of(f"joint{k + 1}")["valueXMLList"])
            assert values == [point["joints"][k] for point in points]
        for axis, letter in enumerate("xyz"):
            values = numbers(of(letter)["valueXMLList"])
            assert values == [point["position_m"][axis] for point in points]
        for ref, key in (("asFound", "as_found"), ("asLeft", "as_left")):
            node = of(ref)
            assert node["unitXMLList"] == symbol
            assert numbers(node["valueXMLList"]) == [point[unit][key] for point in points]
            expanded = node["expandedUncXMLList"]
            for part, stated in (
                ("uncertaintyXMLList", "expanded_uncertainty"),
                ("coverageFactorXMLList", "coverage_factor"),
            ):
                assert numbers(expanded[part]) == [point[unit][stated] for point in points]
            probability = numbers(expanded["coverageProbabilityXMLList"])
            assert probability == [written["coverage_probability"]]
        others = {"uncertaintyOfPose": "expanded_uncertainty_of_pose"}
        if written["decisions"]:
            others["conformanceProbability"] = "conformance_probability"
        if all(point[unit]["freedom"] is not None for point in points):
            others["freedom"] = "freedom"
        for ref, key in others.items():
            assert numbers(of(ref)["valueXMLList"]) == [point[unit][key] for point in points]

    lines, budget = written["budget"]["lines"], written["budget"]
    for ref, key in (
        ("position", "position_std_m"),
        ("orientation", "orientation_std_rad"),
        ("share", "share"),
    ):
        node = found.pop(f"calib_budget/calib_{ref}")
        assert node["labelXMLList"].split() == [line["source"] for line in lines]
        assert numbers(node["valueXMLList"]) == [line[key] for line in lines]
    for ref, key in (
        ("combinedPosition", "position_std_m"),
        ("expandedPosition", "position_expanded_m"),
        ("combinedOrientation", "orientation_std_rad"),
        ("expandedOrientation", "orientation_expanded_rad"),
    ):
        assert float(found.pop(f"calib_budget/calib_{ref}")["value"]) == budget[key]
    assert found == {}


@pytest.mark.parametrize("name", ["own", "stated", "fresh"])
def test_statements_and_conditions_are_those_of_the_json(
    certificates: dict[str, Certificate], tmp_path: Path, name: str
):
    c = certificates[name]
    written = json.loads(c.write_json(tmp_path / "c.json").read_text("utf-8"))
    root = ElementTree.parse(c.write_dcc(tmp_path / "c.xml")).getroot()

    def values(path: str) -> dict[str, list[float]]:
        found: dict[str, list[float]] = {}
        for node in root.iterfind(f".//{path}//dcc:quantity", SPACES):
            value = float(node.findtext("si:real/si:value", "", SPACES))
            found.setdefault(node.attrib["refType"], []).append(value)
        return found

    box = written["validity"]["joints"]
    assert values("dcc:statement[@refType='basic_validityRange']") == {
        "basic_validityRangeMin": [one["calibrated"][0] for one in box],
        "basic_validityRangeMax": [one["calibrated"][1] for one in box],
    }
    conditions = values("dcc:influenceConditions")
    ends = written["record"]["temperature_C"]
    assert conditions["basic_temperatureMin"] + conditions["basic_temperatureMax"] == ends
    assert conditions["basic_humidityRelativeMin"] == written["record"]["humidity_percent"]
    stated = values("dcc:statement[@refType='basic_conformity']")
    decision = written["decisions"].get("m", {})
    keys = {
        "calib_largestDeviation": "deviation",
        "calib_tolerance": "tolerance",
        "calib_guardBand": "guard_band",
        "calib_factor": "factor",
        "calib_conformanceProbability": "conformance_probability",
        "calib_specificRisk": "specific_risk",
        "calib_priorMean": "prior_mean",
        "calib_priorStd": "prior_std",
        "calib_globalRiskOfAcceptance": "global_risk_of_acceptance",
        "calib_globalRiskOfRejection": "global_risk_of_rejection",
    }
    expected = {ref: [decision[key]] for ref, key in keys.items() if decision.get(key) is not None}
    assert stated == expected
    codes = [
        node.attrib["refType"].split("calib_")[-1]
        for node in root.iterfind(".//dcc:statement", SPACES)
        if node.attrib["refType"].startswith("calib_notTested")
    ]
    assert codes == [gap["code"] for gap in written["not_tested"]]
    hashes = [node.text for node in root.iterfind(".//dcc:item//dcc:value", SPACES)]
    assert written["item"]["sha256_nominal"] in hashes
    assert written["item"]["sha256_corrected"] in hashes


@pytest.mark.parametrize(
    ("tolerance", "word"),
    [(4.5e-4, "pass"), (3.6e-4, "conditionalPass"), (3.2e-4, "conditionalFail"), (2e-4, "fail")],
)
def test_conformity_is_a_word_of_the_schema(
    ur3: Robot, table: Measurements, default_result: Calibration, tolerance: float, word: str
):
    c = own(ur3, table, default_result, uncertainty={"m": 5e-5}, tolerance={"m": tolerance})
    root = ElementTree.fromstring(dcc_bytes(c))
    assert root.findtext(".//dcc:conformity", "", SPACES) == word


def test_what_a_dcc_must_state_is_asked_for(certificates: dict[str, Certificate], tmp_path: Path):
    c = certificates["own"]
    with pytest.raises(CalibError, match="'certificate_number', 'laboratory', 'country'"):
        dcc_bytes(replace(c, record=Record()))
    with pytest.raises(CalibError, match=r"'country': add it"):
        dcc_bytes(replace(c, record=replace(RECORD, country="")))
    with pytest.raises(CalibError, match=r"26\.11\.2026"):
        dcc_bytes(replace(c, record=replace(RECORD, date="26.11.2026")))
    path = tmp_path / "c.xml"
    with pytest.raises(CalibError):
        replace(c, record=Record()).write_dcc(path)
    assert not path.exists()
    c.write_dcc(path)
    with pytest.raises(FileError, match="exists"):
        c.write_dcc(path)


def test_any_text_is_xml(certificates: dict[str, Certificate]):
    note = "a < b & \x08 \udcff \ud83d"
    c = replace(certificates["own"], record=replace(RECORD, note=note, instrument="", load=""))
    root = ElementTree.fromstring(dcc_bytes(c))
    (said,) = root.iterfind(".//dcc:statement[@refType='calib_note']", SPACES)
    assert (
        said.findtext("dcc:declaration/dcc:content", "", SPACES) == "a < b & \ufffd \ufffd \ufffd"
    )


def test_a_range_that_is_not_known_is_left_out(certificates: dict[str, Certificate]):
    c = certificates["own"]
    box = tuple(replace(one, calibrated=(np.inf, -np.inf)) for one in c.box)
    root = ElementTree.fromstring(dcc_bytes(replace(c, box=box)))
    (validity,) = root.iterfind(".//dcc:statement[@refType='basic_validityRange']", SPACES)
    assert validity.find("dcc:data", SPACES) is None
