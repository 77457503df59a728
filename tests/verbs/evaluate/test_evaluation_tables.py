"""The tables of an evaluation's report: every figure is that of the JSON file."""

from __future__ import annotations

import pytest

from calib.basics.channels import RESIDUAL_UNITS
from calib.robot.robot import Robot
from calib.show.sizes import shown
from calib.verbs.evaluate.acceptance import Assessment
from calib.verbs.evaluate.evaluation_file import assessment_table
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


def test_a_figure_that_fails_is_compared_without_its_uncertainty(ur3: Robot):
    e = made(ur3, 2e-3)
    check, page = e.accepted.checks["m"], page_of(e)
    values = (check.figure, check.uncertainty, check.figure - check.uncertainty, check.tolerance)
    _, row, *_ = page.table("Pose accuracy and repeatability")
    assert row[1:] == [*(shown(v, "m") for v in values), "fail"]
    _, row, _ = page.table("Comparison with the tolerance")
    assert row[4] == shown(check.figure - check.uncertainty, "m")
