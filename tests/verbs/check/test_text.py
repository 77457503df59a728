"""Words of causes by what the result is of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.verbs.check.check import CheckResult, Finding, check
from calib.verbs.check.text import answer, check_text
from tests.verbs.check.shop import paper_result, points


def of(code: str, name: str = "", **changes: object) -> CheckResult:
    finding = Finding(code, name, 0.98, 1e-3, 1e-4, "m", np.nan, 1e-3, 1e-4, **changes)  # type: ignore[arg-type]
    c = check(paper_result(), points())
    outcome = code if code in ("row", "other") else "moved"
    return replace(c, findings=(finding, *c.findings), outcome=outcome)


def test_what_moved_is_named_as_a_user_calls_it():
    assert answer(check(paper_result(), points())) == "Nothing has moved."
    assert answer(of("frame")).startswith("The tracker or the base has moved: the target by 1.000 ")
    assert answer(of("target")).startswith("The target in the hand has moved")
    assert answer(of("row", rows=(2,))) == "Row 2 alone is off (P = 0.980): measure it again."
    assert "no single cause" in answer(of("other"))
    assert repr(of("base")).startswith("The base has moved")


def test_the_text_has_the_answer_the_effect_and_what_would_not_be_noticed():
    c = check(paper_result(), points(zeros=(0.0, 0.02, 0.0, 0.0, 0.0, 0.0)))
    text = check_text(c)
    assert text == c.summary()
    lines = text.splitlines()
    assert lines[2].startswith("Joint 'shoulder_lift_joint' has moved: its zero by +1.1")
    assert "more than the expected" in " ".join(text.split())
    assert any(line.startswith("  joint 'elbow_joint': its zero by 0.") for line in lines)
