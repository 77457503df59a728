"""The page of a certificate: its form, its tables, one sheet to sign; and the text of the terminal."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from calib.data.measurements import Measurements
from calib.data.record import FOR_CERTIFICATES, Record
from calib.diagnosis.reasons import NO, Verdict
from calib.errors import FileError
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.show.as_html import page_bytes
from calib.verbs.certificate.certificate import Certificate
from calib.verbs.certificate.report import page, summary, write_report
from calib.verbs.certificate.text import with_uncertainty
from tests.parts import with_part
from tests.show.pages import FULL_RECORD, Page
from tests.verbs.certificate.certificates import LIMITS, RECORD, SIGMA, fresh_rows, own


@pytest.fixture(scope="module")
def paper(ur3: Robot, table: Measurements, default_result: Calibration) -> Certificate:
    return own(ur3, table, default_result, uncertainty={"m": 5e-5}, **LIMITS)


def page_of(c: Certificate) -> Page:
    return Page(page_bytes(page(c)).decode())


def test_the_form_has_the_record_and_blanks_what_it_lacks(paper: Certificate):
    forms = page_of(paper).forms
    assert forms["Certificate no."] == RECORD.certificate_number
    assert forms["Laboratory"] == f"{RECORD.laboratory}, DE"
    assert forms["Its certificate"] == RECORD.instrument_certificate
    assert forms["Traceable to"] == RECORD.traceability
    assert forms["Humidity"] == "41 %"
    assert forms["Uncertainty (k = 2)"] == "0.050 mm"
    assert forms["Signature"] == ""
    blank = page_of(replace(paper, record=Record())).forms
    for label in ("Certificate no.", "Laboratory", "Customer", "Its certificate", "Valid until"):
        assert blank[label] == ""
    filled = Record(
        **{name: "DE" if name == "country" else f"the {name}" for name in FOR_CERTIFICATES}
    )
    text = page_of(replace(paper, record=filled)).text
    for name in FOR_CERTIFICATES:
        assert name == "country" or f"the {name}" in text


def test_its_number_stands_on_every_sheet(paper: Certificate):
    html = page_bytes(page(paper)).decode()
    assert f'content: "Calibration certificate {RECORD.certificate_number} of ' in html


def test_the_table_of_points_has_every_deviation_rounded_to_its_uncertainty(paper: Certificate):
    head, *rows = page_of(paper).table("Deviations of the position")
    assert len(rows) == 5
    for row, point in zip(rows, paper.points, strict=True):
        cells = dict(zip(head, row, strict=True))
        one = point.deviations["m"]
        assert cells["rows"] == str(point.rows[0])
        found, expanded = with_uncertainty(one.found, one.uncertainty, "m")
        assert (cells["as found"], cells["U"], cells["k"]) == (found, expanded, "2.00")
        assert cells["as left"] == with_uncertainty(one.left, one.uncertainty, "m")[0]
    head, *rows = page_of(paper).table("as found and as left")
    assert rows[0][-2:] == ["0.5", "pass"]


def test_the_budget_adds_up(paper: Certificate):
    _, *rows = page_of(paper).table("Uncertainty budget")
    *lines, combined, expanded = rows
    squares = sum(float(row[1]) ** 2 for row in lines)
    assert float(combined[1]) == pytest.approx(squares**0.5, rel=1e-3)
    assert float(expanded[1]) > float(combined[1])


def test_hashes_versions_and_the_verdict_are_there(paper: Certificate, ur3: Robot):
    text = page_of(paper).text
    assert ur3.urdf.sha256 in text
    assert paper.calibration.robot.urdf.sha256 in text
    assert paper.id in text
    assert paper.calibration.run in text
    assert f"The verdict on the calibration: {paper.calibration.verdict.use}." in text


def test_the_text_has_the_outcome_first_and_fits_a_terminal(paper: Certificate):
    lines = summary(paper).splitlines()
    assert lines[0] == "Verdict: pass"
    assert max(map(len, lines)) <= 100
    without = replace(paper.assessment, accepted=None)
    undecided = summary(replace(paper, decisions={}, assessment=without))
    assert undecided.startswith("Verdict: none")


def test_a_verdict_against_the_calibration_is_said_at_once(paper: Certificate):
    said = "do not use"
    assert said not in summary(paper).partition("Deviations")[0]
    against = with_part(paper.calibration, "geometry", verdict=Verdict(NO, ()))
    text = summary(replace(paper, calibration=against)).partition("Deviations")[0]
    assert said in text


def test_both_units_have_a_table(ur3: Robot, default_result: Calibration):
    c = own(ur3, fresh_rows(default_result, 3), default_result, sigma=SIGMA)
    shown = page_of(c)
    assert len(shown.table("Deviations of the position")) == 9
    assert len(shown.table("Deviations of the orientation")) == 9


def test_names_of_files(paper: Certificate, tmp_path: Path):
    with pytest.raises(FileError, match=r"\.html or \.pdf"):
        paper.write_report(tmp_path / "c.txt")
    path = paper.write_report(tmp_path / "c.html")
    with pytest.raises(FileError, match="exists"):
        paper.write_report(path)


@pytest.mark.slow
def test_the_first_page_is_one_sheet(browser, paper: Certificate, tmp_path: Path):
    for name, record in (("full", FULL_RECORD), ("usual", RECORD)):
        path = write_report(replace(paper, record=record), tmp_path / f"{name}.html")
        with browser.open(path.as_uri(), size=(794, 1123)) as tab:
            assert tab.complaints == []
            wide = "[...document.querySelectorAll('.wide')].map(e => e.scrollWidth - e.clientWidth)"
            assert max(tab.evaluate(wide)) <= 0
            tab.evaluate("document.querySelector('main').remove()")
            first = tab.pdf()
        assert len(re.findall(rb"/Type /Page\b", first)) == 1, name
