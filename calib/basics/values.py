"""The base of calib's values: they cannot be changed, can be pickled and copied, and show themselves.

Values are frozen dataclasses that extend `Value`. NumPy forgets that an array is read-only when it is pickled or
deep-copied; a `Value` remembers it, for its own arrays and for those in the tuples, mappings and frozen dataclasses
that it holds. For its mappings there is `ReadOnlyMapping`, because a ``types.MappingProxyType`` can be neither pickled
nor deep-copied.

A result has methods such as ``summary`` and ``write_report``. Words, figures and files are made of the result, in
higher layers, which cannot be imported here. `shown_by` is the one way up: by name, when a method is called.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
Key = TypeVar("Key")
Entry = TypeVar("Entry", covariant=True)

#: The most characters of a value that is shown in one line.
_LINE = 120


class Value:
    """Base of frozen dataclasses: pickled and deep-copied, they are equal to the last bit, and read-only."""

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the values of all fields, without calling the constructor again."""
        return _restored, (type(self), _packed_fields(self))

    def __copy__(self: T) -> T:
        """Return the value itself: it cannot be changed."""
        return self


class ReadOnlyMapping(Mapping[Key, Entry], Generic[Key, Entry]):
    """A mapping with the entries of another one, in their order, that cannot be changed.

    Args:
        entries: The entries; they are copied.

    Example:
        >>> ReadOnlyMapping({"m": 1e-4})
        {'m': 0.0001}
    """

    __slots__ = ("_entries",)

    def __init__(self, entries: Mapping[Key, Entry] | None = None) -> None:
        """Copy the entries; None: there are none."""
        self._entries: dict[Key, Entry] = dict(entries or {})

    def __getitem__(self, key: Key) -> Entry:
        """Return the value of a key."""
        return self._entries[key]

    def __iter__(self) -> Iterator[Key]:
        """Iterate over the keys, in their order."""
        return iter(self._entries)

    def __len__(self) -> int:
        """Return the number of entries."""
        return len(self._entries)

    def __repr__(self) -> str:
        """Return the entries as a dict shows them."""
        return repr(self._entries)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy by the entries; arrays among them stay read-only."""
        return ReadOnlyMapping, (packed(self._entries),)

    def __copy__(self) -> ReadOnlyMapping[Key, Entry]:
        """Return the mapping itself: it cannot be changed."""
        return self


def keep_read_only(value: object, *names: str) -> None:
    """Replace mappings that a frozen dataclass was made with by read-only copies, in its ``__post_init__``.

    Args:
        value: The dataclass.
        names: Names of its mappings; one that is None stays None.
    """
    for name in names:
        entries = getattr(value, name)
        if entries is not None:
            object.__setattr__(value, name, ReadOnlyMapping(entries))


def one_line(kind: str, *parts: str) -> str:
    """Return a value as Python shows it, in one line of at most 120 characters.

    Args:
        kind: Name of its class.
        parts: What is worth knowing about it; empty ones are left out.

    Example:
        >>> one_line("Plan", "'ur3'", "", "30 poses")
        "Plan('ur3', 30 poses)"
    """
    text = " ".join(", ".join(part for part in parts if part).split())
    room = _LINE - len(kind) - len("()")
    if len(text) > room:
        text = text[: room - len("...")] + "..."
    return f"{kind}({text})"


def shown_by(module: str) -> Any:  # noqa: ANN401  a module, whose functions a type checker does not know
    """Return the module that shows or writes a value, for a method of that value.

    Args:
        module: Its name below ``calib``, such as ``"verbs.calibrate.text"``.
    """
    return importlib.import_module(f"calib.{module}")


# Pickling


class _ReadOnlyArray:
    """Stands for a read-only array in a pickle, and is read from it as an array that is read-only again."""

    __slots__ = ("_array",)

    def __init__(self, array: NDArray[Any]) -> None:
        self._array = array

    def __reduce__(self) -> tuple[Any, ...]:
        return _read_only, (self._array,)


class _Dataclass:
    """Stands for a frozen dataclass that is not a `Value` in a pickle, and is read from it as that dataclass."""

    __slots__ = ("_fields", "_type")

    def __init__(self, kind: type, packed_fields: dict[str, Any]) -> None:
        self._type = kind
        self._fields = packed_fields

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._type, self._fields)


def packed(value: Any) -> Any:  # noqa: ANN401  whatever a value holds
    """Return what is to be pickled in place of a value, so that its arrays are read-only again when it is read.

    Args:
        value: Anything that can be pickled.

    Returns:
        The same, with read-only arrays marked; the value itself if nothing in it had to be marked.
    """
    if isinstance(value, np.ndarray):
        return value if value.flags.writeable else _ReadOnlyArray(value)
    kind = type(value)
    if kind is tuple:
        entries = tuple(packed(entry) for entry in value)
        return entries if _differ(entries, value) else value
    if kind is dict:
        marked = {key: packed(entry) for key, entry in value.items()}
        return marked if _differ(marked.values(), value.values()) else value
    # A dataclass that says itself how it is pickled is left alone.
    is_plain = is_dataclass(kind) and kind.__reduce__ is object.__reduce__
    if is_plain and getattr(kind, "__dataclass_params__").frozen:  # noqa: B009  unknown to type checkers
        marked = _packed_fields(value)
        if any(marked[name] is not getattr(value, name) for name in marked):
            return _Dataclass(kind, marked)
    return value


def _differ(entries: Any, originals: Any) -> bool:  # noqa: ANN401  two iterables
    """Test whether any of the entries is another object than the original in its place."""
    return any(a is not b for a, b in zip(entries, originals, strict=True))


def _packed_fields(value: Any) -> dict[str, Any]:  # noqa: ANN401  any dataclass
    """Return the values of a dataclass's fields by name, as they are to be pickled."""
    return {field.name: packed(getattr(value, field.name)) for field in fields(value)}


def _restored(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return an object of a dataclass with these values of its fields, without checking them again."""
    restored = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(restored, name, value)
    return restored


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array that was read from a pickle, made read-only in place."""
    array.setflags(write=False)
    return array
