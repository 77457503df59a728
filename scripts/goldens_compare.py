"""Differences between two stored runs; for goldens.py."""

# ruff: noqa: ANN401  JSON is anything

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from goldens_numbers import NUMBER

#: Keys of texts.
TEXTS = ("text", "#text")

#: Keys of parameters' values, which are compared beside their standard deviations.
VALUES = ("value", "delta", "nominal", "low", "high")


@dataclass(frozen=True)
class Comparison:
    """A way to compare two runs."""

    relative: float  # Largest relative difference of two equal numbers
    floor: float  # Largest difference of two equal numbers
    ignore_text: bool  # Texts are not compared

    def differences(self, path: str, a: Any, b: Any, scale: Any = 0.0) -> Iterator[str]:
        """Yield each place where two values differ, with both values.

        Args:
            path: Place of the values.
            a: Value of the first run.
            b: Value of the second run.
            scale: Magnitude of numbers beside which their difference counts; a list for those of a list.
        """
        if isinstance(a, dict) and isinstance(b, dict):
            yield from self._table_differences(path, a, b)
        elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
            if not isinstance(scale, list):
                largest = max((abs(v) for v in [*a, *b] if isinstance(v, float)), default=0.0)
                scale = [max(scale, largest)] * len(a)
            for i, (x, y, s) in enumerate(zip(a, b, scale, strict=True)):
                yield from self.differences(f"{path}/{i}", x, y, s)
        elif not self._equal(a, b, scale):
            yield f"{path}: {a} | {b}"

    def _table_differences(
        self, path: str, a: Mapping[str, Any], b: Mapping[str, Any]
    ) -> Iterator[str]:
        """Yield the differences of two tables."""
        for key in sorted(a.keys() | b.keys()):
            if self.ignore_text and key in TEXTS:
                continue
            if key not in a or key not in b:
                yield f"{path}/{key}: only in the {'second' if key in b else 'first'}"
            else:
                scale = _scale_of(key, a, b)
                yield from self.differences(f"{path}/{key}", a[key], b[key], scale)

    def _equal(self, a: Any, b: Any, scale: float) -> bool:
        """Return True if two values are equal, numbers but for rounding."""
        if a == b:
            return True
        last_place = 0.0
        if _is_number_text(a) and _is_number_text(b):
            last_place = _last_place(a)
            a, b = float(a), float(b)
        if not (_is_number(a) and _is_number(b)):
            return False
        if abs(abs(a) - math.pi) < 1e-6 and abs(a + b) < 1e-6:  # half a turn either way
            b = -b
        largest = max(abs(a), abs(b), scale)
        return bool(abs(a - b) <= max(self.relative * largest, self.floor, last_place))


#: For cases without a fit.
STRICT = Comparison(relative=1e-9, floor=1e-13, ignore_text=False)

#: For all that depends on the maximum of a restricted likelihood.
LOOSE = Comparison(relative=1e-6, floor=1e-10, ignore_text=False)


def rename(value: Any, names: Sequence[tuple[str, str]]) -> Any:
    """Return a stored value with other words in its keys and short texts.

    Args:
        value: What was kept of a file or a text.
        names: Old and new words, replaced one after the other where they are whole words; ``_`` is part of a word.
    """
    if isinstance(value, dict):
        return {rename(key, names): rename(v, names) for key, v in value.items()}
    if isinstance(value, list):
        return [rename(v, names) for v in value]
    if isinstance(value, str):
        for old, new in names:
            value = re.sub(rf"(?<!\w){re.escape(old)}(?!\w)", new, value)
    return value


def _scale_of(key: str, a: Mapping[str, Any], b: Mapping[str, Any]) -> Any:
    """Return the magnitude beside which an entry of two tables is compared; 0 where it has none but its own."""
    if key == "wave":  # a sum in which much cancels
        return max(abs(a["rms"]), abs(b["rms"]))
    std = a.get("std")
    if isinstance(std, list) and isinstance(a[key], list) and len(std) == len(a[key]):
        if key in VALUES:
            return [s or 0.0 for s in std]
        if key == "data_gradient":
            return [1.0 / s if s else 0.0 for s in std]
    return 0.0


def _is_number(value: Any) -> bool:
    """Return True if a value is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_number_text(value: Any) -> bool:
    """Return True if a value is a printed number."""
    return isinstance(value, str) and NUMBER.fullmatch(value) is not None


def _last_place(text: str) -> float:
    """Return the unit of the last place of a printed number, by which it may differ; 0 of a whole number."""
    if "." not in text:
        return 0.0
    decimals = re.split("[eE]", text.partition(".")[2])[0]
    return 1.001 * 10.0 ** -len(decimals)
