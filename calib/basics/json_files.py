"""JSON files of calib's own: tables with a ``schema``, made of dataclasses and read back into them.

A `JsonLayout` turns dataclasses into tables and back: an attribute's type says how it is written, and its key is its
name unless its field (`calib.basics.records.key`) or the layout has another path. Dots separate nested tables; an empty
path, or one that ends in a dot, puts the keys of an attribute that is a dataclass into the table itself.
"""

from __future__ import annotations

import enum
import hashlib
import json
import math
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from calib.basics.files import read_bytes
from calib.basics.records import json_key
from calib.errors import CalibError, FileError

#: A table of a JSON file.
Json = Mapping[str, Any]

#: A list with more entries than this is written with one entry a line.
_LONG = 500


def read_json(
    path: str | os.PathLike[str],
    what: str,
    schema: object,
    expected: str,
) -> dict[str, Any]:
    """Read a table that has the right ``schema``.

    Args:
        path: The file.
        what: The kind of file that is expected, such as ``"result of calib"``, for messages.
        schema: The value of its key ``schema``.
        expected: A sentence for messages about which schema is expected and which file to give.

    Raises:
        FileError: It cannot be read, is not JSON, or has another schema.
    """
    table = parse_json(
        read_bytes(path, what), f"{path}", f" Wanted is a {what} with its 'schema'; {expected}"
    )
    stated = table.get("schema") if isinstance(table, dict) else None
    if not isinstance(table, dict) or stated != schema:
        raise FileError(f"{path}: its 'schema' is {stated!r}; {expected}")
    return table


def parse_json(text: str | bytes, source: str, wanted: str = "", *, whole: bool = False) -> Any:  # noqa: ANN401  any JSON
    """Return the value that JSON states.

    Args:
        text: The JSON.
        source: The file that holds it, for messages.
        wanted: What should be there, for messages: a sentence after a blank.
        whole: Whether numbers that are whole are integers, however they are written, as `parsed_digest` takes them.

    Raises:
        FileError: It is not JSON.
    """
    try:
        parse_float = _number if whole else None
        return json.loads(text, parse_float=parse_float, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{source}: this is not a JSON file: {error}.{wanted}") from error


def _number(text: str) -> float:
    """Return the number of a text with a point or an exponent; an integer if it is whole."""
    value = float(text)
    return int(value) if value.is_integer() else value


def _refuse_constant(name: str) -> float:
    """Refuse NaN and Infinity, which JSON does not have; calib writes null."""
    raise ValueError(f"it holds {name}; write the number, or null where there is none")


def damage(error: Exception) -> str:
    """Return the fault that an exception found in a file's nested tables, as text for a message."""
    if isinstance(error, KeyError):
        return f"'{error.args[0]}' is missing"
    if isinstance(error, (ValueError, CalibError)):
        return str(error).rstrip(".")
    return f"a value is of another kind: {error}"


def json_bytes(table: Json) -> bytes:
    """Return a table (see `plain`) as JSON in UTF-8, one value a line, or, in a long list, one entry a line."""
    lines = []
    for key, value in table.items():
        entry = plain(value)
        if isinstance(entry, list) and len(entry) > _LONG:
            rows = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in entry)
            text = f"[\n  {rows}\n ]"
        else:
            text = json.dumps(entry, indent=1, ensure_ascii=False).replace("\n", "\n ")
        lines.append(f" {json.dumps(key)}: {text}")
    # A byte of a file's name that is not UTF-8 is written as JSON's own escape.
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode("utf-8", "backslashreplace")


def digest(value: Any) -> str:  # noqa: ANN401  any value
    """Return the SHA-256 of what a value (see `plain`) states, whatever the order of keys, the layout and line ends.

    Numbers count by their value: 2, 2.0 and 20e-1 are the same. So a value has the digest that it has after it was
    written, read, and written again by another program that keeps all digits.

    Returns:
        64 hexadecimal digits.

    Example:
        >>> digest({"a": 1.0, "b": float("nan")}) == digest({"b": None, "a": 1})
        True
    """
    return parsed_digest(_with_whole_numbers(plain(value)))


def parsed_digest(value: Any) -> str:  # noqa: ANN401  any JSON
    """Return the `digest` of what `parse_json` returned with whole numbers, in a fraction of the time."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _with_whole_numbers(value: Any) -> Any:  # noqa: ANN401  any JSON
    """Return JSON with floats that are whole numbers as integers, as JavaScript and jq write them."""
    if isinstance(value, dict):
        return {key: _with_whole_numbers(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_with_whole_numbers(entry) for entry in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def plain(value: Any) -> Any:  # noqa: ANN401  any value
    """Return a value, or nested tables, as JSON has them: arrays as lists, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@dataclass(frozen=True, slots=True)
class Key:
    """Path of an attribute in the file, and functions for a value whose type does not say how it is written."""

    #: Keys of nested tables, separated by dots.
    path: str
    #: From the attribute to the file; None: by its type.
    write: Callable[[Any], Any] | None = None
    #: From the file to the attribute; None: by its type.
    read: Callable[[Any], Any] | None = None


@dataclass(frozen=True, slots=True)
class JsonLayout:
    """Layout of dataclasses in a JSON file: writes them as nested tables, and reads them back."""

    #: By class, from the name of an attribute to its path in the file; None: the attribute is not in the file. An
    #: attribute that is not listed has its name as its path. Those of a base class hold for the classes below it.
    keys: Mapping[type, Mapping[str, Key | str | None]]
    #: By type, the function that writes its values and the one that reads them; None: as if there were no entry.
    types: Mapping[type, tuple[Callable[[Any], Any] | None, Callable[[Any], Any] | None]]

    def table(self, value: Any) -> dict[str, Any]:  # noqa: ANN401  a dataclass
        """Return a dataclass as nested tables, as the layout says and ready for `json_bytes`."""
        return nested(self.entries(value))

    def entries(self, value: Any) -> dict[str, Any]:  # noqa: ANN401  a dataclass
        """Return the entries of a dataclass's table by their paths, such as ``"robot.base"``."""
        entries = {}
        for name, key in self._keys_of(type(value)):
            attribute = getattr(value, name)
            if key.path == "" or key.path.endswith("."):
                for path, entry in self.entries(attribute).items():
                    entries[key.path + path] = entry
            else:
                write = key.write or self.entry
                entries[key.path] = write(attribute)
        return entries

    def values(self, kind: type, table: Json, excluded: Collection[str] = ()) -> dict[str, Any]:
        """Return the attributes of a dataclass by name, from its table.

        Args:
            kind: The dataclass.
            table: Its table in the file.
            excluded: Names of attributes that are not read.

        Returns:
            Arguments for the class, but not those excluded, nor those that have a default and are not in the table.

        Raises:
            KeyError: An attribute without a default is missing.
        """
        hints = get_type_hints(kind)
        with_default = set()
        for field in fields(kind):
            if field.default is not MISSING or field.default_factory is not MISSING:
                with_default.add(field.name)
        result = {}
        for name, key in self._keys_of(kind):
            *folders, last = key.path.split(".")
            place: Any = table
            for folder in folders:
                place = place[folder]
            if name in excluded or (last and name in with_default and last not in place):
                continue
            entry = place[last] if last else place
            if key.read:
                result[name] = key.read(entry)
            else:
                result[name] = self.read(hints[name], entry)
        return result

    def read(self, hint: Any, entry: Any) -> Any:  # noqa: ANN401  any type, any JSON
        """Return a value of a type from the file's entry; null is NaN where a float is expected.

        Args:
            hint: The type, as the hint of a dataclass's field.
            entry: JSON as Python reads it.
        """
        if isinstance(hint, type):
            _, reader = self.types.get(hint, (None, None))
            if reader is not None:
                return reader(entry)
        if hint is float:
            return float("nan") if entry is None else float(entry)
        if hint in (int, bool, str):
            return hint(entry)

        # Types with parameters, such as ``tuple[float, ...]`` or ``Array | None``.
        origin = get_origin(hint)
        parameters = get_args(hint)
        if origin in (Union, UnionType):
            return None if entry is None else self.read(parameters[0], entry)
        if origin is np.ndarray or origin is NDArray:
            # From NumPy 2.5 on the alias has the type of the entries itself, not inside that of an array.
            dtype = parameters[0] if origin is NDArray else get_args(parameters[1])[0]
            array = np.array(entry, dtype=dtype)
            array.setflags(write=False)
            return array
        if origin is tuple:
            return tuple(self.read(parameters[0], value) for value in entry)
        if origin in (dict, Mapping):
            return {str(name): self.read(parameters[1], value) for name, value in entry.items()}
        if origin is not None:
            return entry

        if isinstance(hint, enum.EnumMeta):
            return hint[entry.upper()]
        if isinstance(hint, type) and is_dataclass(hint):
            return hint(**self.values(hint, entry))
        return entry

    def entry(self, value: Any) -> Any:  # noqa: ANN401  any value
        """Return a value as JSON has it; arrays and numbers stay what they are."""
        writer, _ = self.types.get(type(value), (None, None))
        if writer is not None:
            return writer(value)
        if isinstance(value, enum.Enum):
            return value.name.lower()
        if isinstance(value, Mapping):
            return {name: self.entry(entry) for name, entry in value.items()}
        if isinstance(value, tuple | list):
            return [self.entry(entry) for entry in value]
        return self.table(value) if is_dataclass(value) else value

    def _keys_of(self, kind: type) -> list[tuple[str, Key]]:
        """Return the attributes of a class that are in the file, with their keys."""
        listed: dict[str, Key | str | None] = {}
        for base in reversed(kind.__mro__):
            listed |= self.keys.get(base, {})
        result = []
        for field in fields(kind):
            key = listed.get(field.name, json_key(field))
            if isinstance(key, str):
                key = Key(key)
            if key is not None:
                result.append((field.name, key))
        return result


def nested(flat: Json) -> dict[str, Any]:
    """Return nested tables from values by their paths, such as ``"robot.base"``."""
    result: dict[str, Any] = {}
    for path, value in flat.items():
        *folders, last = path.split(".")
        place = result
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = value
    return result
