"""Results in notebooks: well-formed, with the verdict in words and tables of errors, and nothing unescaped."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from calib.data.cell import Cell
from calib.result.calibration import Calibration
from calib.show.lines import mm
from calib.show.verdict import reason_text
from calib.show.words import rms_text
from calib.verbs.compare.comparison import compare
from calib.verbs.compare.text import sentence
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import plan
from tests.parts import with_part
from tests.show.pages import Page


def excerpt(value: object) -> Page:
    """What a notebook shows of a value; it is XML too."""
    html = value._repr_html_()
    assert ElementTree.fromstring(html).tag == "div"
    return Page(html)


def test_a_calibration(default_result: Calibration):
    c = default_result
    page = excerpt(c)
    assert page.text.startswith("Calibration of 'ur3', base to tool0")
    assert f"Verdict: {c.verdict.use} {reason_text(c.verdict.reasons[0])}" in page.text
    assert reason_text(c.verdict.reasons[1]) not in page.text
    validated = c.cross_validation.errors_without_outliers["m"]
    _, _, *rows = page.table("Size of the error by set of rows")
    assert rows[2][1:3] == ["held-out, without outliers", str(validated.n)]
    assert rows[2][6:] == [mm(validated.max), mm(validated.mean), mm(validated.rms)]
    assert page.forms["rows"] == "35, 2 of them outliers"
    assert "Verdict: none" in excerpt(with_part(c, "geometry", verdict=None)).text


def test_a_calibration_with_a_non_geometric_model(calibrated):
    _, c = calibrated("compliance")
    errors = c.non_geometric.cross_validation.errors_without_outliers
    label = f"rms error, model '{c.non_geometric.name}' (held-out rows)"
    assert excerpt(c).forms[label] == rms_text(errors)


def test_an_evaluation(ur3, table):
    made = evaluate(ur3, table, Cell())
    page = excerpt(made)
    errors = made.errors["all"]["m"]
    (row,) = [row for row in page.table("Position error") if row[0] == "all rows"]
    assert row[1:5] == [str(errors.n), mm(errors.max), mm(errors.mean), mm(errors.rms)]
    assert page.forms["registered to the rows"] == "target"


def test_a_comparison(default_result: Calibration):
    made = compare(default_result, default_result)
    assert excerpt(made).forms["answer"] == sentence(made)


def test_a_plan(ur3):
    made = plan(ur3, Cell(model="dh"), PlanRequest(20, 3, candidates=300), collisions=None)
    assert excerpt(made).forms["poses"] == "20, and 3 for validation"


@pytest.mark.parametrize("name", ["<script>alert(1)</script>", "a & b"])
def test_names_are_escaped(default_result: Calibration, name: str):
    robot = replace(default_result.nominal, urdf=replace(default_result.nominal.urdf, name=name))
    value = replace(default_result, nominal=robot)
    assert name not in value._repr_html_()
    assert name in excerpt(value).text
