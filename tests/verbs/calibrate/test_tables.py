"""The tables of a report hold the figures of the result, in the units that their heads state."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

import calib.verbs.calibrate.tables as tables

#: A unit or a name of a count: one is in the head of every column of numbers, its group or the table's title.
UNITS = re.compile(r"\[(mm|deg|mrad)\]|number|score|weight|evidence|parameters|held-out rms|used")


def every_table(c):
    """All the tables of a report."""
    makers = (
        tables.validation_rows,
        tables.non_geometric,
        tables.dh,
        tables.origins,
        tables.flagged,
        tables.ranges,
    )
    made = [make(c) for make in makers]
    made += [tables.parameters(c, unit) for unit in ("mm", "deg")]
    made += [tables.errors(c, unit) for unit in c.rows.channels.present]
    return made


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
        width = len(table.head)
        assert {width, *map(len, table.rows)} == {len(table.align)}
        groups = [""] * width
        if table.groups:
            groups = [label for label, span in table.groups for _ in range(span)]
        for head, group, side in zip(table.head, groups, table.align, strict=True):
            if side == "r" and "unit" not in table.head:
                assert UNITS.search(f"{table.title.split(';')[0]} {group} {head}")


def test_errors_by_set_are_those_of_the_result(paper_calibration):
    c = paper_calibration
    table = tables.errors(c, "m")
    rows = {row[0]: row[1:] for row in table.rows}
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
    assert table.note.startswith("* leave-one-out: each row predicted from the others alone. Span:")
    assert {table.rows[k][0].split(",")[1] for k in table.strong} == {" calibrated"}


def test_validation_rows_are_those_of_the_paper_s_table_4(paper_calibration):
    c = paper_calibration
    table = tables.validation_rows(c)
    assert [row[0] for row in table.rows] == ["31", "32", "33", "34", "35"]
    values = np.array([numbers(row[1:]) for row in table.rows])
    for start, residual in ((0, c.rows.residual_nominal), (4, c.rows.residual_calibrated)):
        expected = 1e3 * residual[c.fit.measurements.validation]
        norms = np.linalg.norm(expected, axis=1)
        np.testing.assert_allclose(values[:, start : start + 3], expected, atol=5.1e-4)
        np.testing.assert_allclose(values[:, start + 3], norms, atol=5.1e-4)
    assert table.groups == [("", 1), ("before: nominal [mm]", 4), ("after: calibrated [mm]", 4)]


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
    rows = {row[0]: row for unit in ("mm", "deg") for row in tables.parameters(c, unit).rows}
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
    values = np.array([numbers(row[2:]) for row in table.rows])
    before, after, change = values[::3], values[1::3], values[2::3]
    difference = after - before
    angles = [1, 3, 4][: values.shape[1] - 2]
    difference[:, angles] = np.mod(difference[:, angles] + 180.0, 360.0) - 180.0
    np.testing.assert_allclose(change, difference, atol=1.1e-3)
    # Rows of one robot that is hardly changed hardly differ: no axis is turned round.
    assert np.abs(change[:, angles]).max() < 2.0


def test_origins_are_displaced_by_the_values_of_the_table(paper_calibration):
    c = paper_calibration
    for joint, *values in tables.origins(c).rows:
        shift, turn = np.split(1e-3 * numbers(values), 2)
        moved = c.nominal.origins()[joint] @ pin.SE3(pin.exp3(turn), shift).homogeneous
        np.testing.assert_allclose(moved, c.robot.origins()[joint], atol=2e-6)


def test_flagged_rows(calibrations):
    rows = tables.flagged(calibrations.made("paper")).rows
    assert [list(row) for row in rows] == [
        ["11", "estimate", "1.592", "1.988", "17.3", "0.00"],
        ["14", "estimate", *rows[1][2:]],
    ]


def test_joint_ranges_are_those_of_the_estimation_rows(paper_calibration):
    c = paper_calibration
    q = np.degrees(c.fit.measurements.joints[c.fit.measurements.estimation])
    for joint, values, row in zip(c.nominal.inputs, q.T, tables.ranges(c).rows, strict=True):
        assert row[:2] == (joint.name, "deg")
        ends = [values.min(), values.max(), np.degrees(joint.lower), np.degrees(joint.upper)]
        np.testing.assert_allclose(numbers(row[2:6]), ends, atol=5.1e-3)
        # The first joint was measured beyond its limit.
        inside = np.clip(values, ends[2], ends[3])
        share = 100.0 * np.ptp(inside) / (ends[3] - ends[2])
        assert float(row[6]) == pytest.approx(share, abs=0.5)
