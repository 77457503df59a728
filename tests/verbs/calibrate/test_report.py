"""The report of every kind of calibration: complete, verdict first, names as text only, with the right hashes."""

from __future__ import annotations

import hashlib
import importlib.util
import re
from dataclasses import replace

import pytest

from calib.data.record import Record
from calib.errors import CalibError, FileError
from calib.show import as_html as page_module
from calib.show.as_html import notebook_html, page_bytes
from calib.show.as_text import page_text
from calib.show.error_tables import ERROR_COLUMNS, ErrorColumn
from calib.show.lines import mm
from calib.show.verdict_text import reason_text
from calib.verbs.calibrate import report as report_module
from calib.verbs.calibrate.figures import drawings, write_figures
from calib.verbs.calibrate.report import report, write_report
from tests.show.pages import FULL_RECORD, Page
from tests.verbs.calibrate.test_tables import every_table

CASES = [
    "paper",
    "hostile_names",
    "distances",
    pytest.param("poses", marks=pytest.mark.slow),
    pytest.param("one_row", marks=pytest.mark.slow),
    pytest.param("auto", marks=pytest.mark.slow),
    pytest.param("with_outliers", marks=pytest.mark.slow),
    pytest.param("do_not_use", marks=pytest.mark.slow),
    pytest.param("non_geometric", marks=pytest.mark.slow),
    pytest.param("mixed", marks=pytest.mark.slow),
]


@pytest.fixture
def page(monkeypatch):
    """The report of a calibration without its figures, which take their time."""
    monkeypatch.setattr(report_module, "drawings", lambda _: ())
    return lambda c: Page(source_of(c))


def source_of(c, command: str = "calib calibrate --x <b>") -> str:
    return page_bytes(report(c, command=command)).decode()


@pytest.mark.parametrize("name", CASES)
def test_every_page_is_complete_and_its_verdict_comes_first(page, calibrations, name):
    c = calibrations.made(name)
    made = page(c)
    text = made.text
    assert not re.search(r"\b(nan|inf|None(?! of))\b", text)
    assert "-0.000 " not in text
    assert "script" not in made.tags
    assert not [key for key, _ in made.attributes if key.startswith("on")]
    use = "none" if c.verdict is None else c.verdict.use
    assert text.index(f"Verdict: {use}") < text.index("Accuracy before and after")
    for reason in () if c.verdict is None else c.verdict.reasons:
        assert " ".join(reason_text(reason).split()) in text
    # Those of figures alone are empty here.
    assert made.tags.count("h2") == 9 + (not c.unknown_accuracy)
    # One more on the first page.
    assert made.tags.count("caption") == 1 + len(every_table(c))


def test_names_are_text_only(page, calibrations):
    c = calibrations.made("hostile_names")
    made = page(c)
    assert made.tags.count("style") == 1
    for name in (*calibrations.HOSTILE, calibrations.HOSTILE_SOURCE):
        assert " ".join(name.split()) in made.text
    (policy,) = re.findall(r'Security-Policy" content="([^"]*)"', source_of(c))
    assert policy == "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    assert '<span class="word">--x</span> <span class="word">&lt;b&gt;</span>' in source_of(
        c, "--x <b>"
    )


def test_the_first_page_has_the_record_and_the_errors(page, paper_calibration):
    record = Record(robot_serial="20183300123", instrument="tracker", temperature_C=(21.4, 22.06))
    c = replace(paper_calibration, record=record)
    made = page(c)
    assert made.forms["Robot, serial no."] == "20183300123"
    assert made.forms["Air temperature [°C]"] == "21.4 to 22.1"
    assert made.forms["Noise (1 sigma)"] == f"{mm(c.noise.sigma['m'])} mm per coordinate"
    assert (made.forms["Customer"], made.forms["Signature"]) == ("", "")
    _, _, *rows = made.table("Size of the error by set of rows")
    before, after = (
        c.errors["nominal"]["validation"]["m"],
        c.errors["calibrated"]["validation"]["m"],
    )
    cells = [mm(v) for e in (before, after) for v in (e.max, e.mean, e.rms)]
    assert rows[0] == ["position [mm]", "validation rows", "5", *cells]
    without = c.cross_validation.errors_without_outliers["m"]
    assert rows[2][-3:] == [mm(without.max), mm(without.mean), mm(without.rms)]
    assert "30 poses, each measured 1 time." in made.text


def test_counts_of_parameters_and_rows_and_the_factor_of_the_interval(page, paper_calibration):
    text = page(paper_calibration).text
    assert "27 parameters of the model 'paper' were estimated from 30 estimation rows, 2 of" in text
    assert "half the 95 % interval, 2.00 standard deviations" in text


def test_files_have_the_hashes_of_their_bytes(page, paper_calibration, tmp_path):
    c = paper_calibration
    written = c.write_urdf(tmp_path / "corrected.urdf").read_bytes()
    text = page(c).text
    for sha in (
        c.nominal.urdf.sha256,
        c.fit.measurements.sha256,
        hashlib.sha256(written).hexdigest(),
    ):
        assert f"SHA-256 {sha}" in text
    assert "Command calib calibrate --x <b>" in text


@pytest.mark.usefixtures("page")
def test_nothing_but_the_date_differs_between_two_reports(paper_calibration, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    once = source_of(paper_calibration)
    assert source_of(paper_calibration) == once
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    later = source_of(paper_calibration)
    assert once.replace("2023-11-14 22:13", "2027-01-15 08:00") == later


@pytest.mark.usefixtures("page")
def test_a_page_is_written_and_not_written_over(paper_calibration, tmp_path):
    path = write_report(paper_calibration, tmp_path / "r.HTML", command="calib calibrate")
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    with pytest.raises(FileError, match="exists already"):
        write_report(paper_calibration, path)
    with pytest.raises(FileError, match=r"let the name end in \.html"):
        write_report(paper_calibration, tmp_path / "report.txt")
    write_report(paper_calibration, path, overwrite=True)


@pytest.mark.slow
def test_figures_stand_in_their_sections_and_a_large_one_is_a_picture(
    paper_calibration, monkeypatch
):
    monkeypatch.setattr(page_module, "_LARGE", 60_000)
    text = source_of(paper_calibration)
    made = drawings(paper_calibration)
    kinds = re.findall(r'src="data:image/([^;]+);base64,', text)
    assert len(kinds) == len(made)
    assert set(kinds) == {"svg+xml", "png"}
    sections = re.split(r"<h2>\d+&ensp;", text)
    named = {s.split("<")[0]: re.findall(r'<figure class="([^"]+)"', s) for s in sections[1:]}
    assert named["Figures of the errors"][0] == "points"
    assert named["Parameters"] == ["parameter-changes", "correlations"]
    assert named["Method"] == ["convergence"]
    assert sorted(n for names in named.values() for n in names) == sorted(d.name for d in made)
    numbers = [int(n) for n in re.findall(r"<b>Figure (\d+)\.", text)]
    assert numbers == list(range(1, len(made) + 1))


@pytest.mark.slow
def test_chromium_shows_and_prints_hostile_names(browser, calibrations, tmp_path):
    c = replace(calibrations.made("hostile_names"), record=FULL_RECORD)
    path = write_report(c, tmp_path / "report.html")
    # The size of A4 at 96 dots an inch.
    with browser.open(path.as_uri(), size=(794, 1123)) as tab:
        assert tab.complaints == []
        assert tab.elsewhere == []
        title = tab.evaluate("document.title")
        assert title == f"Calibration report: robot {calibrations.HOSTILE[0]}"
        assert tab.evaluate("document.scripts.length") == 0
        shown = tab.evaluate("[...document.images].map(i => i.complete && i.naturalWidth)")
        assert len(shown) == len(drawings(c))
        assert min(shown) > 300
        # No table is wider than the page, no column of words so narrow that they break.
        wide = "[...document.querySelectorAll('.wide')].map(e => e.scrollWidth - e.clientWidth)"
        assert max(tab.evaluate(wide)) <= 0
        assert tab.evaluate("document.documentElement.scrollWidth") <= 794
        assert tab.screenshot().std() > 10
        pdf = tab.pdf()
        tab.evaluate("document.querySelector('main').remove()")
        first = tab.pdf()
    assert len(re.findall(rb"/Type /Page\b", first)) == 1
    assert pdf.startswith(b"%PDF")
    assert 8 <= len(re.findall(rb"/Type /Page\b", pdf)) <= 20


def test_the_rows_say_in_which_convention_orientations_were_given(page, paper_calibration):
    c = paper_calibration
    assert "orientations as" not in page(c).text
    m = replace(c.fit.measurements, orientation="kuka")
    kuka = replace(c, fit_in_memory=replace(c.fit, measurements=m))
    assert page(kuka).text.count("orientations as KUKA's A, B, C") == 2


def test_a_column_more_in_the_tables_of_errors_is_in_every_drawing(paper_calibration):
    """One typed column, given as a parameter: summary, report and notebook have it."""
    c = paper_calibration
    further = ErrorColumn("95 %", lambda errors: 0.95 * errors.max, "95th percentile")
    made = report(c, columns=(*ERROR_COLUMNS, further))
    errors = c.errors["calibrated"]["validation"]["m"]
    cells = [mm(v) for v in (errors.max, errors.mean, errors.rms, *errors.span_axis)]
    cells.append(mm(0.95 * errors.max))

    (line,) = [
        k for k in page_text(made).splitlines() if k.startswith("validation rows, calibrated")
    ]
    assert line.split()[4:] == cells
    assert max(map(len, page_text(made).splitlines())) <= 100
    for drawn in (Page(page_bytes(made).decode()), Page(notebook_html(made))):
        _, heads, row, *_ = drawn.table("Size of the error by set of rows")
        assert (heads.count("95 %"), row[-1]) == (2, cells[-1])
    whole = Page(page_bytes(made).decode()).table("Position error [mm]")
    assert whole[1][-1] == "95 %"
    assert whole[5][2:] == cells


def test_a_report_without_matplotlib_is_refused_before_anything_is_made(
    paper_calibration, tmp_path, monkeypatch
):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(CalibError, match=r"A report needs .*robot-calib\[report\]"):
        paper_calibration.write_report(tmp_path / "r.html")
    with pytest.raises(CalibError, match="A figure needs matplotlib"):
        write_figures(paper_calibration, tmp_path / "figures")
    assert list(tmp_path.iterdir()) == []
    assert "Verdict: use" in paper_calibration.summary()
