"""A session in words: findings with what to do, why an aim is not reached, and the list of stops."""

from __future__ import annotations

import pytest

from calib.verbs.app.sentences import languages
from calib.verbs.app.sitting_page import finding_text, open_text, unreached_text
from calib.verbs.measure.state import State
from calib.verbs.measure.stop import Finding
from tests.verbs.app.measured import arm

EN = languages()["en"]


def state(*findings: Finding, high: float | None, reached: bool = False) -> State:
    """A state with an aim of 0.1 mm."""
    return State(
        stops=9,
        measured=9,
        error=None if high is None else high / 2.0,
        low=None if high is None else high / 3.0,
        high=high,
        aim=1e-4,
        nominal=None,
        reached=reached,
        needed=None,
        curve=(),
        advice=(),
        findings=findings,
        sigma={},
    )


@pytest.mark.parametrize(
    ("found", "named"),
    [
        (Finding("swapped", (4,), name="yxz"), "(xyz → yxz)"),
        (Finding("swapped", (4,), name="a, b"), "(a, b)"),
        (Finding("gross", (4,), {"off_m": 0.0123}), "12.3"),
        (Finding("gross", (4,)), "type its joint values"),
        (Finding("repeated", (4,), {"stop": 2.0}), "stop 2"),
        (Finding("not_there", (4,), {"change": 0.1}, "elbow_joint"), "elbow_joint is +5.73 deg"),
        (Finding("not_there", (4,), {"stop": 0.0}), "another pose"),
        (Finding("target_moved", (4, 5, 6), name="a"), "a sits elsewhere since stop 4."),
    ],
)
def test_a_finding_names_what_is_meant(found: Finding, named: str):
    for t in languages().values():
        assert "{" not in finding_text(found, arm(), t)
    assert named in finding_text(found, arm(), EN)


def test_a_stop_that_is_far_off_by_now_is_no_mistake_of_this_moment():
    assert open_text(Finding("gross", (4,)), arm(), EN) == EN("open_gross", stop="4")
    for answered, key in ((4, "finding_gross"), (9, "open_gross")):
        words = {"stop": "4", "off": ""}
        assert finding_text(Finding("gross", (4,)), arm(), EN, answered) == EN(key, **words)
    moved = Finding("base_moved", (4, 5))
    assert open_text(moved, arm(), EN) == finding_text(moved, arm(), EN)


def test_why_an_aim_is_not_reached_that_the_error_keeps():
    assert unreached_text(state(high=None), EN) == ""
    assert unreached_text(state(high=2e-4), EN) == ""
    assert unreached_text(state(high=9e-5), EN) == EN("unreached_unchecked")
    assert unreached_text(state(high=9e-5, reached=True), EN) == ""
    moved = Finding("something_moved", (4,))
    for high in (None, 9e-5, 2e-4):
        assert unreached_text(state(moved, high=high), EN) == EN("unreached_undecided")
