"""fingerprint: a SHA-256 of values, so that results are used again only where all that they hang on is the same.

Values are calib's own: dataclasses, by their fields that count in a comparison, arrays, mappings and sequences in their
order, texts, bytes and numbers to the last bit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np


def fingerprint(*values: object) -> str:
    """The SHA-256 of some values, in hexadecimal digits.

    Raises:
        TypeError: A value is of a kind that has none.

    Example:
        >>> fingerprint("a", 1.0) == fingerprint("a", 1.0), fingerprint("a", 1.0) == fingerprint("a1.0")
        (True, False)
    """
    digest = hashlib.sha256()
    for part in _parts(values):
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


def _parts(value: object) -> Iterator[bytes]:
    """What a value consists of, with its kind before it."""
    yield type(value).__name__.encode()
    if value is None or isinstance(value, (bool, int, str, Path)):
        yield str(value).encode("utf-8", "surrogatepass")
    elif isinstance(value, bytes):
        yield value
    elif isinstance(value, float):
        yield value.hex().encode()
    elif isinstance(value, (np.ndarray, np.generic)):
        yield f"{value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    else:
        yield from _inner_parts(value)


def _inner_parts(value: object) -> Iterator[bytes]:
    """Those of what holds others."""
    if is_dataclass(value) and not isinstance(value, type):
        named = {f.name: getattr(value, f.name) for f in fields(value) if f.compare}
        yield from _parts(named)
    elif isinstance(value, Mapping):
        yield str(len(value)).encode()
        for key, entry in value.items():
            yield from _parts(key)
            yield from _parts(entry)
    elif isinstance(value, (tuple, list)):
        yield str(len(value)).encode()
        for entry in value:
            yield from _parts(entry)
    else:
        message = f"a value of type {type(value).__name__} has no fingerprint"
        raise TypeError(message)
