"""What the studies of `verification_study.py` share: a study, the lines of its table, and ratios with their error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.calibration import Calibration

Array = NDArray[np.float64]
Found = dict[str, Any]

#: Noise of a tracker [m].
NOISE = 0.1e-3


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the table; ``met`` is None where there is no bar."""

    case: str
    bar: str
    found: str
    met: bool | None = None


@dataclass(frozen=True, slots=True)
class Study:
    """One study.

    Attributes:
        title: In words.
        cases: Names of its cases.
        runs: How many runs of each case, in full and quickly.
        one: One run of a case, from its random numbers.
        lines: The lines of the table, from the runs of each case.
    """

    title: str
    cases: Callable[[], Sequence[str]]
    runs: tuple[int, int]
    one: Callable[[str, np.random.Generator], Found]
    lines: Callable[[Mapping[str, list[Found]]], list[Line]]


def rms(residuals: Array) -> float:
    """Root of the mean squared length."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def ratio(found: list[Found], error: str = "error", bound: str = "bound") -> float:
    """Root mean square error over all runs, over that of the bound."""
    errors, bounds = (np.array([f[name] for f in found]) for name in (error, bound))
    return float(np.sqrt(np.sum(errors**2) / np.sum(bounds**2)))


def ratio_words(found: list[Found], error: str = "error", bound: str = "bound") -> str:
    """The same with its standard error, which the number of runs leaves."""
    value = ratio(found, error, bound)
    errors, bounds = (np.array([f[name] for f in found]) for name in (error, bound))
    spread = np.std(errors**2 - (value * bounds) ** 2) / np.mean(bounds**2)
    return f"{value:.3f} ± {spread / (2.0 * value * np.sqrt(len(found))):.3f}"


def picked(result: Calibration) -> str:
    """The models that were chosen: geometry, and the larger one where there is one."""
    return result.model.name if result.larger is None else result.larger.name


def counted(words: Iterable[str]) -> str:
    """How often each word came, most often first."""
    return ", ".join(f"{word} {n}" for word, n in Counter(words).most_common())
