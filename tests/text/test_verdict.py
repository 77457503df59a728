"""Every code of the verdict has a sentence, with every number that it names."""

from __future__ import annotations

from string import Formatter

import pytest

from calib.diagnosis.coverage import Beyond, OutsideRow
from calib.diagnosis.reasons import CARE, NO, USE, Reason, Verdict, Why
from calib.text.verdict import SENTENCES, against, outside_text, reason_text, refusal


@pytest.mark.parametrize("why", Why)
def test_every_code_has_a_sentence(why):
    made = {"before", "after", "change", "chance_p", "measured", "beyond", "outliers_aside"}
    made |= {"named", "ranges", "better", "falls_by"}
    names = {one[1].split(":")[0] for one in Formatter().parse(SENTENCES[why]) if one[1]}
    values = dict.fromkeys(names - made - {"rows_aside"}, 0.5)
    more = {"before_m": 2e-3, "after_m": 1e-3, "p": 1e-9, "by_rad": 0.3, "poses": 3}
    text = reason_text(Reason(why, more | values))
    assert text.endswith((".", "?"))
    assert "{" not in text


def test_orientations_are_told_beside_positions():
    values = {"before_m": 2e-3, "after_m": 1e-3, "before_rad": 0.1, "after_rad": 0.01}
    gain = Reason(Why.GAIN, values | {"method": "leave-one-out", "outliers": 2})
    assert reason_text(gain) == (
        "On held-out rows (leave-one-out, outliers excluded) the error falls from 2.000 mm and 5.730 deg to 1.000 "
        "mm and 0.573 deg rms."
    )


def test_rows_outside():
    rows = [OutsideRow(i, (Beyond("a", False, 0.1), Beyond("b", True, 0.3))) for i in range(5)]
    assert (
        outside_text(rows[:1], [7]) == "row 7: 'a' 5.73 deg, 'b' 300 mm beyond the measured range"
    )
    assert outside_text(rows, range(5)).endswith("; and 2 more rows")


def test_only_do_not_use_speaks_against_a_result():
    reasons = (Reason.of(Why.PARAMETER_FAR, largest=0.2), Reason.of(Why.NO_LENGTH))
    assert [against(Verdict(use, reasons)) for use in (USE, CARE)] == ["", ""]
    assert against(None) == ""
    assert against(Verdict(NO, ())) == "do not use"
    said = against(Verdict(NO, reasons))
    assert said == f"do not use (parameter_far): {reason_text(reasons[0])}"
    assert said in refusal("'c.urdf'", said)


@pytest.mark.parametrize(
    ("rows", "words"), [(1, "1 validation row lies"), (2, "2 validation rows lie")]
)
def test_one_row_is_no_rows(rows, words):
    reason = Reason.of(Why.OUTSIDE, rows=rows, row=47, joint="elbow", by_rad=0.1)
    assert reason_text(reason).startswith(words)
