"""What a library written in C prints while it works, caught, so that it can stand in a message."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from collections.abc import Iterator

_ERROR = 2
_ONE_AT_A_TIME = threading.Lock()
_LONGEST = 600


@contextlib.contextmanager
def native_words() -> Iterator[list[str]]:
    """Catch what is printed to standard error, below Python; it is in the list once the block has ended.

    After a block that ends without an exception it is printed after all: it may be a warning.
    """
    said: list[str] = []
    with _ONE_AT_A_TIME, contextlib.ExitStack() as stack:
        try:
            printed = stack.enter_context(tempfile.TemporaryFile())
            terminal = os.dup(_ERROR)
        except (
            OSError
        ):  # no temporary files, or a program without standard error: nothing is caught
            yield said
            return
        stack.callback(os.close, terminal)
        os.dup2(printed.fileno(), _ERROR)
        try:
            yield said
        except BaseException:
            os.dup2(terminal, _ERROR)
            said.append(_read(printed.fileno()).decode("utf-8", "replace"))
            raise
        os.dup2(terminal, _ERROR)
        with contextlib.suppress(OSError):
            os.write(terminal, _read(printed.fileno()))


def reason(said: list[str]) -> str:
    """The first error in the words of urdfdom, as the end of a message; empty if there is none."""
    lines = " ".join(said).splitlines()
    first = next((line for line in lines if line.startswith("Error:")), "")
    text = " ".join(first.removeprefix("Error:").split())[:_LONGEST]
    return f" ({text})" if text else ""


def _read(file: int) -> bytes:
    """All that is in a file."""
    os.lseek(file, 0, os.SEEK_SET)
    return os.read(file, 1_000_000)
