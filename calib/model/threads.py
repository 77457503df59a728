"""Threads: many samples in blocks, shared out among the cores; and linear algebra on small matrices by one thread.

A fit multiplies and factors thousands of matrices of thirty columns. More threads gain nothing there, and on a busy
machine their waiting for each other takes ten times as long as the work. What many samples need is shared out by blocks
instead, each of which stays in the processor's cache; NumPy lets other threads work meanwhile. Blocks and their order
do not depend on the number of threads, and so neither does a result.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

import numpy as np
import scipy.linalg
from threadpoolctl import ThreadpoolController

T = TypeVar("T")

#: Samples of one block.
BLOCK = 1024

# scipy brings linear algebra of its own, which must be loaded before its threads can be counted.
_LOADED = (np.__name__, scipy.linalg.__name__)

_LOCK = threading.Lock()

#: How many blocks are being worked on, and what they found: the last one to end puts it back.
_INSIDE: list[Any] = []


def over_blocks(work: Callable[[slice], T], count: int) -> list[T]:
    """What ``work`` gives for each block of some samples, in their order; it must not ask for blocks itself."""
    parts = [slice(first, min(first + BLOCK, count)) for first in range(0, count, BLOCK)]
    size = -(-len(parts) // _cores())
    with one_blas_thread():
        if len(parts) < 2 or size == len(parts):
            return [work(part) for part in parts]
        shares = [parts[k : k + size] for k in range(0, len(parts), size)]
        done = _pool().map(lambda share: [work(part) for part in share], shares)
        return [one for share in done for one in share]


@cache
def _cores() -> int:
    """As many as this process may use, or as OMP_NUM_THREADS says."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(int(asked) if asked.isdecimal() else (cores or 1), 1)


@cache
def _pool() -> ThreadPoolExecutor:
    """The threads that wait for work."""
    return ThreadPoolExecutor(_cores(), thread_name_prefix="calib-blocks")


if hasattr(os, "register_at_fork"):
    # A forked process has none of its parent's threads.
    os.register_at_fork(after_in_child=_pool.cache_clear)


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
