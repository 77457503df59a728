"""Waiting for what an instrument gives: readings and faults come one after the other, in the order of their arrival."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque

from calib.errors import CalibError
from calib.verbs.measure.devices.reading import Reading

#: Longest time for which a reader looks before it sees whether it was closed [s].
LOOK = 0.1


class WaitingReader(ABC):
    """A reader that looks again and again for something new, until there is a reading or the time is up."""

    def __init__(self) -> None:
        #: What has come and was not asked for yet.
        self._ready: deque[Reading | CalibError] = deque()
        self._closed = threading.Event()

    def read(self, timeout: float | None = None) -> Reading | None:
        """Return the next reading.

        Args:
            timeout: How long to wait for it [s]; None: until there is one.

        Returns:
            The reading; None if nothing came, or the reader was closed.

        Raises:
            MeasurementError: Something came that is no reading, such as a malformed line. The next call goes on after
                it.
            DeviceError: The connection was lost, or there is nothing more to come.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._ready and not self._closed.is_set():
            left = LOOK if deadline is None else deadline - time.monotonic()
            self._look(min(max(left, 0.0), LOOK))
            if left <= 0.0:
                break
        if not self._ready:
            return None
        entry = self._ready.popleft()
        if isinstance(entry, CalibError):
            raise entry
        return entry

    @abstractmethod
    def _look(self, seconds: float) -> None:
        """Put what has come into `_ready`; if there is nothing, wait for it so long, and not longer."""

    def close(self) -> None:
        """Stop reading; a call of `read` that waits in another thread returns None."""
        self._closed.set()
