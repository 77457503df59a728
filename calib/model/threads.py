"""one_blas_thread: linear algebra on small matrices by one thread.

A fit multiplies and factors thousands of matrices of thirty columns. More threads gain nothing there, and on a busy
machine their waiting for each other takes ten times as long as the work.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import scipy.linalg
from threadpoolctl import ThreadpoolController

# scipy brings linear algebra of its own, which must be loaded before its threads can be counted.
_LOADED = (np.__name__, scipy.linalg.__name__)

_LOCK = threading.Lock()

#: How many blocks are being worked on, and what they found: the last one to end puts it back.
_INSIDE: list[Any] = []


@cache
def _controller() -> ThreadpoolController:
    """The libraries that are loaded; to look for them takes as long as a fit."""
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra has one thread within the block, and what it had before after it, in all threads of a process."""
    with _LOCK:
        found = _INSIDE[0] if _INSIDE else _controller().limit(limits=1, user_api="blas")
        _INSIDE.append(found)
    try:
        yield
    finally:
        with _LOCK:
            _INSIDE.pop()
            if not _INSIDE:
                found.restore_original_limits()
