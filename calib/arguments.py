"""Checks of what users give to functions: the message names the argument, what was given, and what is allowed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import ArgumentError, ModelError

#: The most characters of a wrong value that are shown.
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
    """Return the error of an argument of a wrong type.

    Args:
        argument: Its name.
        given: Its value.
        allowed: What it may be.
    """
    return ArgumentError(f"The argument '{argument}' is {_words(given)}; it must be {allowed}.")


def check_whole(argument: str, given: object, least: int) -> None:
    """Refuse an argument that is no whole number, or less than the least one.

    Args:
        argument: Its name.
        given: Its value.
        least: The least number allowed.

    Raises:
        ArgumentError: It is no whole number.
        ModelError: It is too small.
    """
    allowed = f"a whole number, {least} or more"
    if isinstance(given, bool) or not isinstance(given, (int, np.integer)):
        raise wrong_type(argument, given, allowed)
    if given < least:
        raise ModelError(f"The argument '{argument}' is {given}; it must be {allowed}.")


def numbers(argument: str, given: ArrayLike, allowed: str) -> NDArray[np.float64]:
    """Return an argument as an array of numbers; they may be NaN or infinite.

    Args:
        argument: Its name.
        given: Its value.
        allowed: What it may be, for the message: ``"joint values of shape (N, 6) or (6,)"``.

    Returns:
        The numbers, of any shape; the array itself where it is one of ``float64``.

    Raises:
        ArgumentError: It is not made of numbers, or of rows of different lengths.
    """
    try:
        array = np.asarray(given)
    except ValueError:  # rows of different lengths
        raise wrong_type(argument, given, allowed) from None
    if array.dtype.kind not in "fiu":
        raise wrong_type(argument, given, allowed)
    return np.asarray(array, dtype=np.float64)


def finite_numbers(
    argument: str, given: ArrayLike, shape: tuple[int | None, ...], allowed: str
) -> NDArray[np.float64]:
    """Return an argument as an array of finite numbers of one shape.

    Args:
        argument: Its name.
        given: Its value.
        shape: The lengths; None: any.
        allowed: What it may be, for the message.

    Returns:
        The numbers.

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


def _words(given: object) -> str:
    """Return a value of a wrong type in words, in one line: None, or its type and its value if that is short."""
    if given is None:
        return "None"
    text = "" if isinstance(given, np.ndarray) else repr(given)
    if not text or len(text) > _SHOWN or "\n" in text or text.startswith("<"):
        text = ""
    if isinstance(given, np.ndarray):
        text = f"shape {given.shape}"
    kind = type(given).__name__
    return f"of the type {kind} ({text})" if text else f"of the type {kind}"
