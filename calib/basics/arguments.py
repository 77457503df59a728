"""Checks of what users give to functions: the message names the argument, what was given, and what is allowed.

In all of them ``argument`` is the argument's name and ``given`` its value.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from calib.errors import ArgumentError, ModelError

#: The most characters of a wrong value that a message shows.
_SHOWN = 60


def check_type(argument: str, given: object, types: type | tuple[type, ...], allowed: str) -> None:
    """Refuse an argument of another type.

    Args:
        argument: Its name.
        given: Its value.
        types: The types that it may have.
        allowed: What it may be, for the message: ``"a Robot, or the path or the name of one"``.

    Raises:
        ArgumentError: It has none of these types.
    """
    if not isinstance(given, types):
        raise wrong_type(argument, given, allowed)


def wrong_type(argument: str, given: object, allowed: str) -> ArgumentError:
    """Return the error of an argument of a wrong type; ``allowed`` says what it may be."""
    described = f"of the type {type(given).__name__}"
    if given is None:
        described = "None"
    elif isinstance(given, np.ndarray):
        described += f" (shape {given.shape})"
    else:
        text = repr(given)
        is_short = len(text) <= _SHOWN and "\n" not in text
        if text and is_short and not text.startswith("<"):
            described += f" ({text})"
    return ArgumentError(f"The argument '{argument}' is {described}; it must be {allowed}.")


def check_whole(argument: str, given: object, least: int) -> None:
    """Refuse an argument that is not a whole number of at least ``least``.

    Raises:
        ArgumentError: It is not a whole number.
        ModelError: It is too small.
    """
    allowed = f"a whole number, {least} or more"
    if isinstance(given, bool) or not isinstance(given, (int, np.integer)):
        raise wrong_type(argument, given, allowed)
    if given < least:
        raise ModelError(f"The argument '{argument}' is {given}; it must be {allowed}.")


def check_number(
    argument: str, given: object, least: float = -np.inf, largest: float = np.inf
) -> None:
    """Refuse an argument that is not a finite number from ``least`` to ``largest``.

    Raises:
        ArgumentError: It is not a number.
        ModelError: It is NaN, infinite, or out of the range.
    """
    allowed = "a finite number"
    if np.isfinite(least) and np.isfinite(largest):
        allowed += f" from {least:g} to {largest:g}"
    elif np.isfinite(least):
        allowed += f", {least:g} or more"
    elif np.isfinite(largest):
        allowed += f", {largest:g} or less"
    if isinstance(given, (bool, np.bool_)) or not isinstance(
        given, (int, float, np.integer, np.floating)
    ):
        raise wrong_type(argument, given, allowed)
    if not np.isfinite(given) or not least <= given <= largest:
        raise ModelError(f"The argument '{argument}' is {given}; it must be {allowed}.")


def check_flags(**flags: object) -> None:
    """Refuse arguments, given by their names, that are neither True nor False; raises `ArgumentError`."""
    for argument, given in flags.items():
        check_type(argument, given, (bool, np.bool_), "True or False")


def check_callable(argument: str, given: object) -> None:
    """Refuse an argument that is neither a function nor None; raises `ArgumentError`."""
    if given is not None and not callable(given):
        raise wrong_type(argument, given, "a function, or None")


def check_executor(given: object) -> None:
    """Refuse an argument 'executor' that is neither an executor (such as Dask's) nor None."""
    allowed = "an Executor of concurrent.futures, or None"
    check_type("executor", given, (Executor, type(None)), allowed)


def check_path(argument: str, given: object) -> None:
    """Refuse an argument that is neither a text nor a path; raises `ArgumentError`. The file need not exist."""
    check_type(argument, given, (str, os.PathLike), "the path of a file")


def check_names(argument: str, given: object) -> None:
    """Refuse an argument that is not a collection of names; a single text is not one. Raises `ArgumentError`."""
    allowed = "a sequence of names, which are texts"
    if isinstance(given, (str, bytes)) or not isinstance(given, Collection):
        raise wrong_type(argument, given, allowed)
    if {*map(type, given)} <= {str}:  # as of the million rows of a table
        return
    for k, name in enumerate(given):
        check_type(f"{argument}[{k}]", name, str, "a name, which is a text")


def check_mapping(argument: str, given: object) -> None:
    """Refuse an argument that is not a mapping from names, with any values; raises `ArgumentError`."""
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise wrong_type(argument, given, "a mapping from names, which are texts")


def numbers(argument: str, given: object, allowed: str) -> NDArray[np.float64]:
    """Return an argument as an array of numbers; they may be NaN or infinite.

    Args:
        argument: Its name.
        given: Its value.
        allowed: What it may be, for the message: ``"joint values of shape (N, 6) or (6,)"``.

    Returns:
        The numbers, of any shape; the array itself if it is one of ``float64``.

    Raises:
        ArgumentError: It is not made of numbers, or its rows have different lengths.
    """
    try:
        array = np.asarray(given)
    except ValueError:  # rows of different lengths
        raise wrong_type(argument, given, allowed) from None
    if array.dtype.kind not in "fiu":
        raise wrong_type(argument, given, allowed)
    return np.asarray(array, dtype=np.float64)


def finite_numbers(
    argument: str, given: object, shape: tuple[int | None, ...], allowed: str
) -> NDArray[np.float64]:
    """Return an argument as an array of finite numbers of one shape.

    Args:
        argument: Its name.
        given: Its value.
        shape: Its shape; a length of None may be any.
        allowed: What it may be, for the message.

    Raises:
        ArgumentError: It is not made of numbers.
        ModelError: It has another shape, or a number is NaN or infinite.
    """
    array = numbers(argument, given, allowed)
    has_shape = array.ndim == len(shape) and all(
        length in (None, actual) for length, actual in zip(shape, array.shape, strict=True)
    )
    if not has_shape:
        raise ModelError(
            f"The argument '{argument}' has the shape {array.shape}; it must be {allowed}."
        )
    if not np.isfinite(array).all():
        raise ModelError(
            f"The argument '{argument}' has a number that is NaN or infinite; it must be {allowed}, all finite."
        )
    return array


def mask_of_rows(argument: str, given: object, count: int) -> NDArray[np.bool_]:
    """Return an argument as a mask, shape (count,), of rows; ArgumentError if it is not True or False for each."""
    mask = np.asarray(given)
    if mask.shape != (count,) or not np.isin(mask, (0, 1)).all():
        raise wrong_type(argument, given, f"True or False for each of the {count} rows")
    return mask.astype(np.bool_)
