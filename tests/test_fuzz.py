"""A few broken files for each reader of robots: `scripts/fuzz.py` in small, in this process."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import pytest

from calib.errors import UrdfError

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="module")
def fuzz():
    sys.path.insert(0, str(SCRIPTS))
    try:
        import fuzz_models
        import fuzzing
    finally:
        sys.path.remove(str(SCRIPTS))
    return fuzzing, fuzz_models.READERS


def test_readers_refuse_with_a_message_or_read(fuzz):
    fuzzing, readers = fuzz
    kinds = set()
    for name, reader in readers.items():
        for index in range(4):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)
                kind, text = fuzzing.judged(reader, fuzzing.mutated(reader, 8, index))
            assert kind != fuzzing.FINDING, (name, index, text)
            kinds.add((name, kind))
    assert len(kinds) > len(readers)  # some were accepted, some refused


def test_cases_are_always_the_same(fuzz):
    fuzzing, readers = fuzz
    first = [fuzzing.mutated(readers["ur-conf"], 0, i) for i in range(20)]
    assert first == [fuzzing.mutated(readers["ur-conf"], 0, i) for i in range(20)]
    assert len(set(first)) > 15


def refused(_data: bytes) -> None:
    message = "no"
    raise UrdfError(message)


def broken(_data: bytes) -> None:
    message = "oops"
    raise KeyError(message)


def empty(_data: bytes) -> None:
    raise UrdfError("")


def dies(_data: bytes) -> None:
    import os

    os._exit(3)


def test_what_is_counted_as_what(fuzz):
    fuzzing, _ = fuzz
    for read, kind in (
        (len, "accepted"),
        (refused, "refused"),
        (broken, "finding"),
        (empty, "finding"),
    ):
        assert fuzzing.judged(fuzzing.Reader("r", read, lambda: [b"x"]), b"x")[0] == kind


def test_a_process_that_dies_is_a_finding(fuzz):
    fuzzing, _ = fuzz
    tally = fuzzing.fuzzed(fuzzing.Reader("r", dies, lambda: [b"x"]), range(2), workers=1)
    assert tally.cases == 2
    assert all("died" in text for text in tally.findings.values())
