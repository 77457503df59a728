"""Tables of one kind for tests of rows and setups."""

from __future__ import annotations

from dataclasses import replace

from calib.data.measurements import Measurements


def as_kind(table: Measurements, kind: str, **columns) -> Measurements:
    """The same rows as another kind: where they lie does not matter."""
    return replace(table, kinds=(kind,) * len(table), **columns)
