"""Mappings that cannot be changed, and can be copied, pickled and sent to other processes.

A ``types.MappingProxyType`` can be neither pickled nor deep-copied; the values of calib can, so they hold this instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Generic, TypeVar

from calib.basics.values import packed

Key = TypeVar("Key")
Value = TypeVar("Value", covariant=True)


class ReadOnlyMapping(Mapping[Key, Value], Generic[Key, Value]):
    """A mapping with the entries of another one, in their order, that cannot be changed.

    Args:
        entries: The entries; they are copied.

    Example:
        >>> ReadOnlyMapping({"m": 1e-4})
        {'m': 0.0001}
    """

    __slots__ = ("_entries",)

    def __init__(self, entries: Mapping[Key, Value] | None = None) -> None:
        """Copy the entries; None: there are none."""
        self._entries: dict[Key, Value] = dict(entries or {})

    def __getitem__(self, key: Key) -> Value:
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

    def __copy__(self) -> ReadOnlyMapping[Key, Value]:
        """Return the mapping itself: it cannot be changed."""
        return self


def keep_read_only(value: object, *names: str) -> None:
    """Replace mappings that a frozen dataclass was made with by read-only copies, as its ``__post_init__`` does.

    Args:
        value: The dataclass.
        names: Names of its mappings; one that is None stays None.
    """
    for name in names:
        entries = getattr(value, name)
        if entries is not None:
            object.__setattr__(value, name, ReadOnlyMapping(entries))
