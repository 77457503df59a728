"""The report of every kind of calibration: what it says is what was found, with units, on stated rows."""

from __future__ import annotations

import hashlib
import re
from html.parser import HTMLParser

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import FileError
from calib.report import figures as figures, report as report
from calib.report.figures import drawings
from calib.report.report import report_bytes, write_report
from calib.text.verdict import reason_text

CASES = ["paper", "hostile_names", "distances"]
CASES += [
    pytest.param(case, marks=pytest.mark.slow)
    for case in (
        "poses",
        "one_row",
        "auto",
        "with_outliers",
        "do_not_use",
        "non_geometric",
        "mixed",
    )
]

#: What a number in a table may be counted in; the head of its column, its group or the table's title names one.
UNITS = re.compile(r"\[(mm|deg|mrad)\]|number|score|weight|evidence|parameters|held-out rms|used")

#: Elements of HTML that have no end tag.
EMPTY = {"meta", "img"}


class Page(HTMLParser):
    """The texts, attributes and tables of a page; every element is closed."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.texts: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip() and self.open[-1] != "style":
            self.texts.append(" ".join(data.split()))

    @property
    def text(self) -> str:
        return " ".join(self.texts)


@pytest.fixture
def page(monkeypatch):
    """The report of a calibration without its figures, which take their time."""
    monkeypatch.setattr(figures, "drawings", lambda _: ())
    return lambda c: Page(report_bytes(c, command="calib calibrate --x <b>").decode())


def every_table(c):
    """All the tables of a report."""
    makers = ("errors", "validation_rows", "non_geometric", "dh", "origins", "flagged")
    made = [getattr(report, maker)(c) for maker in (*makers, "ranges")]
    made += [report.parameters(c, unit) for unit in ("mm", "deg")]
    return [*made, report.errors(c, turned=True)]


@pytest.mark.parametrize("name", CASES)
def test_every_page_is_whole_and_its_verdict_comes_first(page, calibrations, name):
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
    assert made.tags.count("h2") == 11 + bool(c.candidates)
    assert made.tags.count("caption") == sum(bool(table.rows) for table in every_table(c))
    for one in every_table(c):  # every column of numbers has a unit or is a count
        width = len(one.head)
        assert {width, *map(len, one.rows)} == {len(one.align)}
        labels = [label for label, span in one.groups for _ in range(span)] or [""] * width
        for head, group, side in zip(one.head, labels, one.align, strict=True):
            if side == "r" and "unit" not in one.head:
                assert UNITS.search(f"{one.title.split(';')[0]} {group} {head}")


def test_nothing_in_a_name_means_anything(page, calibrations):
    c = calibrations.made("hostile_names")
    made = page(c)
    assert made.tags.count("style") == 1
    for name in (*calibrations.HOSTILE, calibrations.HOSTILE_SOURCE):
        assert " ".join(name.split()) in made.text
    source = report_bytes(c).decode()
    (policy,) = re.findall(r'Security-Policy" content="([^"]*)"', source)
    assert policy == "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    assert (
        '<span class="word">--x</span> <span class="word">&lt;b&gt;</span>'
        in report_bytes(c, command="--x <b>").decode()
    )


def test_errors_by_set_are_those_of_the_result(paper_calibration):
    c = paper_calibration
    table = report.errors(c)
    found = {row[0]: row[1:] for row in table.rows}
    for who in ("nominal", "calibrated"):
        for name in ("estimation", "validation"):
            e = c.errors[who][name]
            wanted = 1e3 * np.array([e.max, e.mean, e.rms, *e.span_axis])
            row = found[f"{name} rows, {who}"]
            assert int(row[0]) == e.n
            np.testing.assert_allclose([float(v) for v in row[1:]], wanted, atol=5.1e-4)
    held_out = found["held-out rows*, calibrated, without outliers"]
    rms = 1e3 * c.cross_validation.errors_without_outliers.rms
    assert float(held_out[3]) == pytest.approx(rms, abs=5.1e-4)
    assert table.note.startswith("* leave-one-out: each row predicted from the others alone. Span:")
    assert {table.rows[k][0].split(",")[1] for k in table.strong} == {" calibrated"}


def test_validation_rows_are_those_of_the_paper_s_table_4(paper_calibration):
    c = paper_calibration
    table = report.validation_rows(c)
    assert [row[0] for row in table.rows] == ["31", "32", "33", "34", "35"]
    values = np.array([[float(v) for v in row[1:]] for row in table.rows])
    for start, residual in ((0, c.residual_nominal), (4, c.residual_calibrated)):
        wanted = 1e3 * residual[c.measurements.validation]
        prior_std = np.linalg.norm(wanted, axis=1)
        np.testing.assert_allclose(values[:, start : start + 3], wanted, atol=5.1e-4)
        np.testing.assert_allclose(values[:, start + 3], prior_std, atol=5.1e-4)
    assert table.groups == [("", 1), ("before: nominal [mm]", 4), ("after: calibrated [mm]", 4)]


def test_parameters_with_correction_and_interval(page, paper_calibration):
    c = paper_calibration
    rows = {r[0]: r for unit in ("mm", "deg") for r in report.parameters(c, unit).rows}
    assert set(rows) == {p.name for p in c.parameters}
    for p in c.parameters:
        scale = 1e3 if p.unit == "m" else np.degrees(1.0)
        _, *numbers, known = rows[p.name]
        wanted = scale * np.array([p.nominal, p.value, p.delta, 0.5 * (p.high - p.low)])
        np.testing.assert_allclose([float(v) for v in numbers], wanted, atol=5.1e-4)
        assert known == ("yes" if p.identifiable else "jointly")
        assert numbers[2][0] in "+-" or float(numbers[2]) == 0.0
    text = page(c).text
    assert "27 parameters of the model 'paper' were estimated from 30 estimation rows, 2 of" in text
    assert "half the 95 % interval, 2.00 standard deviations" in text


@pytest.mark.parametrize(
    "name", ["paper", "hostile_names", pytest.param("prismatic", marks=pytest.mark.slow)]
)
def test_the_dh_rows_give_the_poses_of_both_robots(calibrations, name):
    c = calibrations.made(name)
    table = report.dh(c)
    assert [row[0] for row in table.rows[::3]] == [joint.name for joint in c.nominal.joints]
    values = np.array([[float(v) for v in row[2:]] for row in table.rows])
    before, after, change = values[::3], values[1::3], values[2::3]
    difference = after - before
    angles = [1, 3, 4][: values.shape[1] - 2]
    difference[:, angles] = np.mod(difference[:, angles] + 180.0, 360.0) - 180.0
    np.testing.assert_allclose(change, difference, atol=1.1e-3)
    # Rows of one robot that is hardly changed hardly differ: no axis is turned round.
    assert np.abs(change[:, angles]).max() < 2.0


def test_origins_are_displaced_by_what_the_table_says(paper_calibration):
    c = paper_calibration
    for joint, *values in report.origins(c).rows:
        shift, turn = np.split(1e-3 * np.array([float(v) for v in values]), 2)
        moved = c.nominal.origins()[joint] @ pin.SE3(pin.exp3(turn), shift).homogeneous
        np.testing.assert_allclose(moved, c.robot.origins()[joint], atol=2e-6)


def test_flagged_rows(calibrations):
    rows = report.flagged(calibrations.made("paper")).rows
    assert [list(row) for row in rows] == [
        ["11", "estimate", "1.592", "1.988", "17.3", "0.00"],
        ["14", "estimate", *rows[1][2:]],
    ]


def test_files_have_the_hashes_of_what_is_written(page, paper_calibration, tmp_path):
    c = paper_calibration
    written = c.write_urdf(tmp_path / "corrected.urdf").read_bytes()
    text = page(c).text
    for sha in (c.nominal.urdf.sha256, c.measurements.sha256, hashlib.sha256(written).hexdigest()):
        assert f"SHA-256 {sha}" in text
    assert "Command calib calibrate --x <b>" in text


@pytest.mark.usefixtures("page")
def test_nothing_but_the_date_differs_between_two_reports(paper_calibration, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    once = report_bytes(paper_calibration)
    assert report_bytes(paper_calibration) == once
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    later = report_bytes(paper_calibration).decode()
    assert once.decode().replace("2023-11-14 22:13", "2027-01-15 08:00") == later


@pytest.mark.usefixtures("page")
def test_a_page_is_written_and_not_written_over(paper_calibration, tmp_path):
    path = write_report(paper_calibration, tmp_path / "r.HTML", command="calib calibrate")
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    with pytest.raises(FileError, match="exists already"):
        write_report(paper_calibration, path)
    with pytest.raises(FileError, match=r"let the name end in \.html"):
        write_report(paper_calibration, tmp_path / "report.pdf")
    write_report(paper_calibration, path, overwrite=True)


@pytest.mark.slow
def test_figures_stand_where_they_belong_and_a_large_one_is_a_picture(
    paper_calibration, monkeypatch
):
    monkeypatch.setattr(report, "_LARGE", 60_000)
    text = report_bytes(paper_calibration).decode()
    made = drawings(paper_calibration)
    kinds = re.findall(r'src="data:image/([^;]+);base64,', text)
    assert len(kinds) == len(made)
    assert set(kinds) == {"svg+xml", "png"}
    sections = re.split(r"<h2>\d+&ensp;", text)
    named = {s.split("<")[0]: re.findall(r'<figure class="([^"]+)"', s) for s in sections[1:]}
    assert named["Figures of the errors"][0] == "points"
    assert named["Parameters"] == ["parameter-changes", "correlations"]
    assert named["How it was computed"] == ["convergence"]
    assert sorted(n for names in named.values() for n in names) == sorted(d.name for d in made)
    numbers = [int(n) for n in re.findall(r"<b>Figure (\d+)\.", text)]
    assert numbers == list(range(1, len(made) + 1))


@pytest.mark.slow
def test_chromium_shows_and_prints_hostile_names(browser, calibrations, tmp_path):
    c = calibrations.made("hostile_names")
    path = write_report(c, tmp_path / "report.html")
    # The size of A4 at 96 dots an inch.
    with browser.open(path.as_uri(), size=(794, 1123)) as tab:
        assert tab.complaints == []
        assert tab.elsewhere == []
        title = tab.evaluate("document.title")
        assert title == f"Calibration report: robot {calibrations.HOSTILE[0]}"
        assert tab.evaluate("document.scripts.length") == 0
        figures = tab.evaluate("[...document.images].map(i => i.complete && i.naturalWidth)")
        assert len(figures) == len(drawings(c))
        assert min(figures) > 300
        # No table is wider than the page, no column of words so narrow that they break.
        wide = "[...document.querySelectorAll('.wide')].map(e => e.scrollWidth - e.clientWidth)"
        assert max(tab.evaluate(wide)) <= 0
        assert tab.evaluate("document.documentElement.scrollWidth") <= 794
        assert tab.screenshot().std() > 10
        pdf = tab.pdf()
    assert pdf.startswith(b"%PDF")
    assert 8 <= len(re.findall(rb"/Type /Page\b", pdf)) <= 20
