"""The states in which statements run, by programs of letters: a sets x to 1, b to 2, r returns, every digit looks."""

from __future__ import annotations

from typing import Any

import pytest

from calib.verbs.compensate.programs.flow import Branch, Loop, State, join, walk

START: State = {"x": frozenset({0})}


def seen(nodes: list[Any]) -> tuple[dict[str, set[Any]], State]:
    """What each digit sees of x in the last run of its loop, and the state at the end."""
    looks: dict[str, set[Any]] = {}

    def run(letter: str, state: State, is_trial: bool) -> State:
        if letter == "r" or state is None:
            return None
        if letter in "ab":
            return {**state, "x": frozenset({1 if letter == "a" else 2})}
        if not is_trial:
            looks.setdefault(letter, set()).update(state["x"])
        return state

    return looks, walk(nodes, START, run)


@pytest.mark.parametrize(
    ("nodes", "expected", "end"),
    [
        (["1", "a", "2", "b", "3"], {"1": {0}, "2": {1}, "3": {2}}, {2}),
        (
            [Branch((("a", "1"), ("b", "2"), ())), "3"],
            {"1": {1}, "2": {2}, "3": {0, 1, 2}},
            {0, 1, 2},
        ),
        ([Branch((("a",), ("r",))), "1"], {"1": {1}}, {1}),
        ([Loop(("1", "a")), "2"], {"1": {0, 1}, "2": {0, 1}}, {0, 1}),
        ([Loop(("1", Loop(("2", "a")), "b"))], {"1": {0, 2}, "2": {0, 1, 2}}, {0, 2}),
        (["r", "1"], {}, None),
        ([Loop(("a", "r", "1")), "2"], {"2": {0}}, {0}),
    ],
)
def test_values_at_each_look(nodes: list[Any], expected: dict[str, Any], end: Any) -> None:
    looks, state = seen(nodes)
    assert looks == expected
    assert (None if state is None else set(state["x"])) == end


def test_states_that_meet() -> None:
    assert join([]) is None
    assert join([None, None]) is None
    assert join([None, {"x": frozenset({1})}]) == {"x": frozenset({1})}
    both = join([{"x": frozenset({1})}, {"x": frozenset({2}), "y": frozenset({3})}])
    assert both == {"x": frozenset({1, 2}), "y": frozenset({3})}
