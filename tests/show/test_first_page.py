"""The first page: the record's entries on their lines, verdicts as large as any, and reasons while there is room."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.data.record import FOR_CERTIFICATES, TEXTS, Record
from calib.diagnosis.reasons import CARE, NO, USE
from calib.robot.robot import Robot
from calib.show.blocks import Verdict
from calib.show.first_page import FirstPage
from calib.show.tables import Table, name_column
from calib.verbs.evaluate.acceptance import OUTCOMES
from tests.show.pages import FULL_RECORD


@pytest.fixture
def first(ur3: Robot) -> FirstPage:
    return FirstPage(
        verdict=Verdict("pass", [f"Reason {k}." for k in range(30)]),
        section="Outcome",
        record=Record(),
        robot=ur3,
        uncertainty=("Uncertainty (k = 2)", ""),
        source="",
        table=Table("", [name_column("a")], [("1",)] * 3),
        rule=(),
        parties=("Tested by", "Accepted by"),
    )


def with_reasons(first: FirstPage, *reasons: str) -> FirstPage:
    return replace(first, verdict=Verdict("pass", reasons))


def test_every_entry_of_a_record_has_its_line(first: FirstPage):
    texts = [name for name in TEXTS if name not in FOR_CERTIFICATES]
    record = Record(**{name: f"the {name}" for name in texts}, temperature_C=(20.0, 21.25))
    filled = replace(first, record=record, uncertainty=("U", "0.05 mm"), source="data.csv")
    values = [value for _, value in (*filled.left, *filled.right)]
    for name in texts:
        assert (f"the {name}" in values) == (name != "note")
    assert {"20.0 to 21.2", "0.05 mm", "data.csv"} <= {*values}
    assert len(first.left) == len(first.right)


def test_a_form_of_its_own_takes_the_place_of_the_reports(first: FirstPage):
    lines = [(f"line {k}", "") for k in range(12)]
    other = replace(first, form=(lines, lines))
    assert other.left == other.right == lines
    # Three lines more than a report's form leave room for three reasons less.
    assert len(other.listed) == len(first.listed) - 3


def test_every_outcome_and_verdict_has_a_sign_of_its_own():
    good, care, bad = (
        {Verdict(word, ()).sign for word in words}
        for words in zip(OUTCOMES, (USE, CARE, NO), strict=True)
    )
    assert (len(good), len(care), len(bad), len(good | care | bad)) == (1, 1, 1, 3)
    assert Verdict("do not use", ()).text == "Verdict: do not use"
    assert Verdict("fail", ()).shade == Verdict("do not use", ()).shade == "bad"


def test_reasons_are_listed_while_there_is_room(first: FirstPage):
    listed = first.listed
    assert listed[-1] == "18 more statements: see section 'Outcome'."
    assert listed[:-1] == [f"Reason {k}." for k in range(12)]
    assert with_reasons(first, "Only one.").listed == ["Only one."]
    # Two lines of a reason, a row of the table, a line of the note and one of an entry take a line each.
    assert len(with_reasons(first, *["word " * 30] * 30).listed) == 6 + 1
    assert len(replace(first, record=Record(note="a note")).listed) == len(listed) - 1
    assert len(replace(first, record=Record(place="x" * 29)).listed) == len(listed) - 1
    full = replace(first, record=FULL_RECORD)
    assert full.listed == ["30 more statements: see section 'Outcome'."]


def test_long_reasons_are_shortened(first: FirstPage):
    (shown,) = with_reasons(first, "word " * 100).listed
    assert shown.endswith("word ...")
    assert len(shown) <= 200
    (shown,) = with_reasons(first, "x" * 500).listed
    assert shown == "x" * 196 + " ..."
