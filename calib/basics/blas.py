"""Threads of the linear algebra library (BLAS) that NumPy calls."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    """Return the libraries that are loaded; searching for them takes as long as a fit."""
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra to one thread inside a ``with`` block, or a function that this decorates.

    On matrices as small as those of a fit, several threads wait for each other longer than they compute.
    """
    with _libraries().limit(limits=1, user_api="blas"):
        yield
