"""Values that can be pickled, copied and sent to other processes, and are read-only there too.

NumPy forgets that an array is read-only when it is pickled or deep-copied. A `Value` remembers it, for its own arrays
and for those in the tuples, mappings and frozen dataclasses that it holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


class Value:
    """Base of frozen dataclasses: pickled and deep-copied, they are equal to the last bit, and read-only."""

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the values of all fields, without calling the constructor again."""
        return _restored, (type(self), _packed_fields(self))

    def __copy__(self: T) -> T:
        """Return the value itself: it cannot be changed."""
        return self


class _ReadOnlyArray:
    """A read-only array on its way into a pickle, out of which it comes as an array."""

    __slots__ = ("_array",)

    def __init__(self, array: NDArray[Any]) -> None:
        self._array = array

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as an array that is made read-only after it was read."""
        return _read_only, (self._array,)


class _Dataclass:
    """A frozen dataclass that is no `Value`, on its way into a pickle, out of which it comes as what it was."""

    __slots__ = ("_fields", "_type")

    def __init__(self, kind: type, packed_fields: dict[str, Any]) -> None:
        self._type = kind
        self._fields = packed_fields

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a `Value` is."""
        return _restored, (self._type, self._fields)


def packed(value: Any) -> Any:  # noqa: ANN401  whatever a value holds
    """Return what is to be pickled in place of a value, so that its arrays are read-only again when it is read.

    Args:
        value: Anything that can be pickled.

    Returns:
        The same, with read-only arrays marked; the value itself where nothing in it had to be marked.
    """
    if isinstance(value, np.ndarray):
        return value if value.flags.writeable else _ReadOnlyArray(value)
    if type(value) is tuple:
        entries = tuple(packed(entry) for entry in value)
        return entries if _differ(entries, value) else value
    if type(value) is dict:
        marked = {key: packed(entry) for key, entry in value.items()}
        return marked if _differ(marked.values(), value.values()) else value
    if _is_plain_dataclass(value):
        marked = _packed_fields(value)
        is_marked = any(marked[name] is not getattr(value, name) for name in marked)
        return _Dataclass(type(value), marked) if is_marked else value
    return value


def _differ(entries: Any, originals: Any) -> bool:  # noqa: ANN401  two iterables
    """Test whether any of the entries is another object than the original of its place."""
    return any(a is not b for a, b in zip(entries, originals, strict=True))


def _is_plain_dataclass(value: object) -> bool:
    """Test whether a value is a frozen dataclass that does not say itself how it is pickled."""
    kind = type(value)
    if not is_dataclass(kind) or kind.__reduce__ is not object.__reduce__:
        return False
    return bool(getattr(kind, "__dataclass_params__").frozen)  # noqa: B009  unknown to type checkers


def _packed_fields(value: Any) -> dict[str, Any]:  # noqa: ANN401  any dataclass
    """Return the values of a dataclass's fields by name, as they are to be pickled."""
    return {field.name: packed(getattr(value, field.name)) for field in fields(value)}


def _restored(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return an object of a dataclass with these values of its fields; no check is made again."""
    restored = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(restored, name, value)
    return restored


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array that was just read read-only, and return it."""
    array.setflags(write=False)
    return array
