"""In which states the statements of a program may run: what is set on the way to them, through branches, loops, calls.

A state holds the values that each setting of a controller may have at a statement, such as the tools that can be
active. Where ways meet, the values of both are possible. Loops are gone through until no more values are possible.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

#: Possible values of each setting by its name; None: nothing runs here, as after a RETURN.
State: TypeAlias = "Mapping[str, frozenset[Hashable]] | None"


@dataclass(frozen=True, slots=True)
class Branch:
    """Ways of which one is gone; an empty one if none may be."""

    ways: tuple[tuple[Node, ...], ...]


@dataclass(frozen=True, slots=True)
class Loop:
    """Statements that run any number of times."""

    body: tuple[Node, ...]


#: A `Branch`, a `Loop`, or a statement of the dialect.
Node: TypeAlias = Any


def join(states: Iterable[State]) -> State:
    """Return the state where ways with these states meet: a setting has any of their values."""
    merged: dict[str, frozenset[Hashable]] | None = None
    for state in states:
        if state is None:
            continue
        if merged is None:
            merged = dict(state)
            continue
        for name, values in state.items():
            merged[name] = merged.get(name, frozenset()) | values
    return merged


def walk(
    nodes: Sequence[Node],
    state: State,
    run: Callable[[Any, State, bool], State],
    *,
    is_trial: bool = False,
) -> State:
    """Run statements in all states in which they may run.

    Args:
        nodes: The statements in the order of the text.
        state: The state in which the first one runs.
        run: Runs one statement in a state, and returns the state after it. Statements that nothing reaches are run in
            the state None. The last argument says whether this is a trial: in a loop the state is not yet all that is
            possible there, and the statement will run again.
        is_trial: Whether all of this is a trial.

    Returns:
        The state after the last one.
    """
    for node in nodes:
        if isinstance(node, Branch):
            state = join([walk(way, state, run, is_trial=is_trial) for way in node.ways])
        elif isinstance(node, Loop):
            merged = join([state, walk(node.body, state, run, is_trial=True)])
            while merged != state:
                state = merged
                merged = join([state, walk(node.body, state, run, is_trial=True)])
            walk(node.body, state, run, is_trial=is_trial)
        else:
            state = run(node, state, is_trial)
    return state
