"""Many independent jobs: `run` them here or in any executor of `concurrent.futures`; Dask has one too.

Jobs carry the plugins that are loaded here, and a worker loads them first. The rest of such a job is sent as bytes: it
may name functions of a plugin, which exist in the worker only from then on.

Within a job linear algebra takes one thread, see `one_blas_thread`.
"""

from __future__ import annotations

import importlib
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

import calib.basics.plugins as plugins
from calib.basics.plugins import Plugin
from calib.errors import CalibError

#: Function that is called with the number of jobs done and of all jobs.
Progress = Callable[[int, int], None]

#: The fewest batches that jobs are divided into: several for each worker of a usual machine.
_BATCHES = 24

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


def run(
    function: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Iterable[Item],
    executor: Executor | None = None,
    *,
    batch: int = 1,
) -> Iterator[tuple[int, Result]]:
    """Yield ``function(shared, item)`` of every item, in any order.

    Args:
        function: A module's function; its arguments and its result can be pickled.
        shared: First argument of every call.
        items: Second argument of each call.
        executor: Where the calls are made; None: here, one after the other.
        batch: Number of items sent together, with ``shared``: many for jobs that take less time than to be sent.

    Yields:
        The item's number, from 0, and the result.

    Raises:
        CalibError: A worker was killed, or ran out of memory.
        PluginError: A worker cannot load a plugin.
    """
    numbered = enumerate(items)
    if executor is None:
        yield from ((number, function(shared, item)) for number, item in numbered)
        return
    jobs = list(numbered)
    loaded = plugins.loaded()
    pending: list[Future[list[tuple[int, Result]]]] = []
    for first in range(0, len(jobs), batch):
        sent = jobs[first : first + batch]
        if loaded:
            call = pickle.dumps((function, shared, sent))
            pending.append(executor.submit(_call_with_plugins, loaded, call))
        else:
            pending.append(executor.submit(_call, function, shared, sent))
    try:
        for future in as_completed(pending):
            yield from future.result()
    except BrokenExecutor as error:
        raise CalibError(
            f"A worker process was killed, or ran out of memory ({error}). Try fewer --workers."
        ) from error
    finally:
        for future in pending:
            future.cancel()


def core_count() -> int:
    """Return the number of cores that this process may use: those that it is bound to, where the system tells."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def batch_size(count: int, largest: int = 50) -> int:
    """Return the number of short jobs to send together: few enough for all workers to end at about the same time.

    Args:
        count: Number of all jobs.
        largest: The largest number to send together.
    """
    return max(1, min(largest, count // _BATCHES))


def _call_with_plugins(loaded: Sequence[Plugin], call: bytes) -> list[tuple[int, Any]]:
    """Load the plugins of the process that sends the jobs, then `_call` with the pickled arguments, in a worker."""
    plugins.load_sent(loaded)
    return _call(*pickle.loads(call))  # noqa: S301  from the process that sends the jobs


def _call(
    function: Callable[[Shared, Item], Result], shared: Shared, jobs: list[tuple[int, Item]]
) -> list[tuple[int, Result]]:
    """Return the numbers and results of one batch of numbered items, in a worker."""
    return [(number, function(shared, item)) for number, item in jobs]


@cache
def _blas_libraries() -> ThreadpoolController:
    """Return the libraries of NumPy and SciPy, which are loaded; searching for them takes as long as a fit."""
    importlib.import_module(
        "scipy.linalg"
    )  # or a library that it loads later would not be among them
    return ThreadpoolController()


def blas_kernels() -> str:
    """Return the libraries of linear algebra (BLAS) of NumPy and SciPy with versions and kernels, by name.

    Such as ``"openblas 0.3.30 Haswell, openblas 0.3.31 Haswell"``; empty if there are none that tell.
    """
    names = set()
    for library in _blas_libraries().info():
        if library["user_api"] == "blas":
            words = (library["internal_api"], library["version"], library.get("architecture"))
            names.add(" ".join(filter(None, words)))
    return ", ".join(sorted(names))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra (BLAS) to one thread inside a ``with`` block, or a function that this decorates.

    On matrices as small as those of a fit, several threads wait for each other longer than they compute.
    """
    with _blas_libraries().limit(limits=1, user_api="blas"):
        yield
