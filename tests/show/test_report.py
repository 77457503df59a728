"""The report of every kind of calibration: what it says is what was found, with units, on stated rows."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import FileError
from calib.show.document import Document, Facts, Judgement, Paragraph, Table
from calib.show.report import ENDINGS, report_bytes, report_of, write_report
from calib.show.report_accuracy import accuracy_blocks
from calib.show.report_text import WIDTH, as_text, columns_of

CASES = [
    "paper",
    "auto",
    "poses",
    "two_joints",
    "prismatic",
    "with_outliers",
    "do_not_use",
    "three_rows",
    "one_row",
    "hostile_names",
    "larger",
    "many_parameters",
    "distances",
    "mixed",
]

#: What a number in a table may be counted in; the head of its column, its group or the table's title names one.
UNITS = re.compile(r"\[(mm|deg|mrad)\]|number|score|weight|evidence|parameters|left-out rms|used")


@pytest.fixture(scope="session")
def documents(calibrations):
    """The report of a case without figures, made once."""
    made: dict[str, Document] = {}

    def of(name: str) -> Document:
        if name not in made:
            made[name] = report_of(calibrations.made(name), command="calib fit", figures=False)
        return made[name]

    return of


def tables(document: Document) -> list[Table]:
    return [b for section in document.sections for b in section.blocks if isinstance(b, Table)]


def table_of(document: Document, title: str) -> Table:
    """The only table whose title begins with these words."""
    (found,) = [one for one in tables(document) if one.title.startswith(title)]
    return found


def section(document: Document, title: str):
    (found,) = [one for one in document.sections if one.title == title]
    return found.blocks


@pytest.mark.parametrize("name", CASES)
def test_it_is_made_and_fits_100_columns(documents, name):
    document = documents(name)
    text = as_text(document)
    assert all(columns_of(line) <= WIDTH for line in text.splitlines())
    assert all(line == line.rstrip() for line in text.splitlines())
    assert not re.search(r"\b(nan|inf|None(?! of))\b", text)
    assert document.sections[0].title == "Verdict"
    assert document.sections[1].title == "Accuracy before and after"
    assert document.sections[-1].title == "Signatures"
    assert "-0.000 " not in text


@pytest.mark.parametrize("name", CASES)
def test_every_column_of_numbers_has_a_unit_or_is_a_count(documents, name):
    for one in tables(documents(name)):
        labels = [label for label, span in one.groups for _ in range(span)] or [""] * len(one.head)
        units = "unit" in one.head
        for head, group, side in zip(one.head, labels, one.align, strict=True):
            if side == "r":
                assert units or UNITS.search(f"{one.title.split(';')[0]} {group} {head}"), (
                    one.title,
                    head,
                )


@pytest.mark.parametrize("name", CASES)
def test_the_verdict_is_the_first_thing_said(documents, calibrations, name):
    c = calibrations.made(name)
    (judged,) = documents(name).sections[0].blocks
    assert isinstance(judged, Judgement)
    if c.verdict is None:
        assert judged.use == "none"
        assert "cross-validated" in judged.reasons[0]
    else:
        assert (judged.use, judged.reasons) == (c.verdict.use, c.verdict.reasons)


def test_errors_by_set_are_those_of_the_result(documents, paper_calibration):
    c = paper_calibration
    block = table_of(documents("paper"), "Position error by set of rows [mm]")
    found = {row[0]: row[1:] for row in block.rows}
    for who in ("nominal", "calibrated"):
        for name in ("estimation", "validation"):
            e = c.errors[who][name]
            wanted = [e.max, e.mean, e.rms, *e.span_axis]
            row = found[f"{name} rows, {who}"]
            assert int(row[0]) == e.n
            np.testing.assert_allclose(
                [float(v) for v in row[1:]], 1e3 * np.array(wanted), atol=5.1e-4
            )
    left_out = found["left-out rows*, calibrated, without outliers"]
    assert float(left_out[3]) == pytest.approx(
        1e3 * c.cross_validation.errors_without_outliers.rms, abs=5.1e-4
    )
    assert block.note.startswith("* leave-one-out: each row predicted from the others alone. Span:")
    assert [block.rows[k][0] for k in block.strong if "left-out" not in block.rows[k][0]] == [
        "estimation rows, calibrated",
        "validation rows, calibrated",
    ]


def test_validation_rows_are_those_of_the_paper_s_table_4(documents, paper_calibration):
    c = paper_calibration
    block = table_of(documents("paper"), "Error of the 5 validation rows")
    assert [row[0] for row in block.rows] == ["31", "32", "33", "34", "35"]
    values = np.array([[float(v) for v in row[1:]] for row in block.rows])
    chosen = c.measurements.validation
    for start, residual in ((0, c.residual_nominal), (4, c.residual_calibrated)):
        wanted = 1e3 * residual[chosen]
        np.testing.assert_allclose(values[:, start : start + 3], wanted, atol=5.1e-4)
        np.testing.assert_allclose(
            values[:, start + 3], np.linalg.norm(wanted, axis=1), atol=5.1e-4
        )
    assert block.groups == (("", 1), ("before: nominal [mm]", 4), ("after: calibrated [mm]", 4))


def test_orientations_have_tables_and_columns_of_their_own(documents, calibrations):
    c = calibrations.made("poses")
    block = table_of(documents("poses"), "Orientation error by set of rows [deg]")
    row = next(row for row in block.rows if row[0] == "validation rows, calibrated")
    wanted = np.degrees(c.errors["calibrated"]["validation"].rms_angle)
    assert float(row[-1]) == pytest.approx(wanted, abs=5.1e-5)
    rows = table_of(documents("poses"), "Error of the 12 validation rows")
    assert rows.groups[-1] == ("angle [deg]", 2)
    first = np.flatnonzero(c.measurements.validation)[0]
    assert float(rows.rows[0][-1]) == pytest.approx(
        np.degrees(np.linalg.norm(c.residual_calibrated[first, 3:])), abs=5.1e-5
    )


def test_lengths_without_coordinates_have_one_column_each(documents, calibrations):
    assert "\nLength error [mm]     " in calibrations.made("distances").summary()
    block = table_of(documents("distances"), "Error of the 10 validation rows")
    assert [span for _, span in block.groups][-2:] == [1, 1]
    assert block.head[-2:] == ("size", "size")
    assert block.note == ""
    errors = table_of(documents("distances"), "Length error by set of rows [mm]")
    assert errors.head == ("rows, robot", "number", "max", "mean", "rms")
    assert errors.note == ""


def test_a_start_that_left_out_rows_do_not_keep_is_said(documents, calibrations):
    said = "Left-out rows, nominal: frame and target are fitted to the others, even if given."
    assert table_of(documents("auto"), "Position error by set of rows").note.endswith(f" {said}")
    c = calibrations.made("auto")
    found = replace(c, setup=replace(c.setup, target_given=np.array([False])))
    assert said not in as_text(report_of(found, figures=False))
    assert said not in as_text(documents("two_joints"))


def test_that_two_rows_of_a_pair_are_one_length_is_said(calibrations):
    c = calibrations.made("distances")
    count = len(c.measurements)
    names = tuple(f"pair {k // 2}" for k in range(count))
    same = {"pairs": names, "distances": np.ones(count)}
    paired = replace(c.measurements, kinds=("pair",) * count, **same)
    said = "The two rows of a pair give one length."
    assert said in accuracy_blocks(replace(c, measurements=paired))[0].text
    assert said not in accuracy_blocks(c)[0].text


def test_parameters_of_kinds_without_errors_have_no_interval(calibrations):
    c = calibrations.made("auto")
    length = [p.name for p in c.model.parameters if p.family == "length"]
    none = replace(c, sizes={**c.sizes, "length": 1e-7})
    rows = {row[0]: row for row in table_of(report_of(none, figures=False), "Lengths").rows}
    assert {row[4:] for name, row in rows.items() if name in length} == {("-", "kept")}
    assert {row[5] for name, row in rows.items() if name not in length} <= {"yes", "jointly"}
    assert "\n# no errors of this kind were found, so it stays as it was\n" in none.summary()
    assert "kept" not in as_text(report_of(c, figures=False))
    own = replace(none, cell=replace(none.cell, parameter_priors={"a2": 1e-4}))
    rows = {row[0]: row for row in table_of(report_of(own, figures=False), "Lengths").rows}
    assert rows["a2"][5] == "yes"


def test_of_many_validation_rows_the_worst_are_listed(calibrations):
    c = calibrations.many_rows(600)
    document = report_of(c, figures=False)
    block = table_of(document, "Error of the 20 of 60 validation rows with the largest error")
    listed = [int(row[0]) for row in block.rows]
    assert listed == sorted(listed)
    size = np.linalg.norm(c.residual_calibrated, axis=1)
    size[~c.measurements.validation] = 0.0
    assert set(listed) == {c.measurements.rows[i] for i in np.argsort(-size)[:20]}


def test_what_is_said_where_nothing_was_kept_back(documents):
    said = [
        b.text
        for b in section(documents("three_rows"), "Accuracy before and after")
        if isinstance(b, Paragraph)
    ]
    assert said[-1].startswith("No rows were kept for validation: what the robot is worth on rows")
    said = [
        b.text
        for b in section(documents("mixed"), "Accuracy before and after")
        if isinstance(b, Paragraph)
    ]
    assert said[-1].endswith("not how accurate the robot is elsewhere.")


def test_parameters_with_correction_and_interval(documents, paper_calibration):
    c = paper_calibration
    rows = {
        row[0]: row
        for title in ("Lengths [mm]", "Angles [deg]")
        for row in table_of(documents("paper"), title).rows
    }
    assert set(rows) == {p.name for p in c.parameters}
    for p in c.parameters:
        scale = 1e3 if p.unit == "m" else np.degrees(1.0)
        _, nominal, value, change, half, known = rows[p.name]
        numbers = [float(v) for v in (nominal, value, change, half)]
        wanted = scale * np.array([p.nominal, p.value, p.delta, 0.5 * (p.high - p.low)])
        np.testing.assert_allclose(numbers, wanted, atol=5.1e-4)
        assert known == ("yes" if p.identifiable else "jointly")
        assert change[0] in "+-" or float(change) == 0.0
    first = section(documents("paper"), "Parameters")[0]
    assert first.text.startswith(
        "27 parameters of the model 'paper' were estimated from 30 estimation rows, 2 of which have no weight."
    )
    assert "half the 95 % interval, 2.00 standard deviations" in first.text


def test_a_target_that_was_not_given_has_no_correction(documents):
    rows = {row[0]: row for row in table_of(documents("distances"), "Lengths [mm]").rows}
    assert rows["target_x"][1] == rows["target_x"][3] == "-"


def test_parameters_of_the_larger_model_have_units(documents):
    block = table_of(documents("larger"), "Larger model 'dh+compliance': in the result file")
    assert len(block.rows) == 6
    assert {row[3] for row in block.rows} == {"urad/Nm"}


@pytest.mark.parametrize(
    "name", ["paper", "poses", "prismatic", "hostile_names", "many_parameters"]
)
def test_the_dh_rows_give_the_poses_of_both_robots(calibrations, documents, name):
    c = calibrations.made(name)
    block = table_of(documents(name), "DH rows before and after")
    assert len(block.rows) == 3 * len(c.nominal.joints)
    names = [row[0] for row in block.rows[::3]]
    assert names == [joint.name for joint in c.nominal.joints]
    values = np.array([[float(v) for v in row[2:]] for row in block.rows])
    before, after, change = values[::3], values[1::3], values[2::3]
    difference = after - before
    angles = [1, 3, 4][: values.shape[1] - 2]
    difference[:, angles] = np.mod(difference[:, angles] + 180.0, 360.0) - 180.0
    np.testing.assert_allclose(change, difference, atol=1.1e-3)
    # Rows of one robot that is hardly changed hardly differ: no axis is turned round.
    assert np.abs(change[:, angles]).max() < 2.0


def test_rows_that_follow_another_convention_than_the_model_say_so(documents, calibrations):
    from calib.model.dh import dh_table
    from calib.model.error_model import error_model
    from calib.show.report_robot import _otherwise

    said = "Where the model has other parameters between such axes, they differ from those above."
    # The model has d between the UR3's parallel axes, where the rows have beta, as Hayati's parameters do.
    assert said in table_of(documents("paper"), "DH rows").note
    c = calibrations.made("paper")
    hayati = replace(c, model=error_model(c.nominal, "hayati"))
    assert not _otherwise(hayati, dh_table(c.nominal))


def test_turned_frames_are_the_same_geometry(calibrations):
    from calib.model.dh import dh_table
    from calib.show.report_robot import _turned_like

    c = calibrations.made("hostile_names")
    before, after = dh_table(c.nominal), dh_table(c.robot)
    turned = _turned_like(before, after)
    assert any(a.theta != b.theta for a, b in zip(after.rows, turned.rows, strict=True))
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (20, len(after.rows)))
    np.testing.assert_allclose(turned.poses(q), after.poses(q), atol=1e-12)


def test_origins_are_displaced_by_what_the_table_says(documents, paper_calibration):
    import pinocchio as pin

    c = paper_calibration
    block = table_of(documents("paper"), "How far each <origin>")
    for joint, *values in block.rows:
        shift, turn = np.split(1e-3 * np.array([float(v) for v in values]), 2)
        T = c.nominal.origins()[joint]
        moved = T @ pin.SE3(pin.exp3(turn), shift).homogeneous
        np.testing.assert_allclose(moved, c.robot.origins()[joint], atol=2e-6)


def test_outliers_with_what_their_weight_did(documents, calibrations):
    blocks = section(documents("paper"), "Outliers")
    assert blocks[0].text.startswith(
        "2 estimation rows are flagged (they have no weight in the fit). Without"
    )
    assert [row[0] for row in blocks[1].rows] == ["11", "14"]
    assert blocks[1].rows[0][1:] == ("estimate", "1.592", "1.988", "17.3", "0.00")
    c = calibrations.made("with_outliers")
    block = table_of(documents("with_outliers"), "Rows flagged")
    assert [int(row[0]) for row in block.rows] == [o.row for o in (*c.outliers, *c.suspects)]
    assert {"estimate", "validate"} == {row[1] for row in block.rows}
    (none,) = section(documents("hostile_names"), "Outliers")
    assert none.text.startswith("None of the 70 rows lies further")


def test_what_is_not_determined_is_named(documents, paper_calibration):
    blocks = section(documents("paper"), "What the measurements do not tell")
    assert blocks[0].text == "Rank: 21 of 27 parameters, condition number 96."
    assert blocks[2].items == tuple(str(u) for u in paper_calibration.observability.unidentifiable)


def test_models_tried_are_a_table(documents, calibrations):
    c = calibrations.made("auto")
    block = table_of(documents("auto"), "Models tried")
    assert [row[0] for row in block.rows] == [one.name for one in c.candidates]
    assert "the URDF" in {row[-1] for row in block.rows}
    weighed = c.candidates[0].cross_validation.errors_without_outliers.n
    assert f"of the {weighed} estimation rows that had a weight" in block.note
    assert "Models tried" not in [s.title for s in documents("paper").sections]


def test_how_it_was_measured(documents):
    facts, ranges = section(documents("paper"), "How it was measured")
    pairs = dict(facts.pairs)
    assert pairs["Rows"] == "35: 30 to estimate, 5 to validate (column 'set')"
    assert pairs["Each row measures"] == "position of the target (35 rows)"
    assert pairs["Measurement frame"] == "known: base"
    assert pairs["Noise of the rows"].startswith("0.102 mm a coordinate")
    assert ranges.rows[2] == (
        "elbow_joint", "deg", "-90.21", "123.63", "-180.00", "180.00", "59 %",
    )  # fmt: skip
    # 420.75 deg is beyond the limit of 360: what lies outside is no share of the range.
    assert ranges.rows[5][3:] == ("420.75", "-360.00", "360.00", "68 %")
    assert ranges.note.endswith(" Measured beyond the limits of the URDF: 'wrist_3_joint'.")
    assert "Measured beyond" not in table_of(documents("poses"), "Joint values").note
    lengths = dict(section(documents("distances"), "How it was measured")[0].pairs)
    assert " mm a length, " in lengths["Noise of the rows"]
    gantry = table_of(documents("prismatic"), "Joint values of the estimation rows")
    assert [row[1] for row in gantry.rows] == ["mm", "mm", "mm", "deg"]
    assert gantry.rows[3][4:] == ("-", "-", "-")
    frames = dict(section(documents("many_parameters"), "How it was measured")[0].pairs)
    assert frames["Measurement frame"] == "estimated from the rows, for 3 of 3 set-ups"
    assert frames["Set-ups"] == "'north', 'south', 'east'"


def test_validation_rows_outside_are_named_once_and_by_their_number(calibrations):
    c = calibrations.made("paper")
    assert "row 34:" in as_text(report_of(c, figures=False)).split("Accuracy")[0]
    assert as_text(report_of(c, figures=False)).count("beyond the measured range") <= 2
    text = as_text(report_of(replace(c, verdict=None), figures=False))
    assert "Validation rows beyond the joint values that were fitted: row 34:" in text


def test_files_have_the_hashes_of_what_is_written(documents, paper_calibration, tmp_path):
    c = paper_calibration
    (facts,) = section(documents("paper"), "Files, versions, command")
    assert isinstance(facts, Facts)
    values = [value for _, value in facts.pairs]
    written = c.write_urdf(tmp_path / "corrected.urdf").read_bytes()
    assert values[1] == c.nominal.urdf.sha256
    assert values[3] == c.measurements.sha256
    assert values[5] == hashlib.sha256(written).hexdigest()
    assert dict(facts.pairs)["Command"] == "calib fit"
    assert dict(facts.pairs)["Software"].startswith("calib ")


def test_nothing_but_the_date_differs_between_two_reports(paper_calibration, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    once = report_bytes(paper_calibration, ".txt")
    assert report_bytes(paper_calibration, ".txt") == once
    assert b"Date of the report  2023-11-14 22:13 UTC" in once
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    later = report_bytes(paper_calibration, ".txt").decode()
    assert once.decode().replace("2023-11-14 22:13", "2027-01-15 08:00") == later
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    assert re.search(rb"\d{4}-\d\d-\d\d \d\d:\d\d UTC", report_bytes(paper_calibration, ".txt"))


def test_the_name_s_ending_says_how_it_is_set(paper_calibration, tmp_path):
    assert paper_calibration.write_report(tmp_path / "r.md").read_text().startswith("# Calibration")
    text = write_report(paper_calibration, tmp_path / "r.TXT", command="calib fit").read_text()
    assert text.startswith("Calibration report: robot ur3\n====")
    with pytest.raises(FileError) as raised:
        paper_calibration.write_report(tmp_path / "r.md")
    assert "exists already; add --force" in str(raised.value)
    paper_calibration.write_report(tmp_path / "r.md", overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.TXT", "r.md"]


@pytest.mark.parametrize("name", ["report.pdf", "report", "report.docx"])
def test_another_ending_is_refused(paper_calibration, tmp_path, name):
    with pytest.raises(FileError) as raised:
        write_report(paper_calibration, tmp_path / name)
    assert str(raised.value) == (
        f"'{tmp_path / name}': a report is a page, Markdown or text; let the name end in one of "
        "'.html', '.htm', '.md', '.txt'."
    )
    assert list(tmp_path.iterdir()) == []
    assert ENDINGS == (".html", ".htm", ".md", ".txt")


def test_figures_stand_where_they_belong(paper_calibration):
    from calib.show.document import Picture
    from calib.show.figures import drawings

    document = report_of(paper_calibration)
    named = {
        s.title: [b.drawing.name for b in s.blocks if isinstance(b, Picture)]
        for s in document.sections
    }
    assert sorted(n for names in named.values() for n in names) == sorted(
        drawing.name for drawing in drawings(paper_calibration)
    )
    assert named["Figures of the errors"][0] == "points"
    assert named["Parameters"] == ["parameter-changes", "correlations"]
    assert named["How it was computed"] == ["convergence"]
