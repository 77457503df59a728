"""The report of an evaluation: every figure is the one of the text and of the JSON file, and the outcome is obeyed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.channels import RESIDUAL_UNITS
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.errors import ArgumentError, FileError
from calib.report.evaluation_report import (
    Origins,
    evaluation_report_bytes,
    write_evaluation_report,
)
from calib.result.acceptance import Assessment, assess
from calib.result.evaluation_file import assessment_table
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.text.evaluation import assessment_text
from calib.text.layout.sizes import shown
from tests.report.pages import FULL_RECORD, Page

RECORD = Record(customer="A & B <c>", robot_serial="4711", temperature_C=(20.5,))

LIMITS = {"tolerance": {"m": 1e-3, "rad": 2e-3}, "uncertainty": {"m": 1e-4, "rad": 2e-4}}

NUMBER = re.compile(r"-?\d+\.\d+")


def measured(robot: Robot, worst: float) -> Measurements:
    """Six poses, five times each in turn, off by up to ``worst`` [m] along x; positions and orientations."""
    random = np.random.default_rng(7)
    q = np.tile(random_joint_values(robot, 6, 3), (5, 1))
    T = robot.poses(q)
    points = T[:, :3, 3] + random.normal(scale=2e-5, size=(30, 3))
    points[:, 0] += np.tile(np.linspace(0.1, 1.0, 6) * worst, 5)
    turns = Rotation.from_rotvec(random.normal(scale=2e-4, size=(30, 3)))
    approaches = tuple("xyxyx"[k // 6] for k in range(30))
    return Measurements(
        robot.joint_names,
        q,
        points,
        rotations=T[:, :3, :3] @ turns.as_matrix(),
        kinds=("pose",) * 30,
        approaches=approaches,
        source="fresh.csv",
    )


def made(robot: Robot, worst: float = 8e-4, record: Record = RECORD, **given) -> Assessment:
    cell = Cell(target=(0, 0, 0), target_rotation=np.eye(3), estimate_target=False, record=record)
    return assess(robot, measured(robot, worst), cell, limits=given.get("limits", LIMITS))


def page_of(e: Assessment) -> Page:
    return Page(evaluation_report_bytes(e, Origins(command="calib evaluate")).decode())


@pytest.fixture(scope="module")
def assessment(ur3: Robot) -> Assessment:
    return made(ur3)


def test_every_number_is_printed_too(assessment: Assessment):
    text = assessment_text(assessment, "", "as given")
    printed = {*NUMBER.findall(text)}
    tables = [(caption, rows) for caption, rows in page_of(assessment).tables if caption]
    assert len(tables) == 1 + 1 + 2 + 1 + 1 + 2
    found = {n for _, rows in tables for row in rows for n in NUMBER.findall(" ".join(row[1:]))}
    assert found - printed == set()
    assert len(found) > 50


def test_the_figures_are_those_of_the_file(assessment: Assessment):
    table = assessment_table(assessment)
    accuracy, page = table["accuracy"]["urdf"], page_of(assessment)
    for unit, title in (
        ("m", "Pose accuracy, ISO 9283 [mm]"),
        ("rad", "Orientation, ISO 9283 [deg]"),
    ):
        _, row = page.table(title)
        keys = ("ap_max", "ap_mean", "rp_max", "rp_mean", "single_max")
        assert row == ["URDF as it is", "6", *(shown(accuracy[unit][key], unit) for key in keys)]
        check = table["acceptance"][unit]
        _, *checks = page.table("Comparison with the tolerance")
        (row,) = [row for row in checks if RESIDUAL_UNITS[unit].measured in row[0]]
        keys = ("figure", "uncertainty", "held", "tolerance")
        figure, *others = (shown(check[key], unit) for key in keys)
        assert row[1:] == [figure, "1", *others, check["outcome"]]
    _, *rows = page.table("Further characteristics")
    found = [c for c in accuracy["characteristics"] if c["count"]]
    assert [c["symbol"] for c in found] == ["AD", "RD"]
    for row, c in zip(rows, found, strict=True):
        assert row[0].startswith(f"{c['symbol']} ")
        assert row[2:] == [shown(c["largest"], c["unit"]), shown(c["mean"], c["unit"])]
    _, *poses = page.table("Poses, the worst first")
    assert sorted(row[2] for row in poses) == sorted(
        shown(p["m"]["ap"], "m") for p in accuracy["poses"]
    )
    _, row = page.table("Position error [mm]")
    errors = table["errors"]["urdf"]["all"]["m"]
    assert row[2:6] == ["30", *(shown(errors[key], "m") for key in ("max", "mean", "rms"))]


def test_the_first_page_has_outcome_record_and_rule(assessment: Assessment):
    page = page_of(assessment)
    assert page.forms["Customer"] == "A & B <c>"
    assert page.forms["Robot, serial no."] == "4711"
    assert page.forms["Air temperature [°C]"] == "20.5"
    assert page.forms["Uncertainty (k = 2)"] == "0.100 mm and 0.0115 deg"
    assert page.forms["Measurements"] == "fresh.csv"
    assert page.forms["Order"] == page.forms["Signature"] == ""
    _, *rows = page.table("Pose accuracy and repeatability")
    compared = {row[0]: row for row in rows if row[-1]}
    assert list(compared) == ["AP max, position [mm]", "AP max, orientation [deg]"]
    check = assessment.accepted.checks["m"]
    values = (check.figure, check.uncertainty, check.held, check.tolerance)
    assert compared["AP max, position [mm]"][1:] == [*(shown(v, "m") for v in values), "pass"]
    assert "6 poses, each measured 5 times." in page.text
    assert "ISO 14253-1" in page.text
    assert "for a pass the supplier, for a rejection the customer" in page.text


def test_a_figure_that_fails_is_compared_without_its_uncertainty(ur3: Robot):
    e = made(ur3, 2e-3)
    check, page = e.accepted.checks["m"], page_of(e)
    values = (check.figure, check.uncertainty, check.figure - check.uncertainty, check.tolerance)
    _, row, *_ = page.table("Pose accuracy and repeatability")
    assert row[1:] == [*(shown(v, "m") for v in values), "fail"]
    _, row, _ = page.table("Comparison with the tolerance")
    assert row[4] == shown(check.figure - check.uncertainty, "m")


@pytest.mark.parametrize(
    ("worst", "outcome", "shade"),
    [(5e-4, "pass", "good"), (9.7e-4, "undecided", "care"), (2e-3, "fail", "bad")],
)
def test_every_outcome_stands_as_large_as_any(ur3: Robot, worst: float, outcome: str, shade: str):
    page = page_of(made(ur3, worst))
    assert page.texts[3] == f"Verdict: {outcome}"
    assert [value for key, value in page.attributes if key == "class"][1] == f"verdict {shade}"
    assert page.text.count(f"Verdict: {outcome}") == 3  # box, signatures, section
    others = {"pass", "undecided", "fail"} - {outcome}
    assert not [other for other in others if f"Verdict: {other}" in page.text]


def test_without_a_tolerance_there_is_no_outcome_but_every_figure(ur3: Robot):
    page = page_of(made(ur3, limits=None))
    assert "Verdict: none" in page.text
    assert "No tolerance was stated" in page.text
    assert page.forms["Uncertainty (k = 2)"] == ""
    head, *rows = page.table("Pose accuracy and repeatability")
    assert head == ["figure A", "URDF as it is"]
    assert len(rows) == 6
    assert not [caption for caption, _ in page.tables if "Comparison" in caption]


def test_python_writes_what_the_command_line_writes(ur3: Robot, tmp_path: Path):
    cell = Cell(target=(0, 0, 0), target_rotation=np.eye(3), estimate_target=False, record=RECORD)
    evaluation = calib.evaluate(ur3, measured(ur3, 8e-4), cell)
    path = evaluation.write_report(tmp_path / "plain.html")
    assert Page(path.read_text(encoding="utf-8")).forms["Customer"] == RECORD.customer
    accepted = calib.acceptance(evaluation, {"m": 5e-4})
    path = evaluation.write_report(tmp_path / "test.html", accepted=accepted)
    assert "Verdict: fail" in path.read_text(encoding="utf-8")
    with pytest.raises(FileError, match="exists already"):
        evaluation.write_report(path)
    with pytest.raises(FileError, match=r"let the name end in \.html"):
        evaluation.write_report(tmp_path / "test.pdf")
    with pytest.raises(ArgumentError, match="accepted"):
        evaluation.write_report(tmp_path / "other.html", accepted="pass")


@pytest.mark.slow
def test_the_first_page_is_one_sheet(browser, ur3: Robot, tmp_path: Path):
    page = write_evaluation_report(made(ur3, record=FULL_RECORD), tmp_path / "full.html")
    with browser.open(page.as_uri(), size=(794, 1123)) as tab:
        assert tab.complaints == []
        assert tab.elsewhere == []
        wide = "[...document.querySelectorAll('.wide')].map(e => e.scrollWidth - e.clientWidth)"
        assert max(tab.evaluate(wide)) <= 0
        whole = tab.pdf()
        tab.evaluate("document.querySelector('main').remove()")
        first = tab.pdf()
    assert len(re.findall(rb"/Type /Page\b", first)) == 1
    assert 3 <= len(re.findall(rb"/Type /Page\b", whole)) <= 5


def test_an_uncertainty_that_was_not_stated_is_no_zero(ur3: Robot):
    e = made(ur3, limits={"tolerance": {"m": 1e-3}})
    page = page_of(e)
    _, row, *_ = page.table("Pose accuracy and repeatability")
    figure = shown(e.accepted.checks["m"].figure, "m")
    assert row[1:] == [figure, "-", figure, "1.000", "pass"]
    _, row = page.table("Comparison with the tolerance")
    assert row[3:5] == ["-", figure]


@pytest.mark.slow
def test_on_a_phone_a_wide_table_scrolls_and_shows_that_it_does(
    browser, assessment: Assessment, tmp_path: Path
):
    page = tmp_path / "acceptance.html"
    page.write_bytes(evaluation_report_bytes(assessment, Origins()))
    with browser.open(page.as_uri(), size=(412, 860)) as tab:
        assert tab.evaluate("document.documentElement.scrollWidth") == 412
        captions = "[...document.querySelectorAll('caption')].map(e => e.getBoundingClientRect())"
        assert tab.evaluate(f"Math.max(...{captions}.map(box => box.right))") <= 412
        tab.evaluate("(wide = document.querySelector('.wide')).scrollIntoView()")
        assert tab.evaluate("wide.scrollWidth - wide.clientWidth") > 50
        left, right, height = tab.evaluate(
            "[(box = wide.getBoundingClientRect()).left, box.right, box.height]"
        )
        ends = np.array([left + 1, right - 2]).round().astype(int)
        height = int(height)
        before = np.median(tab.screenshot()[:height, ends, 0], axis=0)
        tab.evaluate("wide.scrollLeft = wide.scrollWidth")
        after = np.median(tab.screenshot()[:height, ends, 0], axis=0)
    # The background of the left and the right end of the table.
    assert before[0] > 250 > 220 > before[1]
    assert after[1] > 250 > 220 > after[0]
