"""What the parts of the compiled kernel share: how they are compiled, and the values that they pass on.

numba keeps compiled code on disk, by file, and would not see that a function that is called in it stands in another
file that has changed. So every function of the kernel is known by the contents of all of the kernel's files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int_]

#: Samples that are computed side by side.
LANES = 64

#: What is measured of a sample: the target's position, its pose, its distance from the frame's origin, its distance
#: from where another sample has it, or its height over the frame's plane.
POSITION, POSE, DISTANCE, BETWEEN, HEIGHT = range(5)

_F = TypeVar("_F", bound=Callable[..., Any])

_CONTENTS = hashlib.sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("kernel*.py")))
).hexdigest()[:12]


class Geometry(NamedTuple):
    """A chain at one x, as the kernel reads it; poses are R by rows and the origin, shape (12,), [m].

    Attributes:
        slides: shape (n,), whether a joint slides along its z axis or turns about it.
        steps: shape (n, 12), of the next joint, or the tip, in a joint that has moved.
        starts: shape (F, 12), of the first joint, before it moves, in each measurement frame.
        bases: shape (F, 12), of the base in each measurement frame.
        targets: shape (T, 12), of each target in the tip.
        entries: shape (E, 6): place, column, only frame or -1, only target or -1, number or -1, and 0 where an entry
            is the first of its column, else 1. Each is what a unit of one parameter does at one place.
        twists: shape (E, 6), in the place's axes, linear part first.
        columns: Number of parameters.
    """

    slides: NDArray[np.bool_]
    steps: Array
    starts: Array
    bases: Array
    targets: Array
    entries: Numbers
    twists: Array
    columns: int


class Stood(NamedTuple):
    """Where the robot stood in N samples.

    Attributes:
        values: shape (N, n), values of the chain's joints [rad or m].
        frame: shape (N,), number of the frame.
        target: shape (N,), number of the target.
        numbers: shape (N, K), known numbers of the joints' state that multiply an entry.
    """

    values: Array
    frame: Numbers
    target: Numbers
    numbers: Array


class Measured(NamedTuple):
    """What was measured of N samples.

    Attributes:
        what: One of `POSITION`, `POSE`, `DISTANCE`, `BETWEEN`, `HEIGHT`; the same of all.
        points: shape (N, 3), positions [m].
        rotations: shape (N, 9), R_frame_target by rows.
        lengths: shape (N,), distances [m].
    """

    what: int
    points: Array
    rotations: Array
    lengths: Array


class Scratch(NamedTuple):
    """Room for one block.

    Attributes:
        Q: shape (n, LANES), joint values.
        S: shape (n, LANES), their sines.
        C: shape (n, LANES), their cosines.
        F: shape (n + 3, 12, LANES), the frames of all places.
        J: shape (rows, 3 LANES), columns and residual of lengths; rows in whole tiles of four.
        A: shape (rows, 3 LANES), of angles.
    """

    Q: Array
    S: Array
    C: Array
    F: Array
    J: Array
    A: Array


def compiled(*, exact: bool = False, inline: bool = False) -> Callable[[_F], _F]:
    """Compile with numba, kept on disk; sums may be put in another order unless they must be exact."""
    allowed = {"contract"} if exact else {"contract", "reassoc", "nsz", "arcp"}
    decorator = njit(fastmath=allowed, nogil=True, error_model="numpy", forceinline=inline)

    def compile_as(function: _F) -> _F:
        function.__qualname__ = f"{function.__qualname__}_{_CONTENTS}"
        dispatcher: Any = decorator(function)
        if hasattr(dispatcher, "enable_caching"):  # not where numba is told to interpret
            with suppress(
                RuntimeError
            ):  # neither the package nor a cache folder can be written: each process compiles
                dispatcher.enable_caching()
                dispatcher._cache = _Kept(dispatcher._cache)  # numba has no other way in
        return cast("_F", dispatcher)

    return compile_as


class _Kept:
    """numba's files on disk, without which everything works: damaged, or with no room for them, they end nothing."""

    def __init__(self, cache: Any) -> None:  # noqa: ANN401  numba's
        """Of one function."""
        self._cache = cache

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  whatever numba asks for besides
        """As numba has it."""
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, context: Any) -> Any:  # noqa: ANN401
        """What was compiled before; None where there is none that can be read."""
        try:
            return self._cache.load_overload(signature, context)
        except Exception:  # noqa: BLE001  unpickling damaged files raises anything
            with suppress(OSError):
                self._cache.flush()
            return None

    def save_overload(self, signature: Any, data: Any) -> None:  # noqa: ANN401
        """Keep it, where that is possible."""
        with suppress(OSError):
            self._cache.save_overload(signature, data)


def is_kept(function: Any) -> bool:  # noqa: ANN401
    """Whether a compiled function lies on disk, so that its first call need not wait for the compiler."""
    folder = getattr(getattr(function, "_cache", None), "cache_path", None)
    return folder is not None and any(Path(folder).glob(f"*{function.__qualname__}*.nbi"))
