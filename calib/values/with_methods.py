"""Values of lower folders as objects of a class that extends theirs with methods, which need text and files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def as_kind(kind: type[T], values: Any) -> T:  # noqa: ANN401  a dataclass that T extends
    """Return the values of a dataclass as an object of a class that extends it with methods."""
    return kind(**{field.name: getattr(values, field.name) for field in fields(values)})


def returning(kind: type[T], function: Callable[P, object], module: str) -> Callable[P, T]:
    """Return a function with its result as an object of a class with more methods, see `as_kind`.

    Args:
        kind: The class.
        function: The function.
        module: Name of the module that users import the new function from.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        return as_kind(kind, function(*args, **kwargs))

    call.__module__ = module
    # Not that of the wrapped function, which `wraps` has copied: help shows it.
    call.__annotations__ = {**function.__annotations__, "return": kind.__name__}
    return call
