"""The first page: the record's entries on their lines, outcomes as large as any, and reasons while there is room."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.data.record import TEXTS, Record
from calib.diagnosis.reasons import CARE, NO, USE
from calib.robot.robot import Robot
from calib.show.first_page import FirstPage, Outcome, left_lines, right_lines
from calib.show.table import Table
from calib.verbs.evaluate.acceptance import OUTCOMES
from tests.show.pages import FULL_RECORD


@pytest.fixture
def first(ur3: Robot) -> FirstPage:
    return FirstPage(
        robot="ur3",
        outcome=Outcome.of("pass"),
        reasons=[f"Reason {k}." for k in range(30)],
        section="Outcome",
        left=left_lines(Record(), ur3),
        right=right_lines(Record(), ("Uncertainty (k = 2)", ""), ""),
        note="",
        table=Table("", ("a",), [("1",)] * 3, "l"),
        rule=(),
        parties=("Tested by", "Accepted by"),
    )


def test_every_entry_of_a_record_has_its_line(ur3: Robot):
    record = Record(**{name: f"the {name}" for name in TEXTS}, temperature_C=(20.0, 21.25))
    values = [value for _, value in left_lines(record, ur3)]
    values += [value for _, value in right_lines(record, ("U", "0.05 mm"), "data.csv")]
    for name in TEXTS:
        assert (f"the {name}" in values) == (name != "note")
    assert {"20.0 to 21.2", "0.05 mm", "data.csv"} <= {*values}
    assert len(left_lines(record, ur3)) == len(right_lines(record, ("U", ""), ""))


def test_every_outcome_and_verdict_has_a_sign_of_its_own():
    good, care, bad = (
        {Outcome.of(word).sign for word in words}
        for words in zip(OUTCOMES, (USE, CARE, NO), strict=True)
    )
    assert (len(good), len(care), len(bad), len(good | care | bad)) == (1, 1, 1, 3)
    assert Outcome.of("do not use").text == "Verdict: do not use"
    assert Outcome.of("fail").shade == Outcome.of("do not use").shade == "bad"


def test_reasons_are_listed_while_there_is_room(first: FirstPage, ur3: Robot):
    listed = first.listed
    assert listed[-1] == "18 more statements: see section 'Outcome'."
    assert listed[:-1] == [f"Reason {k}." for k in range(12)]
    assert replace(first, reasons=["Only one."]).listed == ["Only one."]
    # Two lines of a reason, a row of the table, a line of the note and one of an entry take a line each.
    assert len(replace(first, reasons=["word " * 30] * 30).listed) == 6 + 1
    assert len(replace(first, note="a note").listed) == len(listed) - 1
    longer = right_lines(Record(place="x" * 29), ("U", ""), "")
    assert len(replace(first, right=longer).listed) == len(listed) - 1
    full = replace(
        first,
        left=left_lines(FULL_RECORD, ur3),
        right=right_lines(FULL_RECORD, ("U", ""), ""),
        note=FULL_RECORD.note,
    )
    assert full.listed == ["30 more statements: see section 'Outcome'."]


def test_long_reasons_are_shortened(first: FirstPage):
    (shown,) = replace(first, reasons=["word " * 100]).listed
    assert shown.endswith("word ...")
    assert len(shown) <= 200
    (shown,) = replace(first, reasons=["x" * 500]).listed
    assert shown == "x" * 196 + " ..."
