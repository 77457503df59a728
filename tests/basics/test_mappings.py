"""Mappings that cannot be changed, and can be copied and pickled."""

from __future__ import annotations

import copy
import pickle

import pytest

from calib.basics.mappings import ReadOnlyMapping


def test_it_has_the_entries_in_their_order():
    mapping = ReadOnlyMapping({"b": 1, "a": 2})
    assert mapping["a"] == 2
    assert list(mapping) == ["b", "a"]
    assert len(mapping) == 2
    assert mapping == {"a": 2, "b": 1}
    assert ReadOnlyMapping() == {}


def test_it_cannot_be_changed_not_even_through_what_it_was_made_of():
    entries = {"a": 1}
    mapping = ReadOnlyMapping(entries)
    entries["a"] = 2
    assert mapping["a"] == 1
    with pytest.raises(TypeError):
        mapping["a"] = 2  # type: ignore[index]


def test_pickled_and_deep_copied_it_is_equal_and_of_its_own():
    mapping = ReadOnlyMapping({"a": [1.0]})
    for again in (pickle.loads(pickle.dumps(mapping)), copy.deepcopy(mapping)):
        assert type(again) is ReadOnlyMapping
        assert again == mapping
        assert again["a"] is not mapping["a"]
