"""Results as if some of their parts had been others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from calib.result.calibration import Calibration


def with_part(c: Calibration, part: str, **changes: Any) -> Calibration:
    """The result with other values of some attributes of a part, such as ``with_part(c, "geometry", verdict=None)``."""
    return replace(c, **{part: replace(getattr(c, part), **changes)})
