"""Expensive values that tests share, made once a run: by the first worker that asks, and read by the others."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, TypeVar

try:
    import fcntl
except ImportError:  # on Windows each worker makes its own
    fcntl = None  # type: ignore[assignment]

#: The folder of all workers of this run; None if there is one process only. Set by conftest.py.
FOLDER: list[Path] = []

_Made = TypeVar("_Made")


def kept(make: Callable[..., _Made]) -> Callable[..., _Made]:
    """Keep what a function of plain arguments makes, in this process and for the other workers of the run."""

    @cache
    @wraps(make)
    def of(*words: Any) -> _Made:
        if fcntl is None or not FOLDER:
            return make(*words)
        name = hashlib.sha256(
            f"{make.__module__}.{make.__qualname__}{words!r}".encode()
        ).hexdigest()[:24]
        file = FOLDER[0] / name
        with (FOLDER[0] / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # let go of when the file is closed
            if not file.exists():
                made = make(*words)
                unfinished = file.with_suffix(f".{os.getpid()}")
                unfinished.write_bytes(pickle.dumps(made))
                unfinished.rename(file)
                return made
        return pickle.loads(file.read_bytes())

    return of
