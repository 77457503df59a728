"""run: many independent jobs, here or in any executor of `concurrent.futures`; Dask has one too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from itertools import islice
from typing import TypeVar

from calib.errors import CalibError

C = TypeVar("C")
I = TypeVar("I")  # noqa: E741  an item
R = TypeVar("R")

#: Calls that wait in an executor at a time: while some run the next are on their way, and not all of them in memory.
_AHEAD = 32


def run(
    function: Callable[[C, I], R],
    shared: C,
    items: Iterable[I],
    executor: Executor | None = None,
    *,
    batch: int = 1,
) -> Iterator[tuple[int, R]]:
    """``function(shared, item)`` of every item, in any order.

    The function is a module's; what it is given and gives back can be pickled. ``shared`` is sent with every batch,
    ``items`` are taken as they are needed; without an executor they are done here, one after the other. ``batch`` items
    are sent together: many for jobs that take less time than they take to send.

    Yields:
        The item's number, counted from 0, and its result.

    Raises:
        CalibError: A worker was killed, or ran out of memory.
    """
    if executor is None:
        for number, item in enumerate(items):
            yield number, function(shared, item)
        return
    numbered = enumerate(items)
    pending: dict[Future[list[R]], list[int]] = {}
    try:
        while part := list(islice(numbered, batch)):
            numbers = [number for number, _ in part]
            future = executor.submit(_call, function, shared, [item for _, item in part])
            pending[future] = numbers
            if len(pending) >= _AHEAD:
                yield from _finished(pending)
        while pending:
            yield from _finished(pending)
    except BrokenExecutor as error:
        raise CalibError(
            f"A worker process has ended before its job: it was killed, or ran out of memory ({error}). Try fewer "
            "--workers."
        ) from error
    finally:
        for future in pending:
            future.cancel()


def batch_size(count: int, largest: int = 50) -> int:
    """How many of so many short jobs to send together: few enough for all workers to end at about the same time."""
    return max(1, min(largest, count // 24))


def _call(function: Callable[[C, I], R], shared: C, items: list[I]) -> list[R]:
    """One batch, in a worker."""
    return [function(shared, item) for item in items]


def _finished(pending: dict[Future[list[R]], list[int]]) -> Iterator[tuple[int, R]]:
    """Wait for the next calls that end, and take their results out of those that are pending."""
    done, _ = wait(pending, return_when=FIRST_COMPLETED)
    for future in done:
        yield from zip(pending.pop(future), future.result(), strict=True)
