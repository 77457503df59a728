"""JSON files of calib's own: each says by its ``schema`` what it is."""

from __future__ import annotations

import json
import os
from typing import Any

from calib.errors import CalibError, FileError
from calib.model.files import read_bytes


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
    try:
        table = json.loads(data)
    except (ValueError, RecursionError) as error:
        message = f"{path}: this is not a JSON file: {error}. Wanted is a {what} with its 'schema'; {expected}"
        raise FileError(message) from error
    found = table.get("schema") if isinstance(table, dict) else None
    if not isinstance(table, dict) or found != schema:
        message = f"{path}: its 'schema' is {found!r}; {expected}"
        raise FileError(message)
    return table


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


def json_bytes(table: object) -> bytes:
    """A table as JSON, UTF-8, one value a line.

    What UTF-8 lacks, such as a byte of a file's name that is no letter, stands as JSON's own escape.
    """
    text = json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False)
    return (text + "\n").encode("utf-8", "backslashreplace")
