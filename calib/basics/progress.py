"""What a long computation does at the moment: said by whoever computes, heard by whoever watches.

A function that takes long says which stage it is in, what it tries, and how much of the stage is done. Nothing depends
on whether anybody watches, and on what; so there is no parameter for it in the functions between, as there is none for
warnings. A watcher hears what is said in its own ``with`` block and thread alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import Enum
from typing import TypeAlias


class Stage(Enum):
    """A stage of a calibration."""

    READING = "reading"  #: files are read
    MISTAKES = "mistakes"  #: the input is searched for usual mistakes
    MODELS = "models"  #: models are fitted, and one is chosen
    FOLDS = "folds"  #: rows are predicted by fits without them
    VERDICT = "verdict"  #: residuals are examined, and the result is judged
    BOOTSTRAP = "bootstrap"  #: samples of the poses are fitted
    PROFILE = "profile"  #: parameters are held at values, and the others fitted
    WRITING = "writing"  #: files are written


#: Called with the stage that begins, or None if it goes on; what is being tried (the name of a model, the code of a
#: mistake, a file), empty if it goes on; and how many of how many parts of the stage are done, 0 of 0 if that is not
#: known.
Watcher: TypeAlias = Callable[[Stage | None, str, int, int], None]

_WATCHER: ContextVar[Watcher | None] = ContextVar("watcher", default=None)


@contextmanager
def watching(watcher: Watcher | None) -> Iterator[None]:
    """Let a watcher hear what is said in a ``with`` block.

    Args:
        watcher: It must not raise; None: nobody watches.
    """
    before = _WATCHER.set(watcher)
    try:
        yield
    finally:
        _WATCHER.reset(before)


def is_watched() -> bool:
    """Return True if somebody watches."""
    return _WATCHER.get() is not None


def begin(stage: Stage) -> None:
    """Say that a stage begins."""
    _say(stage, "", 0, 0)


def trying(what: str) -> None:
    """Say what is being tried: the name of a model, the code of a mistake, a file."""
    _say(None, what, 0, 0)


def counted(done: int, of: int) -> None:
    """Say how many of how many parts of the stage are done; parts take about as long as each other."""
    _say(None, "", done, of)


def _say(stage: Stage | None, what: str, done: int, of: int) -> None:
    """Call the watcher, if there is one."""
    watcher = _WATCHER.get()
    if watcher is not None:
        watcher(stage, what, done, of)
