"""Values as objects of a class that extends theirs."""

from __future__ import annotations

from dataclasses import dataclass

from calib.values.with_methods import as_kind, returning


@dataclass(frozen=True, slots=True)
class Values:
    a: int


class Extended(Values):
    __slots__ = ()

    def twice(self) -> int:
        return 2 * self.a


def made(a: int) -> Values:
    """Make values."""
    return Values(a)


def test_values_become_those_of_the_class_with_methods():
    assert as_kind(Extended, Values(3)).twice() == 6


def test_a_function_returns_them_and_keeps_its_name_and_docstring():
    function = returning(Extended, made, "calib.somewhere")
    assert function(a=4).twice() == 8
    assert (function.__name__, function.__doc__, function.__module__) == (
        "made",
        "Make values.",
        "calib.somewhere",
    )
