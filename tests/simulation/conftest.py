"""The paper's UR3 and its table."""

from __future__ import annotations

from tests.fits import table, ur3

__all__ = ["table", "ur3"]
