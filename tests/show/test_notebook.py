"""Results as tables for notebooks: well-formed, with the verdict in words, and nothing unescaped."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from calib.data.cell import Cell
from calib.result.calibration import Calibration
from calib.show.short import rms_text
from calib.show.verdict import reason_text
from calib.verbs.compare.comparison import compare
from calib.verbs.compare.text import sentence
from calib.verbs.evaluate.evaluation import evaluate
from calib.verbs.plan.choice import PlanRequest
from calib.verbs.plan.plan import plan
from tests.parts import with_part


def cells(shown: object) -> dict[str, str]:
    """The rows of a table: label and text."""
    table = ElementTree.fromstring(shown._repr_html_())
    assert table.tag == "table"
    return {row[0].text: row[1].text or "" for row in table.iter("tr")}


def test_a_calibration(default_result: Calibration):
    c = default_result
    shown = cells(c)
    assert shown["verdict"] == c.verdict.use
    assert shown["first reason"] == reason_text(c.verdict.reasons[0])
    validated = c.cross_validation.errors_without_outliers
    assert shown["rms error, calibrated (held-out rows)"] == rms_text(validated)
    assert cells(with_part(c, "geometry", verdict=None))["verdict"] == "none"


def test_a_calibration_with_a_non_geometric_model(calibrated):
    _, c = calibrated("compliance")
    assert f"rms error, model '{c.non_geometric.name}' (held-out rows)" in cells(c)


def test_an_evaluation(ur3, table):
    made = evaluate(ur3, table, Cell())
    shown = cells(made)
    assert shown["rms error, all rows"] == rms_text(made.errors["all"])
    assert shown["registered to the rows"] == "target"


def test_a_comparison(default_result: Calibration):
    made = compare(default_result, default_result)
    assert cells(made)["answer"] == sentence(made)


def test_a_plan(ur3):
    made = plan(ur3, Cell(model="dh"), PlanRequest(20, 3, candidates=300), collisions=None)
    assert cells(made)["poses"] == "20, and 3 for validation"


@pytest.mark.parametrize("name", ["<script>alert(1)</script>", "a & b"])
def test_names_are_escaped(default_result: Calibration, name: str):
    robot = replace(default_result.nominal, urdf=replace(default_result.nominal.urdf, name=name))
    html = replace(default_result, nominal=robot)._repr_html_()
    assert name not in html
    assert name in ElementTree.fromstring(html)[0].text
