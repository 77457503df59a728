"""Ctrl-C ends the program within a second, whatever it is doing."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from calib.cli.exit_status import ExitStatus

#: What is said on stderr.
INTERRUPTED = "calib: interrupted; no file was left half written."

#: Time that the work has to end by itself after Ctrl-C, and to say what it keeps [s].
_GRACE = 0.7

#: Shows the cursor, which a progress bar hides, at the beginning of an empty line.
_SHOW_CURSOR = "\r\x1b[K\x1b[?25h"


@contextmanager
def ends_after_ctrl_c() -> Iterator[None]:
    """End the program within a second of Ctrl-C in the block; at once if it comes twice.

    Python raises `KeyboardInterrupt` between two of its instructions, but a library may swallow it, be in a long
    computation, or wait for other processes. Files are written completely or not at all, so a thread may end all.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    watched, told = socket.socketpair()
    told.setblocking(False)
    before = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(watched,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        told.close()


@contextmanager
def left_to_the_program() -> Iterator[None]:
    """Leave Ctrl-C in the block to the program, which ends by itself then, as a server does."""
    before = signal.set_wakeup_fd(-1)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)


def _watch(watched: socket.socket) -> None:
    """Wait for the number of a signal on a socket, until its other end is closed; end the program after Ctrl-C."""
    with watched:
        while number := watched.recv(1):
            if number[0] != signal.SIGINT:
                continue
            watched.settimeout(_GRACE)
            try:
                if not watched.recv(1):
                    return
            except TimeoutError:
                pass
            _end()


def _end() -> None:
    """End the program and the processes that it started."""
    if "multiprocessing" in sys.modules:
        import multiprocessing

        for child in multiprocessing.active_children():
            child.kill()
    cursor = _SHOW_CURSOR if os.isatty(2) else ""
    with suppress(OSError):  # stderr may be closed
        os.write(2, f"{cursor}{INTERRUPTED}\n".encode())
    os._exit(ExitStatus.INTERRUPTED)
