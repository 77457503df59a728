"""run: many independent jobs in any executor of `concurrent.futures`, with the same results to the bit in each.

What would move the last bits is kept away: a job gets its inputs as another process would, unpickled, so that arrays
lie in memory alike everywhere; and while it runs, linear algebra has one thread, for sums in several threads are added
up in another order. Jobs of one process run one after the other. Machines must have the same packages, which is
checked; processors of another make may round differently all the same, see docs/fleet.md.

A job that ends its process (killed, out of memory) is told from one that raises: see `Lost`.
"""

from __future__ import annotations

import importlib.metadata
import pickle
import platform
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import wait as wait_for
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import islice
from typing import Any, TypeVar

import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_limits

from calib.errors import CalibError
from calib.version import __version__

C = TypeVar("C")
I = TypeVar("I")  # noqa: E741  an item
R = TypeVar("R")

#: Packages that must be the same everywhere: what computes, and what carries the jobs.
PACKAGES = ("numpy", "scipy", "pin", "numba", "distributed")

#: Calls sent ahead for each worker: while one runs, the next is on its way.
_AHEAD = 3

#: Calls that a run is cut into for each worker, where it is for `batch_size` to say.
_SHARES = 12

#: More items in one call would be long in coming back, and lost together.
_LARGEST_BATCH = 50

#: How often it is asked whether anybody still works [s].
_PATIENCE = 5.0

#: One job a process at a time: threads of one process share its linear algebra, and matplotlib.
_TURN = threading.RLock()

# scipy brings linear algebra of its own, which must be loaded before its threads can be limited.
_LOADED = (np.__name__, scipy.linalg.__name__)


class WorkerDied(CalibError):
    """A process that worked on a job has ended twice; the text says how."""


@dataclass(frozen=True, slots=True)
class Lost:
    """In the place of a result: the job ended its process, twice.

    Attributes:
        reason: What is known of it.
    """

    reason: str


@dataclass(frozen=True, slots=True)
class _Call:
    """Some items and the function that each of them is for, as bytes."""

    shared: bytes
    items: tuple[bytes, ...]
    versions: tuple[tuple[str, str], ...]


def run(
    function: Callable[[C, I], R],
    shared: C,
    items: Iterable[I],
    executor: Executor | None = None,
    *,
    batch: int = 1,
) -> Iterator[tuple[int, R | Lost]]:
    """``function(shared, item)`` of every item, in any order.

    Args:
        function: A function of a module; what it is given and gives back can be pickled.
        shared: What all calls have in common; sent with every batch.
        items: One for each call; taken as they are needed, so that not all of them are in memory at once.
        executor: Where to; None: here, one after the other.
        batch: Items that are sent together; see `batch_size`.

    Yields:
        The item's number, counted from 0, and its result; or `Lost`.

    Raises:
        CalibError: The executor has ended, or other versions work there.
    """
    blob = pickle.dumps((function, shared), pickle.HIGHEST_PROTOCOL)
    blobs = (
        (number, pickle.dumps(item, pickle.HIGHEST_PROTOCOL)) for number, item in enumerate(items)
    )
    with one_thread():
        if executor is None:
            here, given = pickle.loads(blob)
            for number, item in blobs:
                with _TURN:
                    result = here(given, pickle.loads(item))
                yield number, result
        else:
            yield from _elsewhere(blob, blobs, executor, batch)


def batch_size(count: int, executor: Executor | None) -> int:
    """How many of so many items to send together: few enough for all workers to end at about the same time."""
    return max(1, min(_LARGEST_BATCH, count // (_SHARES * worker_count(executor))))


def worker_count(executor: Executor | None) -> int:
    """How many jobs an executor does at once, as far as it says so."""
    for name in ("workers", "_max_workers"):
        number = getattr(executor, name, None)
        if isinstance(number, int) and number > 0:
            return number
    return 1 if executor is None else 4


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra has one thread within the block, and what it had before after it."""
    with threadpool_limits(limits=1):
        yield


@cache
def versions() -> tuple[tuple[str, str], ...]:
    """What must be the same wherever jobs run: name and version of calib, Python and `PACKAGES`."""
    python = ".".join(platform.python_version_tuple()[:2])
    return (("calib", __version__), ("python", python), *((n, _version(n)) for n in PACKAGES))


def check_versions(theirs: Iterable[tuple[str, str]], where: str) -> None:
    """Refuse a place that has other versions.

    Args:
        theirs: As of `versions`.
        where: For the message.

    Raises:
        CalibError: They differ.
    """
    ours, found = dict(versions()), dict(theirs)
    # Who runs no Dask here need not have it there.
    needed = [name for name in ours if name != "distributed" or ours[name] != "missing"]
    wrong = [name for name in needed if ours[name] != found.get(name, "missing")]
    if wrong:
        told = ", ".join(
            f"{name} {found.get(name, 'missing')} there and {ours[name]} here" for name in wrong
        )
        message = (
            f"{where} has other versions: {told}. Results would differ; install the same ones."
        )
        raise CalibError(message)


def _version(package: str) -> str:
    """The installed version of a package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "missing"


def _elsewhere(
    blob: bytes, blobs: Iterator[tuple[int, bytes]], executor: Executor, batch: int
) -> Iterator[tuple[int, Any]]:
    """The results from an executor, as they come; no more calls are under way than keep it busy."""
    waiting: dict[Future[list[Any]], list[tuple[int, bytes]]] = {}

    def send(items: list[tuple[int, bytes]]) -> None:
        call = _Call(blob, tuple(item for _, item in items), versions())
        waiting[_submitted(executor, call)] = items

    def fill() -> None:
        while len(waiting) < _AHEAD * worker_count(executor):
            if not (items := list(islice(blobs, batch))):
                return
            send(items)

    try:
        fill()
        while waiting:
            done, _ = wait_for(waiting, timeout=_PATIENCE, return_when=FIRST_COMPLETED)
            if not done:
                _still_there(executor)
            for future in done:
                found, again = _outcome(future, waiting.pop(future))
                for item in again:
                    send([item])
                yield from found
            fill()
    finally:
        for future in waiting:
            future.cancel()


def _outcome(
    future: Future[list[Any]], items: list[tuple[int, bytes]]
) -> tuple[list[tuple[int, Any]], list[tuple[int, bytes]]]:
    """The results of a call's items, and the items to send again, each alone.

    Of several that ended their process together one is to blame, and the others must not be lost with it.
    """
    results = _results(future)
    if isinstance(results, Lost):
        return ([], items) if len(items) > 1 else ([(items[0][0], results)], [])
    return list(zip((number for number, _ in items), results, strict=True)), []


def _submitted(executor: Executor, call: _Call) -> Future[list[Any]]:
    """A call under way.

    Raises:
        CalibError: The executor takes none any more.
    """
    try:
        return executor.submit(_do, call)
    except BrokenExecutor as error:
        raise CalibError(_BROKEN.format(error)) from error
    except RuntimeError as error:
        message = (
            f"The executor takes no jobs any more ({error}). Give one that has not been shut down."
        )
        raise CalibError(message) from error


def _results(future: Future[list[Any]]) -> list[Any] | Lost:
    """What a call came to, or why there is nothing.

    Raises:
        CalibError: The executor has ended.
    """
    try:
        return future.result()
    except WorkerDied as error:
        return Lost(str(error))
    except BrokenExecutor as error:
        raise CalibError(_BROKEN.format(error)) from error
    except CancelledError as error:
        message = (
            "The executor has dropped jobs that it was given: it was shut down, or the scheduler that it belongs to "
            "has ended. Start it again, and give the same command."
        )
        raise CalibError(message) from error
    except Exception as error:
        # Dask's word for a task whose workers have ended; to import Dask for its class would take a second.
        if type(error).__name__ == "KilledWorker":
            return Lost(
                f"The Dask workers that worked on it have ended, one after the other: {error}"
            )
        raise


_BROKEN = (
    "A worker process has ended, and with it the executor that was given ({}). The one of "
    "calib.identify.processes.process_executor starts a new process instead."
)


def _still_there(executor: Executor) -> None:
    """Ask an executor that can say so whether anybody works on its jobs.

    Raises:
        CalibError: Nobody does, and has not for a while.
    """
    check = getattr(executor, "check", None)
    if callable(check):
        check()


def _do(call: _Call) -> list[Any]:
    """A call's results, in the process that works on it.

    Raises:
        CalibError: Other versions are here than where the call comes from.
    """
    check_versions(call.versions, "The process that sends jobs")
    with _TURN:
        function, shared = _function_and_shared(call.shared)
        items = [pickle.loads(item) for item in call.items]
        _one_thread_for_good()
        return [function(shared, item) for item in items]


@lru_cache(maxsize=1)
def _function_and_shared(blob: bytes) -> tuple[Callable[[Any, Any], Any], Any]:
    """What the calls of a run have in common, made once a process."""
    function, shared = pickle.loads(blob)
    return function, shared


@cache
def _one_thread_for_good() -> object:
    """Linear algebra has one thread in this process from now on; to say so for every call would take 4 ms each."""
    return threadpool_limits(limits=1)
