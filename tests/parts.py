"""Results, and their files, as if some of their parts had been others."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from calib.result.calibration import Calibration


def with_part(c: Calibration, part: str, **changes: Any) -> Calibration:
    """The result with other values of some attributes of a part, such as ``with_part(c, "geometry", verdict=None)``."""
    return replace(c, **{part: replace(getattr(c, part), **changes)})


def of_an_earlier_version(table: dict[str, Any]) -> dict[str, Any]:
    """A copy of a result's table as version 0.1.0 wrote it, without the run's id, checksums and hashes of outputs."""
    copied: dict[str, Any] = json.loads(json.dumps(table))
    del copied["run"], copied["checksums"], copied["outputs"]
    return copied
