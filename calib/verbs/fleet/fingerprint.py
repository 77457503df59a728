"""Fingerprints of inputs: equal for equal values, different for any other; by them a run knows what has not changed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np


def fingerprint(*values: object) -> str:
    """Return the SHA-256 of values: of dataclasses by the fields that count in a comparison, of arrays by every bit.

    Args:
        values: Values that JSON has, arrays, paths, bytes, mappings, and dataclasses of these.

    Returns:
        64 hexadecimal digits.

    Raises:
        TypeError: A value is of another type.

    Example:
        >>> fingerprint("a", 1.0) == fingerprint("a", 1.0)
        True
        >>> fingerprint("a", 1.0) == fingerprint("a1.0")
        False
    """
    text = json.dumps(values, default=_parts)
    return hashlib.sha256(text.encode()).hexdigest()


def _parts(value: object) -> object:
    """Return a value that JSON does not have as its type's name and the values it consists of."""
    kind = type(value).__name__
    if is_dataclass(value) and not isinstance(value, type):
        compared = [f.name for f in fields(value) if f.compare]
        return [kind, *((name, getattr(value, name)) for name in compared)]
    if isinstance(value, (np.ndarray, np.generic)):
        return [kind, value.dtype.str, value.shape, value.tobytes().hex()]
    if isinstance(value, Mapping):
        return [kind, *value.items()]
    if isinstance(value, (bytes, Path)):
        return [kind, str(value)]
    raise TypeError(f"a value of type {kind} has no fingerprint")
