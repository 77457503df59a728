"""The tables of a report hold the figures of the result, in the units that their heads state."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import calib.verbs.calibrate.tables as tables
from calib.show.blocks import HTML
from calib.show.tables import Table, format_cells
from calib.verbs.calibrate.report import report

#: Columns of numbers without a unit.
PLAIN = {"rows", "score", "weight", "used [%]", "d.o.f.", "share [%]"}


def every_table(c):
    """All the tables of a report."""
    blocks = [block for _, blocks in report(c).drawn_on(HTML) for block in blocks]
    return [block for block in blocks if isinstance(block, Table) and block.rows]


def texts(table) -> list[list[str]]:
    """The cells of a table as a page has them."""
    _, rows = format_cells(table.columns, table.rows)
    return rows


def errors_of(c, unit: str) -> Table:
    """The report's table of errors in one unit."""
    return next(t for t in every_table(c) if "error [" in t.title and t.columns[2].unit == unit)


def numbers(cells) -> np.ndarray:
    """The cells as numbers."""
    return np.array([float(cell) for cell in cells])


@pytest.mark.parametrize(
    "name",
    [
        "paper",
        "hostile_names",
        "distances",
        pytest.param("poses", marks=pytest.mark.slow),
        pytest.param("one_row", marks=pytest.mark.slow),
        pytest.param("with_outliers", marks=pytest.mark.slow),
        pytest.param("non_geometric", marks=pytest.mark.slow),
        pytest.param("mixed", marks=pytest.mark.slow),
    ],
)
def test_every_column_of_numbers_has_a_unit_or_is_a_count(calibrations, name):
    for table in every_table(calibrations.made(name)):
        if {"unit", "error of"} & {column.head for column in table.columns}:
            continue  # each row has a unit of its own
        for column in table.columns:
            if column.unit:
                assert f"[{column.unit}]" in f"{table.title} {column.group} {column.head}"
            else:
                assert column.left or column.head in PLAIN


def test_errors_by_set_are_those_of_the_result(paper_calibration):
    c = paper_calibration
    table = errors_of(c, "mm")
    rows = {row[0]: row[1:] for row in texts(table)}
    for robot in ("nominal", "calibrated"):
        for name in ("estimation", "validation"):
            e = c.errors[robot][name]["m"]
            expected = 1e3 * np.array([e.max, e.mean, e.rms, *e.span_axis])
            count, *values = rows[f"{name} rows, {robot}"]
            assert int(count) == e.n
            np.testing.assert_allclose(numbers(values), expected, atol=5.1e-4)
    held_out = rows["held-out rows*, calibrated, without outliers"]
    rms = 1e3 * c.cross_validation.errors_without_outliers["m"].rms
    assert float(held_out[3]) == pytest.approx(rms, abs=5.1e-4)
    assert table.note == "* leave-one-out: each row predicted from the others alone."
    assert {texts(table)[k][0].split(",")[1] for k in table.strong} == {" calibrated"}


def test_validation_rows_are_those_of_the_paper_s_table_4(paper_calibration):
    c = paper_calibration
    table = tables.validation_rows(c)
    assert [row[0] for row in texts(table)] == ["31", "32", "33", "34", "35"]
    values = np.array([numbers(row[1:]) for row in texts(table)])
    for start, residual in ((0, c.rows.residual_nominal), (4, c.rows.residual_calibrated)):
        expected = 1e3 * residual[c.fit.measurements.validation]
        norms = np.linalg.norm(expected, axis=1)
        np.testing.assert_allclose(values[:, start : start + 3], expected, atol=5.1e-4)
        np.testing.assert_allclose(values[:, start + 3], norms, atol=5.1e-4)
    groups = [column.group for column in table.columns]
    assert groups == ["", *["before: nominal [mm]"] * 4, *["after: calibrated [mm]"] * 4]


def test_of_many_validation_rows_the_worst_are_listed(paper_calibration, monkeypatch):
    c = paper_calibration
    monkeypatch.setattr(tables, "MOST_LISTED", 4)
    monkeypatch.setattr(tables, "MOST_WORST", 2)
    rows = np.array(c.fit.measurements.rows)[c.fit.measurements.validation]
    norms = np.linalg.norm(c.rows.residual_calibrated[c.fit.measurements.validation], axis=1)
    worst = sorted(rows[np.argsort(-norms)[:2]])
    assert [int(row[0]) for row in tables.validation_rows(c).rows] == worst


def test_parameters_with_correction_and_interval(paper_calibration):
    c = paper_calibration
    rows = {row[0]: row for unit in ("mm", "deg") for row in texts(tables.parameters_in(c, unit))}
    assert set(rows) == {p.name for p in c.parameters}
    for p in c.parameters:
        scale = 1e3 if p.unit == "m" else np.degrees(1.0)
        _, *values, determined = rows[p.name]
        expected = scale * np.array([p.nominal, p.value, p.delta, 0.5 * (p.high - p.low)])
        np.testing.assert_allclose(numbers(values), expected, atol=5.1e-4)
        assert determined == ("yes" if p.identifiable else "jointly")
        assert values[2][0] in "+-" or float(values[2]) == 0.0


@pytest.mark.parametrize(
    "name", ["paper", "hostile_names", pytest.param("prismatic", marks=pytest.mark.slow)]
)
def test_the_dh_rows_and_their_change(calibrations, name):
    c = calibrations.made(name)
    table = tables.dh(c)
    assert [row[0] for row in table.rows[::3]] == [joint.name for joint in c.nominal.joints]
    values = np.array([numbers(row[2:]) for row in texts(table)])
    before, after, change = values[::3], values[1::3], values[2::3]
    difference = after - before
    angles = [1, 3, 4][: values.shape[1] - 2]
    difference[:, angles] = np.mod(difference[:, angles] + 180.0, 360.0) - 180.0
    np.testing.assert_allclose(change, difference, atol=1.1e-3)
    # Rows of one robot that is hardly changed hardly differ: no axis is turned round.
    assert np.abs(change[:, angles]).max() < 2.0


def test_origins_are_displaced_by_the_values_of_the_table(paper_calibration):
    c = paper_calibration
    for joint, *values in texts(tables.origins(c)):
        shift, turn = np.split(1e-3 * numbers(values), 2)
        moved = c.nominal.origins()[joint] @ pin.SE3(pin.exp3(turn), shift).homogeneous
        np.testing.assert_allclose(moved, c.robot.origins()[joint], atol=2e-6)


def test_flagged_rows(calibrations):
    rows = texts(tables.flagged(calibrations.made("paper")))
    assert rows == [
        ["11", "estimate", "1.592", "1.988", "17.3", "0.00"],
        ["14", "estimate", *rows[1][2:]],
    ]


def test_joint_ranges_are_those_of_the_estimation_rows(paper_calibration):
    c = paper_calibration
    q = np.degrees(c.fit.measurements.joints[c.fit.measurements.estimation])
    for joint, values, row in zip(c.nominal.inputs, q.T, texts(tables.ranges(c)), strict=True):
        assert row[:2] == [joint.name, "deg"]
        ends = [values.min(), values.max(), np.degrees(joint.lower), np.degrees(joint.upper)]
        np.testing.assert_allclose(numbers(row[2:6]), ends, atol=5.1e-3)
        # The first joint was measured beyond its limit.
        inside = np.clip(values, ends[2], ends[3])
        share = 100.0 * np.ptp(inside) / (ends[3] - ends[2])
        assert float(row[6]) == pytest.approx(share, abs=0.5)
