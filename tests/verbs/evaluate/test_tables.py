"""The tables of an evaluation's report: every figure is that of the JSON file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.channels import RESIDUAL_UNITS
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from calib.show.as_text import blocks_text
from calib.show.blocks import TERMINAL
from calib.show.lines import mm
from calib.show.tables import format_cells
from calib.show.words import shown
from calib.verbs.evaluate.acceptance import Assessment
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.evaluate.evaluation_file import assessment_table
from calib.verbs.evaluate.tables import accuracies, characteristics, missing, poses
from tests.verbs.evaluate.evaluations import made, page_of


@pytest.fixture(scope="module")
def assessment(ur3: Robot) -> Assessment:
    return made(ur3)


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
    _, *rows = page.table("Further figures")
    found = [c for c in accuracy["characteristics"] if c["count"]]
    assert [c["symbol"] for c in found] == ["AD", "RD"]
    for row, c in zip(rows, found, strict=True):
        assert row[0].startswith(f"{c['symbol']} ")
        assert row[2:] == [shown(c["largest"], c["unit"]), shown(c["mean"], c["unit"])]
    _, *poses = page.table("Poses, the worst first")
    assert sorted(row[2] for row in poses) == sorted(
        shown(p["m"]["ap"], "m") for p in accuracy["poses"]
    )
    _, _, robot, row = page.table("Position error [mm]")
    assert robot == ["the URDF as it is:"]
    errors = table["errors"]["urdf"]["all"]["m"]
    assert row[1:5] == ["30", *(shown(errors[key], "m") for key in ("max", "mean", "rms"))]


def test_a_figure_that_fails_is_compared_without_its_uncertainty(ur3: Robot):
    e = made(ur3, 2e-3)
    check, page = e.accepted.checks["m"], page_of(e)
    values = (check.figure, check.uncertainty, check.figure - check.uncertainty, check.tolerance)
    _, row, *_ = page.table("Pose accuracy and repeatability")
    assert row[1:] == [*(shown(v, "m") for v in values), "fail"]
    _, row, _ = page.table("Comparison with the tolerance")
    assert row[4] == shown(check.figure - check.uncertainty, "m")


KNOWN = Cell(target=(0.0, 0.0, 0.0), estimate_target=False)


@pytest.fixture(scope="module")
def repeated(ur3: Robot) -> Assessment:
    """Twelve poses, each three times in turn, one worse than the other."""
    q = np.tile(random_joint_values(ur3, 12, 3), (3, 1))
    points = ur3.poses(q)[:, :3, 3]
    points[:, 0] += np.tile(1e-4 * np.arange(1, 13), 3) + np.repeat([0.0, 1e-5, -1e-5], 12)
    return Assessment.of_one(evaluate(ur3, Measurements(ur3.joint_names, q, points), KNOWN))


def test_cells_are_the_figures(repeated: Assessment):
    (table,) = accuracies(repeated.accuracies, "urdf", TERMINAL)
    _, ((name, *cells),) = format_cells(table.columns, table.rows)
    assert name == "URDF as it is"
    assert cells == ["12", *(mm(v) for v in repeated.accuracies["urdf"].figures("m").values())]
    assert all(cell in blocks_text([table]) for cell in cells)


def test_characteristics_are_listed_and_the_others_say_what_they_need(repeated: Assessment):
    found = repeated.characteristics["urdf"]
    table = characteristics(found, "URDF as it is", TERMINAL)
    assert [row[0].split()[0] for row in table.rows] == ["AD", "RD"]
    for row, characteristic in zip(table.rows, found, strict=False):
        assert row[1:] == ("66 pairs", mm(characteristic.largest), mm(characteristic.mean))
    text = blocks_text([table])
    assert f"{mm(found[0].largest):>11}{mm(found[0].mean):>11}" in text
    vap, drifts = missing(found)
    assert vap.startswith("vAP n/a: needs two approaches")
    assert drifts == "dAP, dRP n/a: needs 20 repeats of a pose"
    assert max(map(len, text.splitlines())) <= 100


def test_poses_are_listed_from_the_worst_on_without_a_tolerance_too(repeated: Assessment):
    table = poses(repeated, "the URDF")
    assert TERMINAL not in table.on
    columns, rows = format_cells(table.columns, table.rows)
    assert [row[0] for row in rows[:2]] == ["rows 12, 24, 36", "rows 11, 23, 35"]
    assert len(rows) == 12
    heads = ["rows", "repeats", "AP [mm]", "x", "y", "z", "RP", "single"]
    assert [column.head for column in columns] == heads
    assert rows[0][1:3] == ["3", "1.200"]
    lines = blocks_text([table]).splitlines()
    assert len(lines) == 2 + 10 + 1
    assert lines[2].split()[-7:] == rows[0][1:]


def test_poses_beyond_their_uncertainty_are_marked(assessment: Assessment):
    known = assessment.accuracies["urdf"]
    middle = float(np.median(known.of("ap", "m")))
    marked = [
        replace(pose, by_unit={**pose.by_unit, "m": replace(pose["m"], U=middle)})
        for pose in known.poses
    ]
    found = replace(known, poses=tuple(marked), known={"m": 30}, beyond={"m": ()})
    table = poses(replace(assessment, accuracies={"urdf": found}), "the URDF")
    columns, rows = format_cells(table.columns, table.rows)
    heads = [column.head for column in columns]
    assert heads[2:5] == ["AP [mm]", "U", ""]
    assert [row[4] for row in rows] == ["> U"] * 3 + [""] * 3
    assert {row[3] for row in rows} == {mm(middle)}
    # Without U the table has neither column.
    table = poses(assessment, "the URDF")
    assert "U" not in [column.head for column in format_cells(table.columns, table.rows)[0]]
