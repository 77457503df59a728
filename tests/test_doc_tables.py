"""Tables in the docs are what calib declares: keys of the fields, one for each record, and columns of errors."""

from __future__ import annotations

import importlib.util

import pytest

from calib.basics.records import keys_of
from calib.data.cell import FILE_KEYS, Cell
from tests.places import ROOT

SCRIPT = ROOT / "scripts" / "update_doc_tables.py"
SPEC = importlib.util.spec_from_file_location("update_doc_tables", SCRIPT)
update_doc_tables = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(update_doc_tables)


@pytest.mark.parametrize(
    ("page", "table"),
    [
        ("cell.md", "keys of calib."),
        ("simulation.md", "keys of calib."),
        ("report.md", "columns of errors"),
    ],
)
def test_the_tables_of_a_page_are_current(page: str, table: str):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert f"<!-- {table}" in text
    assert update_doc_tables.with_tables(text) == text, "run scripts/update_doc_tables.py"


def test_a_table_has_every_key_once():
    names = [row.name for row in (*FILE_KEYS, *(row for _, row in keys_of(Cell))) if row.help]
    table = update_doc_tables.table(Cell).splitlines()[2:]
    assert [line.split("`")[1] for line in table] == names
    assert len(set(names)) == len(names)


def test_defaults_are_those_of_the_fields():
    defaults = {
        line.split("`")[1]: line.split(" | ")[2]
        for line in update_doc_tables.table(Cell).splitlines()[2:]
    }
    cell = Cell()
    assert defaults["model"] == f'`"{cell.model}"`'
    assert defaults["repeats"] == f'`"{cell.repeats}"`'
    assert [
        float(number) for number in defaults["gravity_m_per_s2"].split(",")
    ] == cell.gravity.tolist()
    assert float(defaults["prior_length_mm"]) == pytest.approx(1e3 * cell.priors.of("length"))
    assert float(defaults["prior_compliance_rad_per_Nm"]) == cell.priors.of("compliance")


def test_the_list_for_assistants_has_every_page():
    text = (ROOT / "docs" / "llms.txt").read_text(encoding="utf-8")
    assert text == update_doc_tables.list_of_pages(), "run scripts/update_doc_tables.py"
    for page in (ROOT / "docs").glob("*.md"):
        assert f"]({page.name}): " in text, page.name
