"""dask_executor: the workers of a Dask scheduler, on any number of machines.

Dask is an extra (``pip install ".[dask]"``) and imported when it is asked for. Workers need calib and the same
versions of what computes, and no shared disk: jobs carry their inputs, and their results come back. The tasks of a
worker that ends are done by others; one that ends several workers in a row is given up by Dask.
"""

from __future__ import annotations

import logging
import re
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from calib.errors import CalibError
from calib.identify.executors import check_versions, versions

T = TypeVar("T")

#: How long a scheduler may take to answer, and its first worker to appear [s].
TIMEOUT = 10.0

#: How long jobs wait where the last worker has gone [s].
WITHOUT_WORKERS = 60.0

#: The number of workers is asked for no more often than this [s].
_ASKED = 1.0

_ADDRESS = re.compile(r"(?:tcp|tls)://(?:\[[0-9a-fA-F:]+\]|[\w.-]+):\d{1,5}")


class DaskExecutor(Executor):
    """The workers of a scheduler as an executor; see `dask_executor`."""

    def __init__(self, client: Any, address: str, patience: float = WITHOUT_WORKERS) -> None:  # noqa: ANN401
        """Take a client that is connected.

        Args:
            client: A ``distributed.Client``.
            address: Of its scheduler, for messages.
            patience: How long jobs wait where no worker is left [s].
        """
        self._client, self._address, self._patience = client, address, patience
        self._inner = client.get_executor(pure=False)
        self._workers, self._asked = 0, float("-inf")
        self._seen = time.monotonic()

    @property
    def workers(self) -> int:
        """Number of worker processes, 1 at least; each does one job at a time."""
        if time.monotonic() - self._asked > _ASKED:
            self._workers, self._asked = self._count(), time.monotonic()
        return max(1, self._workers)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:  # noqa: ANN401
        """A call under way."""
        future: Future[T] = self._inner.submit(fn, *args, **kwargs)
        return future

    def check(self) -> None:
        """Whether there is a worker, or was until just now.

        Raises:
            CalibError: There has been none for a minute.
        """
        now = time.monotonic()
        if self._count():
            self._seen = now
        elif now - self._seen > self._patience:
            message = (
                f"The Dask scheduler at {self._address} has had no workers for {self._patience:.0f} s. Start some "
                f"('dask worker {self._address} --nthreads 1'), and give the same command again."
            )
            raise CalibError(message)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more jobs; those that were given are done, or cancelled."""
        self._inner.shutdown(wait=wait and not cancel_futures)

    def _count(self) -> int:
        """Workers that the scheduler has now.

        Raises:
            CalibError: It does not answer.
        """
        try:
            return len(self._client.nthreads())
        except Exception as error:
            reason = str(error) or type(error).__name__
            message = (
                f"The Dask scheduler at {self._address} does not answer any more ({reason}). Start it again, and give "
                "the same command."
            )
            raise CalibError(message) from error


@contextmanager
def dask_executor(address: str, timeout: float = TIMEOUT) -> Iterator[DaskExecutor]:
    """The workers of a Dask scheduler, for `calib.study`, `calib.bootstrap` and `calib.fleet`.

    Args:
        address: Such as ``"tcp://192.168.0.10:8786"``.
        timeout: How long the scheduler and its first worker may take to answer [s].

    Raises:
        CalibError: Dask is not installed, no scheduler or no worker answers, or other versions are there.
    """
    if not _ADDRESS.fullmatch(address):
        message = (
            f"'{address}' is no address of a Dask scheduler; it is what 'dask scheduler' prints, such as "
            "tcp://192.168.0.10:8786."
        )
        raise CalibError(message)
    try:
        import distributed
    except ImportError as error:
        message = (
            "Dask is not installed here; it is an extra: pip install '.[dask]' in calib's folder. Workers of "
            "this machine alone need none: --workers."
        )
        raise CalibError(message) from error
    with _quiet():
        client = _connected(distributed, address, timeout)
        try:
            _check_workers(client, address, timeout)
            yield DaskExecutor(client, address)
        finally:
            with suppress(Exception):
                client.close(timeout=timeout)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without Dask's own log, whose traces say less than the errors here."""
    log = logging.getLogger("distributed")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(level)


def _connected(distributed: Any, address: str, timeout: float) -> Any:  # noqa: ANN401
    """A client of the scheduler.

    Raises:
        CalibError: None answers.
    """
    try:
        with warnings.catch_warnings():
            # Which versions must be the same is checked below, and said in one sentence.
            warnings.simplefilter("ignore")
            return distributed.Client(address, timeout=timeout, set_as_default=False)
    except Exception as error:  # what is not Dask at that port may answer with anything
        message = (
            f"No Dask scheduler answers at {address} ({str(error) or type(error).__name__}). Start one with 'dask "
            "scheduler', and give the address that it prints."
        )
        raise CalibError(message) from error


def _check_workers(client: Any, address: str, timeout: float) -> None:  # noqa: ANN401
    """Refuse workers that cannot work, or not alike.

    Raises:
        CalibError: There are none, one lacks calib, or has other versions.
    """
    try:
        client.wait_for_workers(1, timeout=timeout)
    except Exception as error:
        message = f"The Dask scheduler at {address} has no workers. Start some: 'dask worker {address} --nthreads 1'."
        raise CalibError(message) from error
    try:
        found = client.run(versions)
    except Exception as error:
        message = (
            f"A worker of the Dask scheduler at {address} cannot be asked for its versions ({error}). calib must be "
            "installed there as it is here."
        )
        raise CalibError(message) from error
    for worker, theirs in found.items():
        check_versions(theirs, f"The Dask worker {worker}")
