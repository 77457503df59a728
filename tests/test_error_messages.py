"""Every message that calib raises is quoted by a test: a new one without a test fails here.

Three words in a row of it must stand in a string of a test: those that it shares with the fewest other messages, most
often with none. That a test provokes the message is measured: `make coverage` lists each that no test raises.
"""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

TESTS = Path(__file__).parent
SCRIPT = TESTS.parent / "scripts" / "error_messages.py"

#: Words in a row that make a quotation; two where a message has no three.
LENGTHS = (3, 2)

Words = tuple[str, ...]


@pytest.fixture(scope="module")
def script() -> ModuleType:
    """scripts/error_messages.py as a module."""
    spec = importlib.util.spec_from_file_location("error_messages", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@cache
def runs(text: str, length: int) -> frozenset[Words]:
    """Every ``length`` words in a row, without the signs around them."""
    words = [re.sub(r"^\W+|\W+$", "", word) or word for word in text.split()]
    return frozenset(tuple(words[i : i + length]) for i in range(len(words) - length + 1))


def said(text: str, length: int) -> set[Words]:
    """The runs of a message, of what stands between its values; signs that touch a value are none of its words."""
    parts = re.split(r"\S*\{\}\S*| \| ", text)
    return {run for part in parts for run in runs(part, length)}


def strings() -> Iterator[str]:
    """All strings in tests; of a pattern, what stands between its wildcards, without backslashes."""
    for path in sorted({*TESTS.rglob("*.py")} - {Path(__file__)}):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                plain = re.sub(r"\\([^a-zA-Z0-9])", r"\1", node.value)
                yield from re.split(r"\.[*+]\??", plain)


def unquoted(messages: Iterable[str], quotations: Iterable[str]) -> list[str]:
    """The messages of which no quotation has the words that tell them best."""
    messages, quotations = list(messages), list(quotations)
    by_length = {length: {text: said(text, length) for text in messages} for length in LENGTHS}
    shared = {n: Counter(run for own in by_length[n].values() for run in own) for n in LENGTHS}
    quoted = {n: {run for text in quotations for run in runs(text, n)} for n in LENGTHS}
    left = []
    for text in messages:
        n = next((n for n in LENGTHS if by_length[n][text]), None)
        if n is None:  # a value, or what another message begins
            continue
        own = by_length[n][text]
        fewest = min(shared[n][run] for run in own)
        if not any(run in quoted[n] for run in own if shared[n][run] == fewest):
            left.append(text)
    return left


def test_every_message_is_quoted_by_a_test(script):
    refusals = [one for path in script.modules() for one in script.refusals(path)]
    where = {one.text: one.where for one in refusals}
    left = unquoted(where, strings())
    assert not left, "no test quotes these messages:\n" + "\n".join(
        sorted(f"{where[text]}: {text}" for text in left)
    )


MODULE = """
_ASKED = "Ask somebody else."


def check(value, what):
    if value < 0.0:
        message = f"The {what} is {value}; it must not be below zero."
        raise CalibError(message)
    hint = f" Did you mean {-value}?" if value > 9.0 else ""
    if value > 5.0:
        message = f"The {what} is too large.{hint}"
    else:
        message = "Give a smaller one, or none at all."
    raise FileError(message)


def other():
    raise ModelError(_worded(3))
    raise typer.Exit(1)


def last():
    raise SolverError(_ASKED)


def _worded(count):
    if count > 2:
        return f"{count} are more than there can be."
    return "There is none."
"""


def test_what_is_found_in_a_module(script, tmp_path):
    path = tmp_path / "module.py"
    path.write_text(MODULE)
    found = [(one.kind, one.line, sorted(one.lines), one.text) for one in script.refusals(path)]
    assert found == [
        ("CalibError", 8, [7, 8], "The {} is {}; it must not be below zero."),
        (
            "FileError",
            14,
            [9, 11, 13, 14],
            "The {} is too large.{} | Give a smaller one, or none at all.",
        ),
        ("ModelError", 18, [18, 28, 29], "{} are more than there can be. | There is none."),
        ("SolverError", 23, [23], "Ask somebody else."),
    ]


def test_which_messages_are_quoted():
    first, second = (
        "The {} is {}; it must not be below zero.",
        "There is no '{}'; choose one of {}.",
    )
    assert unquoted([first, second], ["must not be below zero"]) == [second]
    assert unquoted([first, second], ["'a'; choose one of 'b'", "it must not"]) == []
    # Words that both have tell neither.
    third = "There is no '{}'; choose one of {} or leave it out."
    assert unquoted([second, third], ["choose one of"]) == [third]
    assert unquoted([second, third], ["or leave it"]) == [second]
    assert unquoted(["{}: {}."], []) == []
