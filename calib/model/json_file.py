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
    path: str | os.PathLike[str], what: str, schema: object, expected: str
) -> dict[str, Any]:
    """Read a table whose ``schema`` is the one wanted.

    Args:
        path: The file.
        what: What the file should be, for the message: ``"region"``.
        schema: What stands under ``schema``.
        expected: What has which schema, and which file to give: the end of the message about another schema.

    Raises:
        FileError: It cannot be read, is no JSON, or of another schema.
    """
    try:
        table = json.loads(read_bytes(path, what), parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        message = f"{path}: this is not a JSON file: {error}. Wanted is a {what} with its 'schema'; {expected}"
        raise FileError(message) from error
    found = table.get("schema") if isinstance(table, dict) else None
    if not isinstance(table, dict) or found != schema:
        message = f"{path}: its 'schema' is {found!r}; {expected}"
        raise FileError(message)
    return table


def _refused(name: str) -> float:
    """JSON has no NaN or Infinity, and calib writes null."""
    message = f"it holds {name}; write the number, or null where there is none"
    raise ValueError(message)


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
    lines = [f" {json.dumps(key)}: {_indented(plain(value))}" for key, value in table.items()]
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode("utf-8", "backslashreplace")


def plain(value: Any) -> Any:  # noqa: ANN401
    """Nested tables as JSON has them: arrays as lists, numbers that do not exist as None."""
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _indented(value: Any) -> str:  # noqa: ANN401
    """An entry of a table, its lines one step in."""
    if isinstance(value, list) and len(value) > _LONG:
        entries = (json.dumps(entry, ensure_ascii=False) for entry in value)
        return "[\n  " + ",\n  ".join(entries) + "\n ]"
    return json.dumps(value, indent=1, ensure_ascii=False).replace("\n", "\n ")
