"""JSON from dataclasses and back: an attribute's type says how it is written, a table of keys where it stands.

Keys are those of the attributes unless the table names another path; dots separate nested tables, and an empty path, or
one that ends in a dot, puts the attribute's own keys beside the others.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

Json = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Key:
    """Path of an attribute, and what writes and reads it where its type does not say."""

    path: str
    write: Callable[[Any], Any] | None = None
    read: Callable[[Any], Any] | None = None


@dataclass(frozen=True, slots=True)
class Layout:
    """Writes and reads dataclasses by the keys of their attributes; None: an attribute that is not in the file.

    ``types`` has what writes and reads values of a type in another way; None for one of both: as usual.
    """

    keys: Mapping[type, Mapping[str, Key | str | None]]
    types: Mapping[type, tuple[Callable[[Any], Any] | None, Callable[[Any], Any] | None]]

    def table(self, value: Any) -> dict[str, Any]:  # noqa: ANN401  a dataclass
        """A dataclass as nested tables."""
        return nested(
            {
                key.path: (key.write or self._write)(getattr(value, n))
                for n, key in self._of(type(value))
            }
        )

    def values(self, kind: type, found: Json, without: Collection[str] = ()) -> dict[str, Any]:
        """The attributes of a dataclass by name, from its table; those that it lacks have their defaults."""
        hints, result = get_type_hints(kind), {}
        defaults = {f.name for f in fields(kind) if f.default is not MISSING}
        for name, key in self._of(kind):
            place: Any = found
            *folders, last = key.path.split(".")
            for folder in folders:
                place = place[folder]
            if name not in without and not (name in defaults and last not in place):
                entry = place[last] if last else place
                result[name] = key.read(entry) if key.read else self.read(hints[name], entry)
        return result

    def read(self, hint: Any, found: Any) -> Any:  # noqa: ANN401  any type, any JSON
        """A value of a type; a missing number is NaN."""
        origin, args = get_origin(hint), get_args(hint)
        own = self.types.get(hint, (None, None))[1] if isinstance(hint, type) else None
        if own is not None:
            return own(found)
        if hint is float:
            return float("nan") if found is None else float(found)
        if hint in (int, bool, str):
            return hint(found)
        if origin in (Union, UnionType):
            return None if found is None else self.read(args[0], found)
        if origin is np.ndarray:
            array = np.array(found, dtype=get_args(args[1])[0])
            array.setflags(write=False)
            return array
        if origin is tuple:
            return tuple(self.read(args[0], one) for one in found)
        if origin in (dict, Mapping):
            return {str(name): self.read(args[1], one) for name, one in found.items()}
        if isinstance(hint, enum.EnumMeta):
            return hint[found.upper()]
        if isinstance(hint, type) and is_dataclass(hint):
            return hint(**self.values(hint, found))
        return found

    def _write(self, value: Any) -> Any:  # noqa: ANN401
        """A value as JSON has it; arrays and numbers stay what they are."""
        own = self.types.get(type(value), (None, None))[0]
        if own is not None:
            return own(value)
        if isinstance(value, enum.Enum):
            return value.name.lower()
        if isinstance(value, Mapping):
            return {name: self._write(one) for name, one in value.items()}
        if isinstance(value, tuple | list):
            return [self._write(one) for one in value]
        return self.table(value) if is_dataclass(value) else value

    def _of(self, kind: type) -> list[tuple[str, Key]]:
        """The attributes that are in the file, with their keys; a class has those of its bases."""
        own = {
            n: key for base in reversed(kind.__mro__) for n, key in self.keys.get(base, {}).items()
        }
        found = [(f.name, own.get(f.name, f.name)) for f in fields(kind)]
        return [
            (n, Key(key) if isinstance(key, str) else key) for n, key in found if key is not None
        ]


def nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Tables from values by their paths."""
    result: dict[str, Any] = {}
    for path, value in flat.items():
        *folders, last = path.split(".")
        place = result
        for folder in folders:
            place = place.setdefault(folder, {})
        place.update({last: value} if last else value)
    return result
