"""JSON files of calib's own: each says by its ``schema`` what it is."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.errors import CalibError, FileError
from calib.model.files import read_bytes

#: A list of more entries than that has one of them a line.
_LONG = 500


def read_json(
    path: str | os.PathLike[str], what: str, limit_bytes: int, schema: object, expected: str
) -> dict[str, Any]:
    """Read a table whose ``schema`` is the one wanted.

    Args:
        path: The file.
        what: What the file should be, for the message: ``"region"``.
        limit_bytes: Largest size accepted [bytes].
        schema: What stands under ``schema``.
        expected: What has which schema, and which file to give: the end of the message about another schema.

    Raises:
        FileError: It cannot be read, is no JSON, or of another schema.
    """
    data = read_bytes(path, what, limit_bytes)
    strange: list[str] = []

    def constant(name: str) -> float:
        strange.append(name)
        return float(name)

    try:
        table = json.loads(data, parse_constant=constant)
    except (ValueError, RecursionError) as error:
        message = f"{path}: this is not a JSON file: {error}. Wanted is a {what} with its 'schema'; {expected}"
        raise FileError(message) from error
    found = table.get("schema") if isinstance(table, dict) else None
    if not isinstance(table, dict) or found != schema:
        message = f"{path}: its 'schema' is {found!r}; {expected}"
        raise FileError(message)
    if strange:
        message = (
            f"{path}: {_place(table)} is {strange[0]}, which calib does not write and JSON does not have. Write the "
            "number, or null where there is none."
        )
        raise FileError(message)
    return table


def _place(table: Mapping[str, Any]) -> str:
    """The first number of nested tables that is not finite: its keys, and its place in lists from 0."""
    waiting: list[tuple[str, Any]] = [("", table)]
    while waiting:
        place, value = waiting.pop()
        if isinstance(value, float) and not math.isfinite(value):
            return f"'{place}'"
        if isinstance(value, dict):
            found = [(f"{place}.{key}" if place else str(key), one) for key, one in value.items()]
            waiting += reversed(found)
        elif isinstance(value, list):
            waiting += reversed([(f"{place}[{k}]", one) for k, one in enumerate(value)])
    return "a number"  # under a key that stands there twice


def damage(error: Exception) -> str:
    """What reading a file's nested tables stumbled over, in words.

    Example:
        >>> damage(KeyError("robot"))
        "'robot' is missing"
        >>> damage(TypeError("'float' object is not iterable"))
        "a value is of another kind: 'float' object is not iterable"
    """
    if isinstance(error, KeyError):
        return f"'{error.args[0]}' is missing"
    if isinstance(error, (ValueError, CalibError)):
        return str(error).rstrip(".")
    return f"a value is of another kind: {error}"


def json_bytes(table: Mapping[str, Any]) -> bytes:
    """A table as JSON, UTF-8, one value a line; of a long list one entry a line.

    Arrays stand as lists, numbers that do not exist as null. What UTF-8 lacks, such as a byte of a file's name that is
    no letter, stands as JSON's own escape.
    """
    lines = [f" {json.dumps(key)}: {_indented(value)}" for key, value in table.items()]
    text = "{\n" + ",\n".join(lines) + "\n}\n" if lines else "{}\n"
    return text.encode("utf-8", "backslashreplace")


def plain(value: Any) -> Any:  # noqa: ANN401
    """Nested tables as JSON has them: arrays as lists, numbers that do not exist as None."""
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


def _indented(value: Any) -> str:  # noqa: ANN401
    """An entry of a table, its lines one step in."""
    if isinstance(value, (list, tuple)) and len(value) > _LONG:
        return "[\n  " + ",\n  ".join(map(_in_one_line, value)) + "\n ]"
    text = json.dumps(plain(value), indent=1, allow_nan=False, ensure_ascii=False)
    return text.replace("\n", "\n ")


def _in_one_line(value: Any) -> str:  # noqa: ANN401
    """An entry of a long list; only where a number does not exist it has to be looked through first."""
    try:
        return _QUICKLY.encode(value)
    except ValueError:
        return _QUICKLY.encode(plain(value))


_QUICKLY = json.JSONEncoder(allow_nan=False, ensure_ascii=False, default=plain)
