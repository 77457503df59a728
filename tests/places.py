"""Where the checkout is, for tests that read its documents, scripts and robots."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
