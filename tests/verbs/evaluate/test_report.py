"""The report of an evaluation: every figure is the one of the text and of the JSON file, and the outcome is obeyed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.data.cell import Cell
from calib.errors import ArgumentError, FileError
from calib.robot.robot import Robot
from calib.show.as_html import page_bytes
from calib.show.words import shown
from calib.verbs.evaluate.acceptance import Assessment
from calib.verbs.evaluate.report import report, summary, write_report
from tests.show.pages import FULL_RECORD, Page
from tests.verbs.evaluate.evaluations import RECORD, made, measured, page_of

NUMBER = re.compile(r"-?\d+\.\d+")


@pytest.fixture(scope="module")
def assessment(ur3: Robot) -> Assessment:
    return made(ur3)


def test_every_number_is_printed_too(assessment: Assessment):
    text = summary(assessment)
    printed = {*NUMBER.findall(text)}
    tables = [(caption, rows) for caption, rows in page_of(assessment).tables if caption]
    assert len(tables) == 1 + 1 + 2 + 1 + 1 + 2
    found = {n for _, rows in tables for row in rows for n in NUMBER.findall(" ".join(row[1:]))}
    assert found - printed == set()
    assert len(found) > 50


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
        evaluation.write_report(tmp_path / "test.md")
    with pytest.raises(ArgumentError, match="accepted"):
        evaluation.write_report(tmp_path / "other.html", accepted="pass")


@pytest.mark.slow
def test_the_first_page_is_one_sheet(browser, ur3: Robot, tmp_path: Path):
    page = write_report(made(ur3, record=FULL_RECORD), tmp_path / "full.html")
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
    page.write_bytes(page_bytes(report(assessment)))
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
